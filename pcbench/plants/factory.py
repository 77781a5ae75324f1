"""A plant of a user's own from its equations: checked once, and then a plant like any other.

import jax.numpy as jnp
import pcbench

class Numbers(NamedTuple):
length: float = 0.5  # m
friction: float = 0.1  # 1/s

def field(p, now, x):
return jnp.stack([x[1], -9.81 / p.length * jnp.sin(x[0]) - p.friction * x[1] + now.u[0]])

pendulum = pcbench.make_plant(
field=field,
output=lambda p, now, x: x[:1],
states=["angle [rad]", "rate [rad/s]"],
numbers=Numbers(),
operating_point=([0.0, 0.0], [0.0]),
unknown_parameters={"friction": ("1/s", 0.0, 1.0)},
)
"""

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax import Array

from pcbench.errors import UserError, shown, unknown
from pcbench.plants import nonlinear, trial
from pcbench.plants.entry import PlantSpec
from pcbench.plants.nonlinear import Equations, PlantFunction
from pcbench.plants.trial import WHERE
from pcbench.protocols import Now, Plant
from pcbench.signal_names import names_and_units, unit

Function = Callable[[Any, Now, Array], Any]  # (numbers, now, x[n]) -> an array, or a list of its entries
Range = str | tuple[str, float, float]  # a unit, or (unit, least, most) where observers look for the value


class NoNumbers(NamedTuple):
    """Of a plant whose functions hold all their numbers themselves."""


def make_plant(
    *,
    output: Function,
    states: Sequence[str],
    operating_point: Sequence[Any],
    field: Function | None = None,
    step: Function | None = None,
    tick: float | None = None,
    numbers: Any = None,
    unknown_inputs: Mapping[str, Range] | None = None,
    unknown_parameters: Mapping[str, Range] | None = None,
    positive: Sequence[str] = (),
    summary: str = "a plant of one's own",
) -> PlantSpec:
    """Return a plant from its equations: x' = field(numbers, now, x), or x one tick later = step(...), and y = output(...).

    `states` are names with units, such as "angle [rad]". `numbers` is a NamedTuple of floats (each is an axis, `plant.<name>`)
    and lists; the functions get it with arrays, and write jax.numpy. `operating_point` is (x0 [n], u0 [m]): signals, inputs and
    measured outputs of the benchmark are deviations from it, the functions see whole ones. Where it is an equilibrium, linear
    observers work on the Jacobians there; `ekf` works anywhere. `step` needs `tick` [s], which is then a scenario's dt.
    `unknown_inputs` and `unknown_parameters` are names among `numbers` that observers are not told and may estimate, inputs
    first: each with a unit, or (unit, least, most). An unknown input is the scenario's signal `unknown_input`.
    Raises UserError for shapes that do not fit, and where a function or its slope is not finite at the operating point.
    """
    x0, u0 = _point(operating_point)
    signals = names_and_units(states, f"{WHERE}: states")
    if len(signals) != len(x0):
        raise UserError(
            f"{WHERE}: states: got {len(signals)} names, expected {len(x0)}, one for each state of the operating point."
        )
    if (field is None) == (step is None) or (step is None) != (tick is None):
        raise UserError(
            f"{WHERE}: got {_given(field, step, tick)}, expected field, or step with its tick in seconds; give one."
        )
    numbers = NoNumbers() if numbers is None else numbers
    pushed, sought = dict(unknown_inputs or {}), dict(unknown_parameters or {})
    kept = _numbers(numbers, pushed, sought)
    for name in positive:
        if name not in kept._fields:
            raise unknown(f"{WHERE}: positive", "number", name, kept._fields)
    e = Equations(
        field=field,
        step=step,
        output=output,
        tick=tick,
        numbers=type(numbers),
        inputs=tuple(pushed),
        parameters=tuple(sought),
        x0=x0,
        u0=u0,
        y0=(),
    )
    e = e._replace(y0=trial.tried(e, kept))
    units = [
        (name, unit(each if isinstance(each, str) else each[0], f"{WHERE}: {name}"))
        for name, each in (pushed | sought).items()
    ]
    return PlantSpec(
        plant=Plant(
            step=PlantFunction(nonlinear.step, e),
            output=PlantFunction(nonlinear.output, e),
            field=PlantFunction(nonlinear.field, e) if field is not None else None,
            unknown=PlantFunction(nonlinear.unknown, e) if units else None,
        ),
        signals=signals,
        numbers=kept,
        nominal=PlantFunction(nonlinear.nominal, e),
        prepare=PlantFunction(nonlinear.prepare, e),
        summary=summary,
        unknowns=tuple(units),
        heavy=True,
        model=PlantFunction(nonlinear.model, e) if field is not None else None,
        successor=PlantFunction(nonlinear.successor, e) if step is not None else None,
        sensor=PlantFunction(nonlinear.sensor, e),
        residual=PlantFunction(nonlinear.residual, e),
        positive=tuple(positive),
        drifts="drift" in kept._fields,
        ranges=tuple(_range(name, each) for name, each in (pushed | sought).items()),
        operating_point=(x0, u0),
        tick=tick,
    )


