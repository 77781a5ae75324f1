"""Names of signals and their units: a few characters, checked in every place where a file or a function gives them."""

import re
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import pytest

import pcbench
from pcbench import signal_names
from pcbench.errors import UserError
from pcbench.recordings import readers
from pcbench.study import parse
from pcbench.study.plugins import registry, user_plants
from pcbench.study.plugins.user_code import Code

UNITS = ["m", "rad/s", "kg*m^2", "m^-1", "1e8 m3", "degC", "°C", "µm", "1/(s m)", "m^(1/2)", "%", "unit squared"]
HOSTILE = [
    "m*/ int x; /*",
    "/*",
    "a\\",
    "m??/",
    "m^^5cinput",
    "m}\\input{/etc/hostname}",
    "$x$",
    "<b>",
    "m\x1b[2J",
    "m\u202e",
    "[red]",
    "m&",
    "m#",
    "m_2",
    "m~",
    "m\n",
    "m" * 41,
]
TAKEN = ["t", "u1", "y12", "sigma", "seed", "tick", "cell", "scenario"]  # columns of traces, recordings and tables
EMPTY = Code("mine.py", "pendulum", (), "")


class Numbers(NamedTuple):
    """A plant with one number."""

    friction: float = 0.1


@cache
def own_plant(states=("angle [rad]", "rate [rad/s]"), unit="1/s", outputs=()):
    return pcbench.make_plant(
        field=lambda p, now, x: jnp.stack([x[1], now.u[0] - p.friction * x[1]]),
        output=lambda p, now, x: x[:1],
        states=list(states),
        outputs=outputs,
        numbers=Numbers(),
        operating_point=([0.0, 0.0], [0.0]),
        unknown_parameters={"friction": unit},
    )


def study(**lti):
    given = {"A": [[0.0]], "B": [[1.0]], "C": [[1.0]], "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.1}
    return parse.parse({"name": "q", "lti": given | lti}, "q")


def scenario(**table):
    return parse.parse({"name": "q", "scenario": table}, "q")


def recording(tmp_path, what, unit):
    path = tmp_path / "log.toml"
    tables = {"channels": "y1", "inputs": "u1", "truth": "position"}
    lines = [f"[{w}.{n}]\nfield = 'a'\nunit = {unit if w == what else 'm'!r}" for w, n in tables.items()]
    (tmp_path / "x.csv").write_text("t,a\n0,1\n")
    path.write_text("log = 'x.csv'\n" + "\n".join(lines), encoding="utf-8")
    return readers.open_log(path)


PLACES = {
    "states of a linear plant": lambda text, tmp_path: study(states=[text]),
    "states of a scenario": lambda text, tmp_path: scenario(base="cart/white", signals=[text, "velocity"]),
    "unknowns of a scenario": lambda text, tmp_path: scenario(
        base="helicopter/constant", unknowns=[text, "other"], headline=["pitch"]
    ),
    "states of a plant's function": lambda text, tmp_path: own_plant(states=(text, "rate")),
    "outputs of a plant's function": lambda text, tmp_path: own_plant(outputs=(text,)),
    "outputs of a plant that is an entry": lambda text, tmp_path: registry._plant(
        own_plant()._replace(outputs=((text.partition(" ")[0], text.partition(" [")[2][:-1] or "1"),)), None, "mine.py"
    ),
    "outputs of a plant in a dataset": lambda text, tmp_path: user_plants.absent(
        "code/1/mine.py:pendulum",
        EMPTY,
        user_plants.facts(own_plant()) | {"outputs": [[text.partition(" ")[0], text.partition(" [")[2][:-1] or "1"]]},
    ),
    "states of a plant that is an entry": lambda text, tmp_path: registry._plant(
        own_plant()._replace(signals=((text.partition(" ")[0], text.partition(" [")[2][:-1] or "1"), ("rate", "1"))),
        None,
        "mine.py",
    ),
    "states of a plant in a dataset": lambda text, tmp_path: user_plants.absent(
        "code/1/mine.py:pendulum",
        EMPTY,
        user_plants.facts(own_plant())
        | {"signals": [[text.partition(" ")[0], text.partition(" [")[2][:-1] or "1"], ["rate", "1"]]},
    ),
}
UNIT_ONLY = {
    "input of a linear plant": lambda unit, tmp_path: study(input={"signal": "step", "unit": unit}),
    "input of a scenario": lambda unit, tmp_path: scenario(
        base="cart/white", input={"signal": "step", "amplitude": 1.0, "unit": unit}
    ),
    "unknown input": lambda unit, tmp_path: study(E=[[1.0]], unknown_input={"signal": "step", "unit": unit}),
    "unknown of a plant's function": lambda unit, tmp_path: own_plant(unit=unit),
    "channel of a recording": lambda unit, tmp_path: recording(tmp_path, "channels", unit),
    "input of a recording": lambda unit, tmp_path: recording(tmp_path, "inputs", unit),
    "state of a recording": lambda unit, tmp_path: recording(tmp_path, "truth", unit),
}


@pytest.mark.parametrize("unit", UNITS)
def test_signal_names_accept_units_of_physics(unit):
    assert signal_names.name_and_unit(f" speed [{unit}] ", "q") == ("speed", unit)
    assert signal_names.name_and_unit("speed", "q") == ("speed", "1")


@pytest.mark.parametrize("unit", HOSTILE)
def test_signal_names_refuse_a_unit_that_another_language_could_obey(unit):
    with pytest.raises(UserError, match=r"got the unit|expected a name with a unit"):
        signal_names.name_and_unit(f"speed [{unit}]", "q")
    with pytest.raises(UserError, match="got the unit"):
        signal_names.unit(unit, "q")


@pytest.mark.parametrize("place", PLACES)
def test_every_place_of_a_name_checks_it(place, tmp_path):
    for bad in ("angle [m*/]", "t [s]", "u1 [V]", "a" * 61 + " [m]"):
        with pytest.raises(UserError, match=r"got the unit 'm\*/'|which another column|expected a name with a unit"):
            PLACES[place](bad, tmp_path)
    PLACES[place]("height [m]", tmp_path)


@pytest.mark.parametrize("place", UNIT_ONLY)
def test_every_place_of_a_unit_checks_it(place, tmp_path):
    with pytest.raises(UserError, match=re.escape("got the unit 'm*/'")):
        UNIT_ONLY[place]("m*/", tmp_path)
    if "recording" not in place:
        UNIT_ONLY[place]("V", tmp_path)


@pytest.mark.parametrize("name", TAKEN)
def test_a_state_cannot_have_the_name_of_another_column(name):
    with pytest.raises(UserError, match=f"q: lti.states: got the name '{name}', which another column"):
        study(states=[f"{name} [m]"])
    assert study(states=[f"{name}_state [m]"]).lti.states


def test_an_observer_cannot_have_the_label_of_set_points():
    with pytest.raises(UserError, match="as 'target', which is pcbench's own name"):
        parse.parse({"name": "q", "scenarios": ["cart/white"], "observers": ["mine.py:target"]}, "q")
