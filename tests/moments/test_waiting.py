"""Which cells wait for others to share a call with, and programs of exact moments that outlive their process."""

from types import SimpleNamespace

import numpy as np
import pytest

import pcbench
from pcbench.moments import compiled
from pcbench.moments.solve import WAITING, _due
from pcbench.simulation import compiling, kept_programs

STUDY = {
    "name": "kept",
    "observers": ["open-loop"],
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "horizon": 3.0, "tail": 1.0,
        "noise_std": 0.3, "sampling_period": 0.4, "delay": 0.2, "states": ["a"], "input": "sine",
    },
}  # fmt: skip


def waiting(first, many):
    return [SimpleNamespace(cell=first + i) for i in range(many)]


def test_all_wait_while_they_are_few():
    assert _due({"a": waiting(0, 3), "b": waiting(4, 5)}, 9) is None


def test_of_too_many_the_fullest_goes():
    assert _due({"a": waiting(0, 3), "b": waiting(4, WAITING), "c": waiting(5, 9)}, 9) == "b"


def test_what_holds_back_many_cells_goes_first():
    """A rare shape, whose answer all later ones wait for."""
    assert _due({"rare": waiting(0, 1), "b": waiting(4, 5)}, WAITING) is None
    assert _due({"rare": waiting(0, 1), "b": waiting(4, WAITING)}, WAITING + 1) == "rare"


@pytest.mark.usefixtures("in_a_hurry")
def test_a_program_is_made_once_and_found_again_with_its_bits(tmp_path, monkeypatch):
    """As another process would: nothing of the first one's memory is there."""
    loaded, load = [], kept_programs.load

    def noted(*a):
        loaded.append(load(*a) is not None)
        return load(*a)

    monkeypatch.setattr(kept_programs, "folder", lambda: tmp_path)
    monkeypatch.setattr(kept_programs, "load", noted)
    monkeypatch.setattr(compiled, "_MADE", compiling.Programs())
    first = pcbench.exact(STUDY).stats
    compiled._MADE.clear()
    again = pcbench.exact(STUDY).stats
    assert loaded == [False, True]
    np.testing.assert_array_equal(again["mean"].to_numpy(), first["mean"].to_numpy())
