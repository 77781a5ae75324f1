"""`observers = "all"` runs every observer that can run, and lists the others with their reasons."""

import pytest
from typer.testing import CliRunner

import pcbench
from pcbench.cli.commands import app
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.planning import all_observers
from pcbench.playback import replay
from pcbench.report import page
from pcbench.study import parse

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
        "duration": 1.0,
    },
}


@pytest.fixture
def few(monkeypatch):
    """Compiling thirty observers takes minutes; three show what is to be shown."""
    monkeypatch.setattr(all_observers, "OBSERVERS", {name: OBSERVERS[name] for name in ("smo", "kf", "model-only")})


def test_each_observer_is_planned_or_has_a_reason():
    study = all_observers.grid_of(STUDY, {"observers": "all"}, []).study
    assert sorted([*study.observers, *study.excluded]) == sorted(OBSERVERS)
    assert {"kf", "pccebo", "ekf", "model-only"} <= set(study.observers)
    assert "no unknown input" in study.excluded["smo"]


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("asked", ["all", ["all"], ["kf", "all"]])
def test_a_study_file_the_option_and_a_list_mean_the_same(asked):
    study = all_observers.grid_of(STUDY | {"observers": asked}, {}, []).study
    assert (study.observers, list(study.excluded)) == (["kf", "model-only"], ["smo"])


def test_an_observer_that_is_refused_in_one_cell_is_left_out(monkeypatch):
    """`no-delay` needs delays of whole samples in every cell."""
    monkeypatch.setattr(all_observers, "OBSERVERS", {name: OBSERVERS[name] for name in ("no-delay", "kf")})
    study = all_observers.grid_of(STUDY | {"axes": {"delay": [0.1, 0.15]}}, {"observers": "all"}, []).study
    assert study.observers == ["kf"]
    assert "whole" in study.excluded["no-delay"]


@pytest.mark.ci
@pytest.mark.usefixtures("few")
def test_reasons_are_said_once_and_stay_with_the_results(tmp_path):
    said = []
    result = pcbench.run(STUDY, observers="all", out=tmp_path / "out", on_warning=said.append)
    assert [each for each in said if "left out" in each] == [f"smo is left out of all observers: {REASON}"]
    assert set(result.stats.observer) == {"kf", "model-only"}
    again = pcbench.open_result(tmp_path / "out")
    assert again.provenance["excluded"] == again.study.excluded == {"smo": REASON}
    assert ("left out: smo", REASON) in page._provenance(again)


REASON = "smo in lti: the plant has no unknown input, expected a model with E [n, r], r > 0; use another observer."


def test_without_an_observer_that_can_run_the_first_reason_is_the_sentence(monkeypatch):
    monkeypatch.setattr(all_observers, "OBSERVERS", {"smo": OBSERVERS["smo"]})
    with pytest.raises(UserError, match="no observer can run; the first, smo, is refused: smo in lti: the plant"):
        all_observers.grid_of(STUDY, {"observers": "all"}, [])


@pytest.mark.ci
@pytest.mark.usefixtures("few")
def test_trace_and_replay_take_all(tmp_path, monkeypatch):
    """The log has no place for `kf`, as where it brings more samples on their way than an observer can keep."""
    frame = pcbench.simulate(STUDY, "all", log=tmp_path / "log")
    assert {"kf.x1", "model-only.x1"} <= set(frame.columns)
    assert frame.attrs["excluded"] == {"smo": REASON}
    real = replay.prepare_observers

    def picky(playback, *given):
        if "kf" in playback.cell.options:
            raise UserError("kf has no room.")
        return real(playback, *given)

    monkeypatch.setattr(replay, "prepare_observers", picky)
    found = pcbench.replay(tmp_path / "log", STUDY, "all")
    assert set(found.metrics.observer) == {"model-only"}
    assert found.summary["notes"][:2] == [f"{o} is left out of all observers: {why}" for o, why in LEFT_OUT.items()]
    with pytest.raises(UserError, match=r"kf has no room"):
        pcbench.replay(tmp_path / "log", STUDY, ["kf", "all"])
    monkeypatch.setattr(all_observers, "OBSERVERS", {"kf": OBSERVERS["kf"]})
    with pytest.raises(UserError, match=r": no observer can run; the first is refused: kf has no room"):
        pcbench.replay(tmp_path / "log", STUDY, "all")


LEFT_OUT = {"smo": REASON, "kf": "kf has no room."}


@pytest.mark.usefixtures("few")
def test_show_names_the_observers_of_all_that_can_run(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('observers = "all"\nscenarios = ["cart/slow"]\n')
    done = CliRunner().invoke(app, ["show", str(file)])
    assert done.exit_code == 0, done.output
    assert "observers: kf, model-only" in done.output
    assert "smo is left out of all observers: smo in cart/slow" in done.output


@pytest.mark.parametrize("tuning", ["published", ["published", "design"]])
def test_an_observer_without_a_design_is_left_out_where_designs_are_compared(tuning, monkeypatch):
    """`chain` by default takes poles; by design it solves a Riccati equation, which has no solution for this plant."""
    monkeypatch.setattr(all_observers, "OBSERVERS", {name: OBSERVERS[name] for name in ("chain", "kf", "pccebo")})
    study = {"name": "d", "scenarios": ["cart/gaussian"], "tuning": tuning}
    found = all_observers.grid_of(study, {"observers": ["all"]}, []).study
    assert found.observers == (["chain", "kf", "pccebo"] if tuning == "published" else ["kf", "pccebo"])
    assert tuning == "published" or "Riccati" in found.excluded["chain"]


@pytest.mark.parametrize("ask", [pcbench.tune, pcbench.design])
def test_what_takes_one_observer_refuses_all_in_one_sentence(ask):
    with pytest.raises(UserError, match=r"^cart/slow: observers: got 'all', expected the name of one observer here"):
        ask("cart/slow", "all")


def test_all_in_a_table_names_the_place_where_it_belongs():
    study = STUDY | {"lti": STUDY["lti"] | {"observers": ["all"]}}
    with pytest.raises(
        UserError, match=r'lti\.observers: got "all", .* write observers = "all" at the top of the study'
    ):
        parse.grid_of(study, {}, [])


@pytest.mark.nightly
@pytest.mark.usefixtures("few")
def test_suffices_takes_all():
    table = pcbench.find_limit(
        STUDY, axis="delay", threshold=10.0, between=(0.1, 0.2), observers="all", seeds=2, max_seeds=2
    )
    assert set(table.observer) == {"kf", "model-only"}
