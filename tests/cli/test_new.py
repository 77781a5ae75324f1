"""`pcbench new`: what it writes runs, passes the checks, and reads as a lesson; nothing is overwritten."""

import tomllib

import pytest

import pcbench
from pcbench import checking
from pcbench.cli import creating
from pcbench.scenarios import SCENARIOS
from pcbench.study import read


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_observer_passes_every_check(here, capsys):
    creating.new("observer", "gentle-push")
    assert "pcbench check gentle_push.py:gentle_push" in capsys.readouterr().out
    found = checking.check("gentle_push.py:gentle_push")
    assert (found.kind, found.label, found.scenario) == ("observer", "gentle_push", "cart/white")
    assert [f.check for f in found.findings if f.verdict != "passes"] == []
    assert "NAME" not in (here / "gentle_push.py").read_text()


def test_an_observer_runs_beside_others(here):
    creating.new("observer", "mine")
    stats = pcbench.run("cart/slow", observers=["mine.py:mine", "open-loop"], seeds=8).stats
    error = stats[(stats.metric == "tail_rmse") & (stats.signal == "position")].set_index("observer")["mean"]
    assert 0 < error["mine"] < error["open-loop"]


def test_a_scenario_is_the_published_one_to_start_from(here):
    creating.new("scenario", "bench1")
    study = read.study_of("bench1.toml", {}, [])
    assert study.name == "bench1"
    (cell,) = read.grid_of("bench1.toml", {}, []).cells
    known = SCENARIOS["cart/white"]
    assert (cell.scenario.sampling, cell.scenario.belief) == (known.sampling, known.belief)
    assert tomllib.loads((here / "bench1.toml").read_text())["scenario"]["plant"] == "cart"


@pytest.mark.parametrize(("kind", "name"), [("observer", "mine"), ("scenario", "mine")])
def test_what_is_there_is_not_overwritten(here, kind, name):
    creating.new(kind, name)
    path = here / ("mine.py" if kind == "observer" else "mine.toml")
    path.write_text("mine")
    with pytest.raises(pcbench.UserError, match="is there already, expected a new file"):
        creating.new(kind, name)
    assert path.read_text() == "mine"


@pytest.mark.parametrize("name", ["", "two words", "1st", "a/b", "x" * 300])
def test_a_name_that_is_none_is_one_sentence(here, name):
    with pytest.raises(pcbench.UserError, match="new observer"):
        creating.new("observer", name)
    assert not list(here.iterdir())
