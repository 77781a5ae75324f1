"""A study in its folder: stopped and gone on with, damaged, cut as you like, the same bits in all ways."""

import shutil

import hurried
import numpy as np
import pandas as pd
import pytest
from small_study import STUDY, rows, same, tables

import pcbench
from pcbench.dataset import executors, task, verify
from pcbench.errors import UserError


def count_tasks(monkeypatch):
    """Count the tasks that are done from now on."""
    done, before = [], task.compute
    monkeypatch.setattr(task, "compute", lambda *a: done.append(a[1]) or before(*a))
    return done


def test_a_finished_study_is_not_done_again(copy, monkeypatch):
    before, done = tables(copy), count_tasks(monkeypatch)
    result = pcbench.run(STUDY, out=copy)
    assert not done
    assert tables(copy) == before
    assert len(result.runs) == 2 * 2 * 40 * 2


@pytest.mark.ci
@pytest.mark.parametrize("keep", [0, 1, 5, 11])
def test_what_is_missing_is_done_and_nothing_else(copy, keep, monkeypatch):
    want, done = tables(copy), count_tasks(monkeypatch)
    files = sorted((copy / "runs").rglob("*.parquet"))
    for path in np.random.default_rng(keep).permutation(np.array(files, object))[keep:]:
        path.unlink()
    (copy / "stats.parquet").unlink()
    stamps = {p: p.stat().st_mtime_ns for p in (copy / "runs").rglob("*.parquet")}
    pcbench.run(STUDY, out=copy, block_size=16)
    assert tables(copy) == want
    assert all(p.stat().st_mtime_ns == t for p, t in stamps.items()), "what stood was not touched"
    assert sum(one.runs for one in done) == sum(len(pd.read_parquet(p)) // 2 for p in files if p not in stamps)


def test_a_damaged_block_is_named_and_done_again(copy):
    want, said = tables(copy), []
    path = sorted((copy / "runs").rglob("*.parquet"))[3]
    path.write_bytes(path.read_bytes()[:-20])
    pcbench.run(STUDY, out=copy, block_size=16, on_warning=said.append)
    assert len(said) == 1
    assert path.name in said[0]
    assert tables(copy) == want


def test_rows_that_two_blocks_hold_are_kept_once(copy):
    """Another process with blocks of another size was at work in the folder."""
    said = []
    pcbench.run(STUDY, out=copy.parent / "other", block_size=8)
    for path in list((copy.parent / "other" / "runs").rglob("*.parquet"))[:7]:
        shutil.copy(path, copy / path.relative_to(copy.parent / "other"))
    pcbench.run(STUDY, out=copy, on_warning=said.append)
    assert len(said) == 5, "of 7, two have the name of a block that stands"
    same(copy, copy.parent / "other")


@pytest.mark.parametrize("size", [8, 2048])
def test_blocks_of_any_size_hold_the_same(whole, tmp_path, size):
    pcbench.run(STUDY, out=tmp_path / "out", block_size=size)
    same(whole, tmp_path / "out")


@pytest.mark.ci
@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_calls_at_a_time_leaves_the_same_bytes(whole, tmp_path, count):
    pcbench.run(STUDY, out=tmp_path / "out", block_size=16, devices=count)
    assert tables(tmp_path / "out") == tables(whole)


def test_tasks_done_twice_and_in_any_order_leave_each_row_once(whole, tmp_path, monkeypatch):
    here = executors.local_executor

    def twice_and_backwards(*args):
        from contextlib import contextmanager

        @contextmanager
        def made():
            with here(*args) as execute:
                yield lambda work, tasks: execute(work, [t for t in list(tasks)[::-1] for _ in range(2)])

        return made()

    monkeypatch.setattr(executors, "local_executor", twice_and_backwards)
    pcbench.run(STUDY, out=tmp_path / "out", block_size=16)
    assert tables(tmp_path / "out") == tables(whole)


@pytest.mark.ci
def test_a_damaged_block_does_not_stand_when_a_study_grows_over_it(copy, tmp_path):
    """The gap is cut anew, under another name."""
    path = max((copy / "runs").rglob("*.parquet"))
    path.write_bytes(path.read_bytes()[:-20])
    pcbench.run(STUDY, out=copy, seeds=61, block_size=100)
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=61)
    same(copy, tmp_path / "at-once")


def test_a_damaged_closing_table_is_made_anew(copy):
    want = tables(copy)
    (copy / "stats.parquet").write_bytes(want["stats.parquet"][:-9])
    assert verify.verify(copy, 0, 0).wrong
    pcbench.run(STUDY, out=copy)
    assert tables(copy) == want


def test_more_seeds_that_never_ran_bind_nobody(copy, monkeypatch):
    def refuse(*args):
        raise UserError("disk: is full, expected room; make some.")

    monkeypatch.setattr(task, "compute", refuse)
    with pytest.raises(UserError, match="disk"):
        pcbench.run(STUDY, out=copy, seeds=4000)
    monkeypatch.undo()
    pcbench.run(STUDY, out=copy)
    assert verify.status(copy).closed


def test_files_that_other_systems_leave_are_passed_over(copy):
    for name in (".DS_Store", ".nfs000001", "_SUCCESS"):
        (next((copy / "runs").rglob("cell-*")).parent / name).write_text("")
    pcbench.run(STUDY, out=copy)
    assert verify.status(copy).closed


@pytest.mark.parametrize("made", [hurried.programs, pytest.param(hurried.not_here, marks=pytest.mark.nightly)])
def test_a_cell_has_the_same_bits_alone_and_among_others(tmp_path, made):
    """Room for a longer delay, for more samples at a time, and for drift changes no number; slowly, as users have it."""
    alone = STUDY | {"seeds": 16}
    with made():
        pcbench.run(alone, out=tmp_path / "one")
        pcbench.run(
            alone | {"axes": {"noise_std": [0.1, 0.5], "delay": [1.0, 3.0], "parameter_drift": [0.0, 1.0]}},
            out=tmp_path / "many",
        )
    a, b = rows(tmp_path / "one"), rows(tmp_path / "many")
    b = b[(b.delay == 1.0) & (b.parameter_drift == 0.0)]
    by = ["noise_std", "observer", "seed", "signal"]
    a, b = (f.sort_values(by, ignore_index=True).drop(columns="cell") for f in (a, b))
    pd.testing.assert_frame_equal(a, b, check_exact=True)


ELSEWHERE = {
    "csth/10s-noise": ({"delay": [[20.0, 50.0, 70.0], [20.0, 50.0, 120.0]]}, {}),
    "cart/variable": ({"delay": [0.2, 0.6], "loss": [0.0, 0.2]}, {}),
    "arm/sampled": ({"delay": [0.02, 0.1], "parameter_drift": [0.0, 0.05]}, {}),
    "helicopter/constant": (
        {"delay": [0.01, 0.04], "sampling_period": [0.05, 0.2]},
        {"observers": ["high-gain", "ekf"]},
    ),
}


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ELSEWHERE)
def test_every_scenarios_cells_have_the_same_bits_alone_and_among_others(scenario, tmp_path):
    axes, more = ELSEWHERE[scenario]
    study = {"name": "bits", "scenarios": [scenario], "seeds": 3} | more
    first = {name: values[:1] for name, values in axes.items()}
    pcbench.run(study | {"axes": axes}, out=tmp_path / "many")
    pcbench.run(study | {"axes": first}, out=tmp_path / "one")
    a, b = rows(tmp_path / "one"), rows(tmp_path / "many")
    pd.testing.assert_frame_equal(a, b[b.cell == 0].reset_index(drop=True), check_exact=True)
