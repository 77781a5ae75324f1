"""Which cells share a call: those of a kind within a window of the study, and all modes of a cell."""

from concurrent.futures import Future
from types import SimpleNamespace

import pytest

from pcbench.moments import solve
from pcbench.moments.solve import MomentRequest


class Threads:
    """Threads that note what calls would compute."""

    def __init__(self):
        self.calls = []

    def submit(self, function, compute, ones, asked, width):
        self.calls.append([one.name for one in ones])
        return Future()


@pytest.fixture
def submitted(monkeypatch):
    """A function of (name, kind, modes) of each cell: the calls of each window, by the names of their realisations."""
    monkeypatch.setattr(solve, "MANY", 4)
    monkeypatch.setattr(solve, "WINDOW", 6)
    monkeypatch.setattr(solve, "plant_curvature", lambda p: 0.0)
    monkeypatch.setattr(solve, "refusal_beforehand", lambda p: "")
    monkeypatch.setattr(solve, "batch_key", lambda problem, known: ())
    monkeypatch.setattr(solve, "width_of", lambda ones, wide: 4)
    mode = SimpleNamespace()

    def ones(p, asked, unlike):
        name, kind, modes = p
        return (
            [SimpleNamespace(name=name, layout=kind, problem=(), mode=mode if modes > 1 else None)] * modes,
            False,
            False,
        )

    monkeypatch.setattr(solve, "_realisations", ones)

    def calls(cells):
        out = []
        for window in solve._windows(cells, MomentRequest(0, 1), set()):
            threads = Threads()
            solve._submit(threads, window, MomentRequest(0, 1), set())
            assert [len(work.calls) for work in window] == [len(work.realisations) for work in window]
            out.append(threads.calls)
        return out

    return calls


def test_cells_of_a_kind_go_side_by_side(submitted):
    cells = [(name, name < "c", 1) for name in "abcde"]
    assert submitted(cells) == [[["a", "b"], ["c", "d", "e"]]]


def test_a_full_call_does_not_wait_and_a_rare_kind_waits_for_a_window_alone(submitted):
    cells = [("rare", "rare", 1), *((name, "usual", 1) for name in "abcdefgh")]
    assert submitted(cells) == [[["a", "b", "c", "d"], ["rare"], ["e"]], [["f", "g", "h"]]]


def test_all_modes_of_a_cell_share_a_call(submitted):
    assert submitted([("a", "k", 3), ("b", "k", 3)]) == [[["a"] * 3, ["b"] * 3], []]
