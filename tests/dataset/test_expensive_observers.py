"""Observers whose runs may take long have programs of their own, and their turn comes last."""

import shutil
from pathlib import Path

import pytest

import pcbench
from pcbench import planning
from pcbench.dataset import task
from pcbench.study import parse

SOURCE = Path(__file__).parents[1] / "support" / "own_observer.py"
AXES = {"noise_std": [0.5, 0.6]}


def test_particle_and_mhe_have_programs_of_their_own():
    cells = parse.grid_of("cart/white", {"observers": ["kf", "particle", "model-only", "mhe"]}, []).cells
    assert [p.labels for p in planning.drafts(cells, split_expensive=True)] == [
        ("kf", "model-only"),
        ("particle",),
        ("mhe",),
    ]
    assert [p.labels for p in planning.drafts(cells, (), split_expensive=True)] == [()], (
        "what is not computed has one draft"
    )


@pytest.fixture
def done(tmp_path, monkeypatch):
    """What tasks are done, in order: cell, observers, whether only timed."""
    shutil.copy(SOURCE, tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    out, before = [], task.compute

    def compute(work, one, hold):
        cell = one.parcel.cell.number
        out.append((cell, [label for _, labels in one.pieces for label in labels], one.timed))
        return before(work, one, hold)

    monkeypatch.setattr(task, "compute", compute)
    return out


@pytest.mark.ci
def test_observers_of_one_cell_do_not_wait_for_an_expensive_one(done):
    raw = {"name": "order", "scenarios": ["cart/white"], "seeds": 4, "axes": AXES}
    result = pcbench.run(raw | {"observers": ["mine.py:nudge", "kf"]}, out="out", devices=1)
    assert [labels for _, labels, _ in done] == [["kf"]] * 3 + [["nudge"]] * 3
    assert [timed for *_, timed in done].count(True) == 2, "once for each program"
    alone = pcbench.run(raw | {"observers": ["kf"]}, out="alone", devices=1)
    columns = ["cell", "signal", "seed", "rmse", "max_abs_error"]
    both = result.runs.query("observer == 'kf'")[columns].reset_index(drop=True)
    assert both.equals(alone.runs[columns].reset_index(drop=True))


@pytest.mark.ci
def test_long_calls_are_announced(done, monkeypatch):
    monkeypatch.setattr("pcbench.dataset.timing.seconds", lambda made, job: 3 * 3600.0)
    said = []
    pcbench.run("cart/white", observers=["kf"], seeds=100, block_size=50, out="out", on_warning=said.append)
    assert said == [
        "cart/white: a call of kf, of up to 256 runs, takes about 3.0 h or more; calls to do: 1. "
        "Runs are written at the end of their call."
    ]
