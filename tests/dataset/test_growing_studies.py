"""A study that grows keeps what it has; one that is changed is refused, with what changed; fresh only when asked."""

import tomllib

import hurried
import pandas as pd
import pytest
from small_study import STUDY, rows, same, tables

import pcbench
from pcbench.dataset import executors, verify
from pcbench.dataset.manifest import changes
from pcbench.errors import UserError


@pytest.mark.ci
def test_more_seeds_extend_a_study(copy, tmp_path):
    pcbench.run(STUDY, out=copy, seeds=61)
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=61)
    same(copy, tmp_path / "at-once")


GROWN = [
    {"axes": {"noise_std": [0.1, 0.5, 1.0]}},
    pytest.param({"axes": {"noise_std": [0.1, 0.5], "parameter_drift": [0.0, 1.0]}}, marks=pytest.mark.nightly),
    pytest.param(
        {"axes": {"noise_std": [0.05, 0.1, 0.5], "delay": [1.0, 2.0]}, "seeds": 44}, marks=pytest.mark.nightly
    ),
]


@pytest.mark.ci
@pytest.mark.parametrize("change", GROWN, ids=str)
def test_more_cells_extend_a_study_and_old_ones_keep_their_numbers(copy, tmp_path, change):
    before = rows(copy)
    pcbench.run(STUDY | change, out=copy)
    pcbench.run(STUDY | change, out=tmp_path / "at-once")
    a, b = rows(copy), rows(tmp_path / "at-once")
    kept = a[(a.cell < 2) & (a.seed < 40)].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before, check_exact=True)
    by = ["noise_std", "parameter_drift", "delay", "observer", "seed", "signal"]
    a, b = (f.sort_values(by, ignore_index=True).drop(columns="cell") for f in (a, b))
    pd.testing.assert_frame_equal(a, b, check_exact=True)


@pytest.mark.nightly
def test_another_observer_extends_a_study(copy, tmp_path):
    more = STUDY | {"observers": ["pccebo", "kfbo", "model-only"]}
    pcbench.run(more, out=copy)
    pcbench.run(more, out=tmp_path / "at-once")
    same(copy, tmp_path / "at-once")


CHANGED = {
    "a cell less": ({"axes": {"noise_std": [0.1]}}, r"axes.noise_std: \[0.1, 0.5\] there, \[0.1\] here"),
    "a seed less": ({"seeds": 39}, r"seeds: 0 .. 39 there, 0 .. 38 here"),
    "other seeds": ({"first_seed": 1}, r"seeds: 0 .. 39 there, 1 .. 40 here"),
    "root seed": ({"root_seed": 1}, "root_seed: 0 there, 1 here"),
    "name": ({"name": "other"}, "name: 'small' there, 'other' here"),
    "an observer less": ({"observers": ["kfbo"]}, "observers: pccebo there, not here"),
    "an option": ({"options": {"kfbo": {"R": 0.7}}}, r"options of cart/slow.kfbo.R: 0.3 there, 0.7 here"),
    "a choice": (
        {"options": {"scenario": {"random_initial_state": True}}},
        r"random_initial_state: False there, True here",
    ),
    "scenario": ({"scenarios": ["cart/white"]}, "scenarios: cart/slow there, not here"),
}


@pytest.mark.parametrize("case", CHANGED)
def test_a_changed_study_is_refused_with_what_changed(copy, case):
    change, said = CHANGED[case]
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    with pytest.raises(UserError, match=said) as caught:
        pcbench.run(STUDY | change, out=copy)
    assert "\n" not in str(caught.value)
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before, "nothing was written"


def test_fresh_starts_over_and_only_when_asked(copy, tmp_path):
    other = STUDY | {"seeds": 8}
    pcbench.run(other, out=copy, overwrite=True)
    pcbench.run(other, out=tmp_path / "new")
    same(copy, tmp_path / "new")


MISTAKES = [
    *(
        {"memory": "2Gx"},
        {"block_size": 0},
        {"until_se": "mae"},
        {"dask": "nonsense"},
        {"max_seeds": 3},
        {"workers": 2},
    ),
    *({"dask": "local", "workers": 0}, {"devices": -1}),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_beside_fresh_removes_nothing(copy, mistake, monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_TIMEOUT", "1s")
    before = tables(copy)
    with pytest.raises(UserError) as caught:
        pcbench.run(STUDY | {"seeds": 8}, out=copy, overwrite=True, **mistake)
    assert "\n" not in str(caught.value)
    assert tables(copy) == before


def test_fresh_keeps_a_study_that_somebody_wrote(tmp_path):
    (tmp_path / "study.toml").write_text('name = "mine"\nscenarios = ["cart/slow"]\n')
    with pytest.raises(UserError, match="is not as pcbench run has written it"):
        pcbench.run(STUDY, out=tmp_path, overwrite=True)
    assert (tmp_path / "study.toml").exists()


NOT_OURS = ["", "seeds = 3", "[resolved]", "resolved = 3", "x = [", 'seeds = "a"\nfirst_seed = 0\n[resolved]']


@pytest.mark.parametrize("text", NOT_OURS)
def test_a_study_text_that_is_not_ours_is_one_sentence(copy, text):
    (copy / "study.toml").write_text(text)
    with pytest.raises(UserError, match=r"is not as pcbench run has written it.*run its study again.*blocks are kept"):
        verify.status(copy)


@pytest.mark.parametrize("text", NOT_OURS)
def test_nor_is_a_folder_taken_that_holds_nothing_but_such_a_text(tmp_path, text):
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(UserError, match=r"is not as pcbench run has written it.*move it away"):
        pcbench.run(STUDY, out=tmp_path)
    assert (tmp_path / "study.toml").read_text() == text


@pytest.mark.nightly
def test_columns_keep_their_kind_when_a_study_grows(tmp_path):
    """One number for all channels stays one: a list beside it could not be read together."""
    tank = {"name": "tank", "scenarios": ["csth/10s-noise"], "observers": ["kf"], "seeds": 2}
    with hurried.programs():
        pcbench.run(tank | {"axes": {"delay": [[40.0, 40.0, 40.0]]}}, out=tmp_path / "out")
    with pytest.raises(UserError, match=r"axes.delay: a number for all channels"):
        pcbench.run(tank | {"axes": {"delay": [[40.0, 40.0, 40.0], [20.0, 50.0, 70.0]]}}, out=tmp_path / "out")


def test_fresh_removes_nothing_of_others(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    for overwrite in (False, True):
        with pytest.raises(UserError, match="contains other files"):
            pcbench.run(STUDY, out=tmp_path, overwrite=overwrite)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_cells_that_are_lost_for_no_reason_that_shows_are_said(copy):
    """As when a later release takes another cell for the same."""
    there = tomllib.loads((copy / "study.toml").read_text())
    here = there | {"resolved": there["resolved"] | {"cells": {"cart/slow": ["another", "cell"]}}}
    assert list(changes(there, here)) == ["cells: some that stand there are not of this study"]
    assert list(changes(there, there)) == []
