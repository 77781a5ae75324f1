"""Drafts are made once though a study goes over its cells twice, as far as they fit; what is planned is the same."""

from itertools import groupby
from typing import NamedTuple

import jax
import numpy as np
import pytest

from pcbench.dataset import manifest, run_missing, storage
from pcbench.planning import build, padding
from pcbench.runtime import config
from pcbench.study import parse

OPEN = {
    "name": "x",
    "scenarios": ["cart/slow"],
    "observers": ["kf", "model-only"],
    "axes": {"noise_std": [0.1, 0.2, 0.3]},
}
CLOSED = {
    "name": "x",
    "scenarios": ["helicopter/constant"],
    "observers": ["ekf", "ukf"],
    "axes": {"noise_std": [0.1, 0.2]},
}


def plan_runs(study, place):
    """What is planned of a study."""
    owned = manifest.claim(place, parse.grid_of(study | {"seeds": 2}, {}, []))
    wanted = run_missing.required_seeds(owned, [])
    return run_missing.plan_runs(owned, run_missing.missing_seeds(owned, [], wanted, lambda cell: 64), wanted)


class Task(NamedTuple):
    """A task: which one, and whether it makes a program."""

    name: str
    timed: bool = False


@pytest.mark.parametrize(
    ("given", "ahead", "wanted"),
    [
        ("A a1 a2 B b1 C c1 c2", 16, "A B a1 a2 C b1 c1 c2"),
        ("A a1 a2 a3 a4 B b1", 2, "A a1 a2 B a3 a4 b1"),
        ("A a1 a2 a3", 16, "A a1 a2 a3"),
        ("A B C", 16, "A B C"),
        ("", 16, ""),
    ],
)
def test_a_program_is_begun_before_the_tasks_of_the_one_before_it(given, ahead, wanted):
    tasks = [Task(name, name.isupper()) for name in given.split()]
    assert " ".join(t.name for t in run_missing.interleave(tasks, ahead)) == wanted


@pytest.mark.ci
@pytest.mark.parametrize("study", [OPEN, CLOSED], ids=["open", "closed"])
def test_what_is_planned_is_the_same_whatever_is_kept(study, tmp_path, monkeypatch):
    made, draft = [], build.draft
    monkeypatch.setattr(build, "draft", lambda cell, *a, **k: made.append(cell.number) or draft(cell, *a, **k))
    found, size = {}, 0
    for room in (2**30, 0, None):
        if room is None:  # so that the second cell does not fit as a whole
            room = size
        monkeypatch.setattr(run_missing, "DRAFTS", room)
        made.clear()
        with config.float64():
            plan = plan_runs(study, storage.target(tmp_path / "out"))
            tasks = [t for t in plan.tasks(plan.programs()) if not t.timed]
        many = len(study["axes"]["noise_std"]) * (len(study["observers"]) if study is CLOSED else 1)
        assert len(tasks) == many
        assert len(made) == 2 * many - len(plan.first_drafts)
        if room == 2**30:
            assert plan.n_cells == len(study["axes"]["noise_std"])
            leaves = [jax.tree.leaves(p.problem) for p in plan.first_drafts]
            first = {id(a): a for p in leaves[: many // plan.n_cells] for a in p}
            size = sum(getattr(a, "nbytes", 0) + 200 for a in first.values())
        found[room] = sorted([np.asarray(a).tobytes() for a in jax.tree.leaves(t.parcel.problem)] for t in tasks)
        programs = [key for key, _ in groupby(padding.key_of(t.parcel) for t in tasks)]
        assert room != 2**30 or len(programs) == len(set(programs)), "the tasks of one program come together"
    assert plan.n_cells == 1
    assert len({str(each) for each in found.values()}) == 1


def test_schedules_of_cells_that_differ_in_period_are_fitted_each(tmp_path):
    study = OPEN | {"axes": {"sampling_period": [1.0, 0.5], "noise_std": [0.1, 0.2]}}
    with config.float64():
        plan = plan_runs(study, storage.target(tmp_path / "out"))
        a, b, c, d = (t.parcel.problem.schedule for t in plan.tasks(plan.programs()) if not t.timed)
    assert a is b
    assert c is d
    assert a.event.sum() * 2 - 1 <= c.event.sum() <= a.event.sum() * 2 + 1
