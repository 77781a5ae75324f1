"""Plants, controllers and scenarios of a user's own by name: found where a name of pcbench's may stand; else one sentence."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pcbench
from pcbench.cli import catalogue
from pcbench.controllers.parts.common import ControllerContext
from pcbench.dataset import serialize
from pcbench.dynamics.linear import Model
from pcbench.planning import plan
from pcbench.plants import entry_of
from pcbench.study import controller_table, parse
from pcbench.study.plugins import registry, user_controllers

SOURCE = Path(__file__).parents[1] / "support" / "own_loop.py"
TABLE = {"plant": "mine.py:pendulum", "x0": [0.2, 0.0], "prior_std": [0.1, 0.1], "sampling_period": 0.05, "delay": 0.1,
         "noise_std": 1e-3, "dt": 0.01, "duration": 0.5, "observers": ["kf"]}  # fmt: skip
STUDY = {"name": "mine", "seeds": 4, "scenario": TABLE}
LAW = {"use": "mine.py:law", "kp": 3.0}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder with a plant, a law and a scenario in mine.py."""
    shutil.copy(SOURCE, tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cell(raw):
    (found,) = parse.grid_of(raw, {}, []).cells
    return found


@pytest.mark.ci
def test_a_plant_and_a_law_stand_where_names_of_pcbench_do(here):
    found = cell(STUDY | {"controller": LAW})
    module = sys.modules[f"mine_{found.scenario.user_code['plant'].code.digest}"]
    assert entry_of(found.scenario) is module.pendulum
    assert (found.scenario.plant, found.scenario.loop.controller) == ("pendulum", "law")
    assert found.scenario.flat()["code"].keys() == {"plant", "controller"}
    (p,) = plan(parse.grid_of(STUDY | {"controller": LAW}, {}, []).study)
    assert p.layout.controller is module.law
    assert float(p.problem.control.kp) == 3.0


def test_paths_are_from_the_study_file_in_every_table(here, monkeypatch):
    (here / "deep").mkdir()
    lines = [f"{k} = {v!r}" for k, v in (TABLE | {"plant": "../mine.py:pendulum"}).items()]
    (here / "deep" / "s.toml").write_text(
        "\n".join(["[scenarios.one]", *lines, "[scenarios.two]", "use = '../mine.py:late'", "loss = 0.1"])
    )
    monkeypatch.chdir("/")
    study, every = parse.grid_of(str(here / "deep" / "s.toml"), {}, [])
    assert study.scenarios == ["one", "two"]
    assert [c.scenario.plant for c in every] == ["pendulum", "pendulum"]
    assert [c.scenario.sampling.loss for c in every] == [0.0, 0.1]
    assert [c.scenario.loop.controller for c in every] == ["", "law"]


def test_a_scenario_is_read_as_data_with_the_objects_of_its_module(here):
    for raw in ("mine.py:late", {"name": "s", "scenarios": ["mine.py:late"]}):
        found = cell(raw)
        assert (found.scenario.name, found.scenario.belief.prior_std) == ("late", (0.1, 0.1))
        assert entry_of(found.scenario) is sys.modules[f"mine_{found.scenario.user_code['plant'].code.digest}"].pendulum
    study = parse.grid_of({"name": "s", "scenarios": ["mine.py:late", "cart/white"], "observers": ["kf"]}, {}, []).study
    assert study.tables["late"].plant == "mine.py:pendulum"
    again = parse.grid_of(study, {}, []).study
    assert again.model_dump() == study.model_dump(), "it is a study of data: read twice, it is the same"


def test_an_observer_is_named_beside_them(here):
    shutil.copy(SOURCE.with_name("own_observer.py"), here / "other.py")
    raw = STUDY | {"scenario": TABLE | {"observers": ["other.py:nudge", "kf"]}}
    assert list(cell(raw).options) == ["nudge", "kf"]


PROJECT = """[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "swing-observers"
version = "1.0"
[project.entry-points."pcbench.observers"]
gentle = "swing_package.observer:nudge"
[project.entry-points."pcbench.plants"]
swing = "swing_package.loop:pendulum"
[project.entry-points."pcbench.controllers"]
push = "swing_package.loop:law"
[project.entry-points."pcbench.scenarios"]
"swing/late" = "swing_package.loop:late"
[tool.hatch.build.targets.wheel]
packages = ["swing_package"]
"""


def test_a_package_that_is_built_and_installed_offers_all_four_by_plain_names(here, monkeypatch):
    (here / "swing_package").mkdir()
    (here / "swing_package" / "__init__.py").touch()
    shutil.copy(SOURCE, here / "swing_package" / "loop.py")
    shutil.copy(SOURCE.with_name("own_observer.py"), here / "swing_package" / "observer.py")
    (here / "pyproject.toml").write_text(PROJECT)
    alone = ["--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *alone, "--target", str(here / "site"), str(here)]
    done = subprocess.run(pip, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(here / "swing_package")
    monkeypatch.syspath_prepend(str(here / "site"))
    assert registry.find_plugins("plant")["swing"] == ("swing_package.loop:pendulum", "swing-observers")
    for kind, name in (
        ("observers", "gentle"),
        ("plants", "swing"),
        ("controllers", "push"),
        ("scenarios", "swing/late"),
    ):
        assert catalogue.list_catalogue(kind)[name]["summary"] == "from the package swing-observers"
    parse.grid_of(STUDY, {}, [])
    assert "swing_package" not in sys.modules, "nothing is imported that is not named"
    raw = {"scenario": TABLE | {"plant": "swing", "observers": ["gentle", "kf"]}, "controller": {"use": "push"}}
    found = cell(STUDY | raw)
    assert (found.scenario.plant, found.scenario.loop.controller) == ("pendulum", "law")
    assert found.entry("gentle").observer is sys.modules["swing_package.observer"].nudge
    assert entry_of(cell({"name": "s", "scenarios": ["swing/late"]}).scenario).signals[0] == ("angle", "rad")
    assert catalogue.list_catalogue("controllers", "push")["push"]["options"]["kp"]["default"] == 2.0


def test_a_planned_cell_takes_plant_and_law_along(here):
    """Another process needs no file: functions and types are found again in the code that travels."""
    (p,) = plan(parse.grid_of(STUDY | {"controller": LAW}, {}, []).study)
    parcel = serialize.pack(p)
    assert isinstance(parcel, bytes)
    name = f"mine_{p.cell.scenario.user_code['plant'].code.digest}"
    del sys.modules[name]
    (here / "mine.py").unlink()
    back = serialize.unpack(parcel)
    module = sys.modules[name]
    assert (back.layout.plant, back.layout.controller) == (module.pendulum.plant, module.law)
    assert type(back.problem.control) is module.Params
    assert back.cell.digest == p.cell.digest


def test_a_law_without_a_linear_one_is_linearised(here, caplog):
    """[kept, x] -> [kept, u] by jax: what the law says on paper, to the bit."""
    law = registry.load("controller", "mine.py:law", "here")
    n, m = 2, 1
    model = Model(A=np.zeros((n, n)), B=np.ones((n, m)), C=np.eye(1, n))
    told = ControllerContext(
        model=model, dt=0.1, ticks=1, rows=1, lookahead=0, late=0, states=("a", "b"), delay=lambda t: t
    )
    found = law.entry.linear(law.entry.options(kp=2.0, ki=0.5), told)
    for got, want in zip(found, ([[1.0]], [[0.05, 0.0]], [[-1.0]], [[-2.05, 0.0]]), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-15)
    looks = law.entry.controller._replace(command=lambda p, now, x, coming, kept: (coming(0), kept))
    assert user_controllers.linearize_law(looks, law.entry.prepare, law.entry.options(), told) is None
    raises = law.entry.controller._replace(command=lambda p, now, x, coming, kept: 1 // 0)
    with caplog.at_level("INFO"):
        assert user_controllers.linearize_law(raises, law.entry.prepare, law.entry.options(), told) is None
    assert "is not linearised: ZeroDivisionError: " in caplog.text


def test_a_law_that_does_not_settle_is_told_so_by_its_eigenvalue(here):
    (sentence,) = parse.stability_warnings(parse.grid_of(STUDY | {"controller": LAW | {"kp": -40.0}}, {}, []))
    assert "law does not stabilise the plant of mine" in sentence
    assert "closed loop has the eigenvalue" in sentence
    with (
        pytest.warns(UserWarning, match="law does not stabilise"),
        pytest.raises(pcbench.UserError, match="contains other files"),
    ):
        pcbench.run(STUDY | {"controller": LAW | {"kp": -40.0}}, out=here)
    assert not parse.stability_warnings(parse.grid_of(STUDY | {"controller": LAW}, {}, []))
    assert controller_table.has_generic_controller(cell(STUDY | {"controller": LAW}).scenario)


WRONG = {
    "no file": ({"plant": "mien.py:pendulum"}, {}, "mine: plant: 'mien.py' is no file; did you mean 'mine.py'?"),
    "no such name": ({"plant": "mine.py:pendulun"}, {}, "'pendulun' is no plant there; did you mean 'pendulum'?"),
    "a law for a plant": (
        {"plant": "mine.py:law"},
        {},
        "plant: got a controller, expected what pcbench.make_plant returns",
    ),
    "a plant for a law": ({}, {"use": "mine.py:pendulum"}, "controller: got a plant, expected a pcbench.Controller"),
    "a function": ({}, {"use": "mine.py:command"}, "controller: got a function, expected a pcbench.Controller"),
    "no plant of pcbench's": ({"plant": "pendulum"}, {}, "'pendulum' is no plant (or MODULE:NAME)"),
    "an option unknown": ({}, LAW | {"kq": 1.0}, "controller: 'kq' is no option of mine.py:law; did you mean 'kp'?"),
    "an option of another kind": ({}, LAW | {"kp": "much"}, "controller: kp: got 'much'"),
    "x0 too long": ({"x0": [0.0] * 3}, {}, "scenario.x0: got 3 numbers, expected 2, one for each state of pendulum"),
    "an axis of another plant": ({}, {}, "'plant.lam' is no axis of mine"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_one_sentence(here, what):
    table, law, sentence = WRONG[what]
    raw = STUDY | {"scenario": TABLE | table} | ({"controller": law} if law else {})
    raw |= {"axes": {"plant.lam": [1.0]}} if what == "an axis of another plant" else {}
    with pytest.raises(pcbench.UserError) as error:
        parse.grid_of(raw, {}, [])
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


BROKEN = {
    "prepare raises": ("    return Params(", "    raise KeyError('kd')\n    return Params(",
                       "controller law: prepare: got KeyError: 'kd', mine.py line 43, expected a pytree of arrays"),
    "a command too long": ("return -params.kp * estimate[:1] - kept, kept", "return -params.kp * estimate - kept, kept",
                           "controller law: command returned shape (2,) of float64, expected (1,)"),
    "no pair": ("return -params.kp * estimate[:1] - kept, kept", "return -params.kp * estimate[:1]",
                "command returned no pair, expected (command, memory)"),
    "it keeps more": ("- kept, kept", "- kept, (kept, kept)", "expected what start returns, shape (1,) of float64"),
    "a set point too long": ("jnp.zeros(2)", "jnp.zeros(3)", "target returned shape (3,), expected the set point"),
    "python if": ("    kept = kept +", "    if estimate[0] > 0: return 0, 0\n    kept = kept +", "command cannot be traced"),
    "no prepare": ("def prepare(", "def prepared(", "without a function prepare(options, context)"),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("what", BROKEN)
def test_a_law_that_breaks_the_protocol_is_named(here, what):
    old, new, sentence = BROKEN[what]
    text = (here / "mine.py").read_text()
    assert old in text
    (here / "mine.py").write_text(text.replace(old, new))
    with pytest.raises(pcbench.UserError) as error:
        plan(parse.grid_of(STUDY | {"controller": LAW}, {}, []).study)
    assert sentence in str(error.value)


def test_a_scenario_that_is_none_is_one_sentence(here):
    with pytest.raises(pcbench.UserError, match="got a controller, expected a dict with the keys of a table"):
        parse.grid_of("mine.py:law", {}, [])
    with pytest.raises(pcbench.UserError, match=r"write \[scenarios.ANOTHER\]"):
        parse.grid_of({"name": "s", "scenarios": ["mine.py:late", "mine:late"]}, {}, [])
    (here / "mine.py").write_text((here / "mine.py").read_text().replace('"plant": pendulum', '"plant": Numbers()'))
    with pytest.raises(pcbench.UserError, match="plant: got a Numbers, expected what pcbench"):
        parse.grid_of("mine.py:late", {}, [])
