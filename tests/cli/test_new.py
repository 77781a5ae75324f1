"""`pcbench new`: what it writes runs, passes the checks, and reads as a lesson; nothing is overwritten."""

import tomllib

import pytest
from commands import call

import pcbench
from pcbench import checking
from pcbench.checking import controller, plant
from pcbench.cli import new
from pcbench.scenarios import SCENARIOS
from pcbench.study import parse


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.nightly
def test_an_observer_passes_every_check(here, capsys):
    new.new("observer", "gentle-push")
    assert "pcbench check gentle_push.py:gentle_push" in capsys.readouterr().out
    found = checking.check("gentle_push.py:gentle_push")
    assert (found.kind, found.label, found.scenario) == ("observer", "gentle_push", "cart/white")
    assert [f.check for f in found.findings if f.verdict != "passes"] == []
    assert "NAME" not in (here / "gentle_push.py").read_text()


def commands(said):
    """The commands that are printed, word by word."""
    return [line.split()[1:] for line in said.splitlines() if line.startswith("  pcbench")]


@pytest.mark.nightly
def test_a_plant_passes_every_check_and_its_study_is_read(here, capsys):
    new.new("plant", "heavy-swing")
    assert capsys.readouterr().out.startswith("heavy_swing.py and heavy_swing.toml are written. Next:")
    found = checking.check("heavy_swing.py:heavy_swing")
    assert (found.kind, found.label, found.scenario) == ("plant", "heavy_swing", "")
    assert [f.check for f in found.findings] == ["numbers", *plant.CHECKS]
    assert {f.verdict for f in found.findings} == {"passes"}, found
    assert found.findings[0].why.endswith("axes: plant.length, plant.friction, plant.gravity, plant.strength")
    grid = parse.grid_of("heavy_swing.toml", {}, [])
    assert [cell.parameters for cell in grid.cells] == [{"length": 0.5}, {"length": 0.55}]
    assert list(grid.cells[0].options) == ["ekf", "kf", "model-only"]


@pytest.mark.ci
def test_a_controller_passes_every_check_and_closes_a_loop(here, capsys):
    new.new("controller", "brake")
    (check, run) = commands(capsys.readouterr().out)
    assert check == ["check", "brake.py:brake", "--set", "period=0.02"]
    found = checking.check("brake.py:brake", options={"period": 0.02})
    assert (found.kind, found.label, found.scenario) == ("controller", "brake", "cart/white")
    assert [f.check for f in found.findings] == ["options", *controller.CHECKS]
    assert {f.verdict for f in found.findings} == {"passes"}, found
    (cell,) = parse.grid_of(run[1], {}, run[3:]).cells
    assert (cell.scenario.loop.controller, cell.scenario.name) == ("brake", "cart/white")


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["plant", "controller", "observer", "scenario"])
def test_the_commands_that_are_printed_work_as_they_stand(here, kind):
    said = call("new", kind, "mine", cwd=here).stdout
    assert commands(said)
    for words in commands(said):
        done = call(*words, *(["--seeds", "4"] if words[0] == "run" else []), cwd=here)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.nightly
def test_the_plants_study_is_worth_running(here):
    """`ekf` beats the linear filter, both beat the model alone, and it finds the friction, of which it knew half a value."""
    new.new("plant", "swing")
    stats = pcbench.run("swing.toml", seeds=16).stats.query("metric == 'steady_rmse' and `plant.length` == 0.5")
    angle = stats[stats.signal == "angle"].set_index("observer")["mean"]
    assert angle["ekf"] < angle["kf"] < angle["model-only"]
    assert stats.query("signal == 'friction'")["mean"].item() < 0.1


@pytest.mark.nightly
def test_an_observer_of_ones_own_passes_on_a_plant_of_ones_own_in_a_loop(here):
    for kind, name in (("observer", "gentle"), ("plant", "swing"), ("controller", "brake")):
        new.new(kind, name)
    text = (here / "swing.toml").read_text() + '\n[controller]\nuse = "brake.py:brake"\nweight = 0.1\n'
    (here / "loop.toml").write_text(text)
    for target in ("swing.py:swing", "brake.py:brake", "gentle.py:gentle"):
        found = checking.check(target, "loop.toml").findings
        assert not [f for f in found if f.verdict == "fails"], (target, found)
    assert found[-1].check == "closed loop"


@pytest.mark.ci
def test_an_observer_runs_beside_others(here):
    new.new("observer", "mine")
    stats = pcbench.run("cart/slow", observers=["mine.py:mine", "model-only"], seeds=8).stats
    error = stats[(stats.metric == "steady_rmse") & (stats.signal == "position")].set_index("observer")["mean"]
    assert 0 < error["mine"] < error["model-only"]


def test_a_scenario_is_the_published_one_to_start_from(here):
    new.new("scenario", "bench1")
    study = parse.grid_of("bench1.toml", {}, []).study
    assert study.name == "bench1"
    (cell,) = parse.grid_of("bench1.toml", {}, []).cells
    known = SCENARIOS["cart/white"]
    assert (cell.scenario.sampling, cell.scenario.belief) == (known.sampling, known.belief)
    assert tomllib.loads((here / "bench1.toml").read_text())["scenario"]["plant"] == "cart"


@pytest.mark.parametrize(
    ("kind", "name", "file"),
    [("observer", "mine", "mine.py"), ("scenario", "mine", "mine.toml"), ("plant", "mine", "mine.toml")],
)
def test_what_is_there_is_not_overwritten(here, kind, name, file):
    path = here / file
    path.write_text("mine")
    with pytest.raises(pcbench.UserError, match="exists already, expected a new file"):
        new.new(kind, name)
    assert path.read_text() == "mine"
    assert list(here.iterdir()) == [path], "nothing is written where not all can be"


@pytest.mark.parametrize("name", ["observer.py", "plant.py", "controller.py"])
def test_a_lesson_is_short(name):
    assert len((new.TEMPLATES / name).read_text().splitlines()) <= 95


@pytest.mark.parametrize("name", ["", "two words", "1st", "a/b", "x" * 300])
def test_a_name_that_is_none_is_one_sentence(here, name):
    with pytest.raises(pcbench.UserError, match="new observer"):
        new.new("observer", name)
    assert not list(here.iterdir())