def _point(given: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The operating point as plain numbers."""
    try:
        x0, u0 = (tuple(float(v) for v in np.asarray(part, float).reshape(-1)) for part in given)
    except (TypeError, ValueError):
        raise UserError(
            f"{WHERE}: operating_point: got {shown(given)}, expected a pair (x0 [n], u0 [m]) of lists of numbers."
        ) from None
    if not x0 or not u0 or not np.isfinite([*x0, *u0]).all():
        raise UserError(
            f"{WHERE}: operating_point: got {shown(given)}, expected at least one state and one input, all finite."
        )
    return x0, u0


def _given(field: Any, step: Any, tick: Any) -> str:
    there = [name for name, each in (("field", field), ("step", step), ("tick", tick)) if each is not None]
    return " and ".join(there) or "neither field nor step"


def _numbers(numbers: Any, pushed: Mapping[str, Range], sought: Mapping[str, Range]) -> Any:
    """The plant's numbers as the benchmark varies them: floats, and tuples of them; without unknown inputs."""
    names = getattr(numbers, "_fields", None)
    if names is None:
        raise UserError(
            f"{WHERE}: numbers: got {shown(numbers)}, expected a NamedTuple of numbers; make one with defaults."
        )
    for what, given in (("unknown_inputs", pushed), ("unknown_parameters", sought)):
        for name in given:
            if name not in names:
                raise unknown(f"{WHERE}: {what}", "number of the plant", name, names)
    if twice := set(pushed) & set(sought):
        raise UserError(
            f"{WHERE}: got '{min(twice)}' as an unknown input and an unknown parameter, expected one of them."
        )
    kept: dict[str, Any] = {}
    for name, value in zip(names, numbers, strict=True):
        try:
            array = np.asarray(value, float)
        except (TypeError, ValueError):
            raise UserError(
                f"{WHERE}: numbers.{name}: got {shown(value)}, expected a number or an array of them."
            ) from None
        if (name in pushed or name in sought) and array.ndim:
            raise UserError(
                f"{WHERE}: numbers.{name}: got {shown(value)}, expected one number: it is unknown to observers."
            )
        if name not in pushed:
            kept[name] = float(array) if not array.ndim else _tuples(array.tolist())
    if pushed:
        kept["unknown_input"] = "zero"
    return namedtuple("Numbers", kept)(**kept)  # type: ignore[misc]


def _tuples(value: Any) -> Any:
    return tuple(_tuples(each) for each in value) if isinstance(value, list) else value


def _range(name: str, given: Range) -> tuple[float, float]:
    """Where observers look for an unknown."""
    low, high = (-np.inf, np.inf) if isinstance(given, str) else (float(v) for v in given[1:])
    if not low < high:
        raise UserError(
            f"{WHERE}: {name}: got a range from {low:g} to {high:g}, expected (unit, least, most); change them."
        )
    return low, high
