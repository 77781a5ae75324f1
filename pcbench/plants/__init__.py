"""The plants, one file each, and the dict that names them."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from pcbench.dynamics.linear import Model
from pcbench.plants import arm, cart, csth, helicopter, lti
from pcbench.protocols import Plant
from pcbench.scenarios import Scenario


class Entry(NamedTuple):
    """A plant with what the tables and the observers need to know of it."""

    plant: Plant
    signals: tuple[tuple[str, str], ...]  # (state, unit); empty: the scenario's
    numbers: Any  # default parameters, a NamedTuple
    nominal: Callable[[Any], Model]  # the linear model that observers know
    prepare: Callable[[Any, float, int], Any]  # (numbers, dt [s], ticks) -> params
    summary: str
    unknowns: tuple[tuple[str, str], ...] = ()  # (what observers may estimate beside the states, unit)
    heavy: bool = False  # a tick costs so much that fewer lanes a call, and one tick in a loop's body, are as fast
    model: Callable[..., Any] | None = None  # (params, now, x, unknowns) -> dx/dt; None: `nominal` is the model
    parts: Callable[..., Any] | None = None  # (params, u, x) -> a, phi of accelerations a p + phi with parameters p
    inverse: Callable[..., Any] | None = None  # (params, unknowns, path, rates, accelerations) -> u
    positive: tuple[str, ...] = ()  # parameters that must be greater than 0
    signs: tuple[str, ...] = ()  # parameters that are 1 or -1
    ranges: tuple[tuple[float, float], ...] = ()  # of the unknowns, where observers look for them; empty: anywhere
    drifts: bool = True  # whether `drift` has an effect; of a plant of one's own where it differs from the model


PLANTS = {
    "cart": Entry(
        plant=cart.PLANT,
        signals=cart.SIGNALS,
        numbers=cart.Numbers(),
        nominal=cart.nominal,
        prepare=cart.prepare,
        summary="mobile cart under a camera, 2 states",
        signs=("drift_sign",),
    ),
    "csth": Entry(
        plant=lti.PLANT,
        signals=csth.SIGNALS,
        numbers=csth.Numbers(),
        nominal=csth.nominal,
        prepare=csth.prepare,
        summary="stirred tank heater with three slow sensors, 3 states",
        drifts=False,
    ),
    "arm": Entry(
        plant=arm.PLANT,
        signals=arm.SIGNALS,
        numbers=arm.Numbers(),
        nominal=arm.nominal,
        prepare=arm.prepare,
        summary="flexible-joint arm pushed by an unknown input, 4 states",
        unknowns=arm.UNKNOWNS,
        heavy=True,
    ),
    "helicopter": Entry(
        plant=helicopter.PLANT,
        signals=helicopter.SIGNALS,
        numbers=helicopter.Numbers(),
        nominal=helicopter.nominal,
        prepare=helicopter.prepare,
        summary="helicopter with two degrees of freedom and unknown viscosities, 4 states",
        unknowns=helicopter.UNKNOWNS,
        heavy=True,
        model=helicopter.model,
        parts=helicopter.parts,
        inverse=helicopter.inverse,
        positive=("Jth", "Jps", "m", "l", "g", "Bth", "Bps"),
        ranges=helicopter.RANGE,
    ),
    "lti": Entry(
        plant=lti.PLANT,
        signals=(),
        numbers=lti.Numbers(),
        nominal=lti.nominal,
        prepare=lti.prepare,
        summary="any linear plant of your own: a study's table [lti]",
        drifts=False,
    ),
}


def states_of(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """Return (state, unit) of every state of a scenario's plant."""
    return scenario.scoring.signals or PLANTS[scenario.plant].signals


def signals_of(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """Return (signal, unit) of all that observers may estimate: the states, and what the plant has of unknowns."""
    return states_of(scenario) + (scenario.scoring.unknowns or PLANTS[scenario.plant].unknowns)


def numbers_of(scenario: Scenario) -> Any:
    """Return a plant's numbers as observers know them."""
    return PLANTS[scenario.plant].numbers._replace(**scenario.belief.model)


def varied(numbers: Any, given: Mapping[str, Any]) -> Any:
    """Return a plant's numbers with some changed; those that a plant of one's own has named are among its `own`."""
    fields = {name: v for name, v in given.items() if name in numbers._fields}
    named = {name: v for name, v in given.items() if name not in fields}
    out = numbers._replace(**fields)
    if not named:
        return out
    plant = {name: v for name, v in out.plant.items() if name not in named}
    return out._replace(own={**out.own, **named}, plant=plant)


def drifts(scenario: Scenario) -> bool:
    """Say whether the axis `drift` has an effect in a scenario."""
    return PLANTS[scenario.plant].drifts or "plant" in scenario.truth.parameters


def nonlinear(plant: str) -> bool:
    """Say whether observers are told a nonlinear model of a plant."""
    return PLANTS[plant].model is not None


def positive_of(plant: str) -> tuple[str, ...]:
    """Return the names of a plant's parameters that must be greater than 0."""
    return PLANTS[plant].positive


def signs_of(plant: str) -> tuple[str, ...]:
    """Return the names of a plant's parameters that are 1 or -1."""
    return PLANTS[plant].signs


def parameters_of(plant: str) -> list[str]:
    """Return the names of a plant's parameters that a study may vary."""
    numbers = PLANTS[plant].numbers._asdict()
    return [name for name, v in numbers.items() if type(v) is float and name != "drift"]


def parameters_in(scenario: Scenario) -> list[str]:
    """Return the names of the parameters that a study of a scenario may vary, those that its plant has named among them."""
    return [*parameters_of(scenario.plant), *scenario.belief.model.get("own", {})]
