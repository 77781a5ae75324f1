"""Which cells wait for others to share a call with, and programs of exact moments that outlive their process."""

from types import SimpleNamespace

from pcbench.moments.solve import WAITING, _due

STUDY = {
    "name": "kept",
    "observers": ["model-only"],
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "duration": 3.0,
        "steady_start": 1.0,
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
