"""`observers = "all"` runs every observer that can run, and lists the others with their reasons."""

import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.planning import all_observers
from pcbench.report import page

STUDY = {
    "name": "everything",
    "seeds": 2,
    "lti": {
        "A": [[0, 1], [-2, -1]],
        "B": [[0], [1]],
        "C": [[1, 0]],
        "tick": 0.05,
        "sampling_period": 0.1,
        "delay": 0.1,
        "noise_std": 0.01,
        "horizon": 1.0,
    },
}


@pytest.fixture
def few(monkeypatch):
    """Compiling thirty observers takes minutes; three show what is to be shown."""
    monkeypatch.setattr(all_observers, "OBSERVERS", {name: OBSERVERS[name] for name in ("smo", "dkf", "open-loop")})


def test_each_observer_is_planned_or_has_a_reason():
    study = all_observers.grid_of(STUDY, {"observers": "all"}, []).study
    assert sorted([*study.observers, *study.excluded]) == sorted(OBSERVERS)
    assert {"dkf", "pccebo", "ekf", "open-loop"} <= set(study.observers)
    assert "no unknown input" in study.excluded["smo"]


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("asked", ["all", ["all"], ["dkf", "all"]])
def test_a_study_file_the_option_and_a_list_mean_the_same(asked):
    study = all_observers.grid_of(STUDY | {"observers": asked}, {}, []).study
    assert (study.observers, list(study.excluded)) == (["dkf", "open-loop"], ["smo"])


def test_an_observer_that_is_refused_in_one_cell_is_left_out(monkeypatch):
    """`no-delay` needs delays of whole samples in every cell."""
    monkeypatch.setattr(all_observers, "OBSERVERS", {name: OBSERVERS[name] for name in ("no-delay", "dkf")})
    study = all_observers.grid_of(STUDY | {"axes": {"delay": [0.1, 0.15]}}, {"observers": "all"}, []).study
    assert study.observers == ["dkf"]
    assert "whole" in study.excluded["no-delay"]


@pytest.mark.usefixtures("few")
def test_reasons_are_said_once_and_stay_with_the_results(tmp_path):
    said = []
    result = pcbench.run(STUDY, observers="all", out=tmp_path / "out", say=said.append)
    assert [each for each in said if "left out" in each] == [f"smo is left out of all observers: {REASON}"]
    assert set(result.stats.observer) == {"dkf", "open-loop"}
    again = pcbench.opened(tmp_path / "out")
    assert again.provenance["excluded"] == again.study.excluded == {"smo": REASON}
    assert ("left out: smo", REASON) in page._provenance(again)


REASON = "smo in lti: the plant has no unknown input, expected a model with E [n, r], r > 0; take another observer."


def test_without_an_observer_that_can_run_the_first_reason_is_the_sentence(monkeypatch):
    monkeypatch.setattr(all_observers, "OBSERVERS", {"smo": OBSERVERS["smo"]})
    with pytest.raises(UserError, match="no observer can run; the first, smo, is refused: smo in lti: the plant"):
        all_observers.grid_of(STUDY, {"observers": "all"}, [])


@pytest.mark.nightly
@pytest.mark.usefixtures("few")
def test_suffices_takes_all():
    table = pcbench.suffices(STUDY, over="delay", below=10.0, between=(0.1, 0.2), observers="all", seeds=2, max_seeds=2)
    assert set(table.observer) == {"dkf", "open-loop"}
