"""Make a user-defined plant from its equations, which are checked once.

from typing import NamedTuple

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
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import PyTree

from pcbench.dynamics.linear import Model
from pcbench.errors import UserError, brief_repr, describe_exception, unknown
from pcbench.plants import nonlinear
from pcbench.plants.nonlinear import Equations, PlantFunction
from pcbench.protocols import Now, Params, Plant
from pcbench.runtime import config
from pcbench.signal_names import names_and_units, unit

WHERE = "pcbench.make_plant"
Function = Callable[[PyTree, Now, Array], PyTree]  # (numbers, now, x[n]) -> an array, or a list of its entries
ErrorFunction = Callable[[PyTree, Now, Array, Array], ArrayLike]  # (numbers, now, x[n], xhat[n]) -> a number
Range = str | tuple[str, float, float]  # a unit, or (unit, least, most) where observers look for the value


class PlantSpec(NamedTuple):
    """A plant with its signals, its parameters and the models that designs use."""

    plant: Plant  # the functions
    signals: tuple[tuple[str, str], ...]  # name and unit of each state; empty: those of the scenario
    numbers: PyTree  # default parameters, a NamedTuple
    nominal: Callable[[PyTree], Model]  # parameters -> the linear model that designs use
    prepare: Callable[[PyTree, float, int], Params]  # (parameters, tick [s], number of ticks) -> params of `plant`
    summary: str  # one line for `pcbench list`
    unknowns: tuple[tuple[str, str], ...] = ()  # name and unit of each unknown input or parameter
    heavy: bool = False  # whether a tick is so expensive that fewer runs per call are as fast
    model: Callable[..., Array] | None = None  # (params, now, x, unknowns) -> dx/dt; None: `nominal` is the model
    successor: Callable[..., Array] | None = None  # (params, now, x, unknowns) -> x one tick later; None: see `model`
    sensor: Callable[..., Array] | None = None  # (params, now, x, unknowns) -> y; None: that of `nominal`
    output_residual: Callable[..., Array] | None = None  # (params, y, yhat) -> residual; None: the difference
    parts: Callable[..., tuple[Array, Array]] | None = None  # (params, u, x) -> a, phi of a p + phi with parameters p
    inverse: Callable[..., Array] | None = None  # (params, unknowns, path, rates, accelerations) -> u
    positive: tuple[str, ...] = ()  # parameters that must be greater than 0
    signs: tuple[str, ...] = ()  # parameters that are 1 or -1
    ranges: tuple[tuple[float, float], ...] = ()  # range of each unknown input or parameter; empty: no limits
    drifts: bool = True  # whether the axis `parameter_drift` has an effect
    # parameters -> dx/dt at the operating point, if signals are deviations from it
    residual: Callable[[PyTree], np.ndarray] | None = None
    operating_point: tuple[tuple[float, ...], tuple[float, ...]] | None = None  # state and input at the operating point
    tick: float | None = None  # tick of a plant that is given by its step [s]; None: any
    errors: tuple[tuple[str, str], ...] = ()  # name and unit of each error that `plant.errors` returns
    outputs: tuple[tuple[str, str], ...] = ()  # name and unit of each output; empty: those of the states that it shows


class NoNumbers(NamedTuple):
    """Numbers of a plant whose functions contain all their numbers."""


def make_plant(
    *,
    output: Function,
    states: Sequence[str],
    operating_point: Sequence[object],
    outputs: Sequence[str] = (),
    field: Function | None = None,
    step: Function | None = None,
    tick: float | None = None,
    numbers: PyTree = None,
    unknown_inputs: Mapping[str, Range] | None = None,
    unknown_parameters: Mapping[str, Range] | None = None,
    positive: Sequence[str] = (),
    output_residual: Callable[[Array, Array], PyTree] | None = None,
    errors: Mapping[str, ErrorFunction] | None = None,
    summary: str = "a user's plant",
) -> PlantSpec:
    """Make a plant from its equations: x' = field(numbers, now, x), or x one tick later = step(numbers, now, x).

    Signals, inputs and measured outputs of a study are deviations from the operating point. The functions get the full
    values. Linear observers use the Jacobians at the operating point, if it is an equilibrium. `ekf` works anywhere.

    Args:
        output: measured y [q] = output(numbers, now, x). Functions are written in jax.numpy, for one run.
        states: names with units, such as "angle [rad]"; n of them.
        operating_point: (x0 [n], u0 [m]).
        outputs: names with units of what is measured, such as "range [m]"; q of them. If you leave them out, an output has the
            unit of the state that it shows, if it shows one.
        field: dx/dt [n]; give this or `step`.
        step: x one tick later [n].
        tick: time step of `step` [s], which is then the scenario's `dt`.
        numbers: a NamedTuple of floats (each is an axis, `plant.NAME`) and lists. The functions get it with arrays.
        unknown_inputs: inputs that observers may estimate, by their names among `numbers`: a unit, or (unit, least, most).
            The scenario's `unknown_input` is their signal.
        unknown_parameters: parameters that observers may estimate, likewise.
        positive: names of numbers that must be greater than 0.
        output_residual: y - yhat [q] as a function (y, yhat), if it is not their difference: of an angle that wraps, the
            shortest way. `ekf`, `ekf-iterated`, `ukf`, `particle` and `mhe` use it; other observers take the difference.
        errors: your own errors by name with unit, such as "distance [m]": functions (numbers, now, x, xhat) of one number,
            which is 0 if x and xhat agree. Tables have every metric of them. Not with unknown inputs or parameters.
        summary: one line that `pcbench list` shows.

    Returns:
        The plant. A scenario names it by `plant = "FILE.py:NAME"`.

    Raises:
        UserError: shapes do not fit, or a function or its slope is not finite at the operating point.
    """
    x0, u0 = _point(operating_point)
    signals = names_and_units(states, f"{WHERE}: states")
    if len(signals) != len(x0):
        raise UserError(
            f"{WHERE}: states: got {len(signals)} names, expected {len(x0)}, one for each state of the operating point."
        )
    if (field is None) == (step is None) or (step is None) != (tick is None):
        arguments = {"field": field, "step": step, "tick": tick}
        names = " and ".join(name for name, value in arguments.items() if value is not None) or "neither field nor step"
        raise UserError(f"{WHERE}: got {names}, expected field, or step with its tick in seconds; give one.")
    output_signals = names_and_units(outputs, f"{WHERE}: outputs")
    numbers = NoNumbers() if numbers is None else numbers
    inputs, parameters = dict(unknown_inputs or {}), dict(unknown_parameters or {})
    plant_numbers = _numbers(numbers, inputs, parameters)
    for name in positive:
        if name not in plant_numbers._fields:
            raise unknown(f"{WHERE}: positive", "number", name, plant_numbers._fields)
    e = Equations(
        field=field,
        step=step,
        output=output,
        tick=tick,
        numbers=type(numbers),
        inputs=tuple(inputs),
        parameters=tuple(parameters),
        x0=x0,
        u0=u0,
        y0=(),
        output_residual=output_residual,
        errors=tuple((errors or {}).values()),
    )
    e = e._replace(y0=_try_output(e, plant_numbers))
    if output_signals and len(output_signals) != len(e.y0):
        raise UserError(
            f"{WHERE}: outputs: got {len(output_signals)} names, expected {len(e.y0)}, one for each number that output returns."
        )
    units = [
        (name, unit(spec if isinstance(spec, str) else spec[0], f"{WHERE}: {name}"))
        for name, spec in (inputs | parameters).items()
    ]
    error_signals = names_and_units([*states, *(errors or {})], f"{WHERE}: errors")[len(signals) :]
    if error_signals and units:
        raise UserError(
            f"{WHERE}: errors: got errors of your own and {units[0][0]}, which is unknown, expected one of the two; leave the "
            "errors out, or give the number to the observers."
        )
    return PlantSpec(
        plant=Plant(
            step=PlantFunction(nonlinear.step, e),
            output=PlantFunction(nonlinear.output, e),
            field=PlantFunction(nonlinear.field, e) if field is not None else None,
            unknown=PlantFunction(nonlinear.unknown, e) if units else None,
            errors=PlantFunction(nonlinear.errors, e) if error_signals else None,
            scored=len(error_signals),
        ),
        signals=signals,
        numbers=plant_numbers,
        nominal=PlantFunction(nonlinear.nominal, e),
        prepare=PlantFunction(nonlinear.prepare, e),
        summary=summary,
        unknowns=tuple(units),
        heavy=True,
        model=PlantFunction(nonlinear.model, e) if field is not None else None,
        successor=PlantFunction(nonlinear.successor, e) if step is not None else None,
        sensor=PlantFunction(nonlinear.sensor, e),
        output_residual=PlantFunction(nonlinear.output_residual, e) if output_residual is not None else None,
        residual=PlantFunction(nonlinear.residual, e),
        positive=tuple(positive),
        drifts="drift" in plant_numbers._fields,
        ranges=tuple(_range(name, spec) for name, spec in (inputs | parameters).items()),
        operating_point=(x0, u0),
        tick=tick,
        errors=error_signals,
        outputs=output_signals,
    )


def _point(point: Sequence[object]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the operating point as numbers."""
    try:
        x0, u0 = (tuple(float(v) for v in np.asarray(part, float).reshape(-1)) for part in point)
    except (TypeError, ValueError):
        raise UserError(
            f"{WHERE}: operating_point: got {brief_repr(point)}, expected a pair (x0 [n], u0 [m]) of lists of numbers."
        ) from None
    if not x0 or not u0 or not np.isfinite([*x0, *u0]).all():
        raise UserError(
            f"{WHERE}: operating_point: got {brief_repr(point)}, expected at least one state and one input, all finite."
        )
    return x0, u0


def _numbers(numbers: PyTree, inputs: Mapping[str, Range], parameters: Mapping[str, Range]) -> PyTree:
    """Return the plant's parameters that a study may vary: floats, and tuples of them, without unknown inputs."""
    names = getattr(numbers, "_fields", None)
    if names is None:
        raise UserError(
            f"{WHERE}: numbers: got {brief_repr(numbers)}, expected a NamedTuple of numbers; make one with defaults."
        )
    for argument, ranges in (("unknown_inputs", inputs), ("unknown_parameters", parameters)):
        for name in ranges:
            if name not in names:
                raise unknown(f"{WHERE}: {argument}", "number of the plant", name, names)
    if in_both := set(inputs) & set(parameters):
        raise UserError(
            f"{WHERE}: got '{min(in_both)}' as an unknown input and an unknown parameter, expected one of them."
        )
    fields: dict[str, object] = {}
    for name, value in zip(names, numbers, strict=True):
        try:
            array = np.asarray(value, float)
        except (TypeError, ValueError):
            raise UserError(
                f"{WHERE}: numbers.{name}: got {brief_repr(value)}, expected a number or an array of them."
            ) from None
        if (name in inputs or name in parameters) and array.ndim:
            raise UserError(
                f"{WHERE}: numbers.{name}: got {brief_repr(value)}, expected one number: it is unknown to observers."
            )
        if name not in inputs:
            fields[name] = float(array) if not array.ndim else tuples(array.tolist())
    if inputs:
        fields["unknown_input"] = "zero"
    return namedtuple("Numbers", fields)(**fields)  # type: ignore[misc]


def tuples(value: object) -> object:
    """Return lists, also those in lists, as tuples."""
    return tuple(tuples(entry) for entry in value) if isinstance(value, list) else value


def _range(name: str, spec: Range) -> tuple[float, float]:
    """Return the range in which observers look for an unknown."""
    low, high = (-np.inf, np.inf) if isinstance(spec, str) else (float(v) for v in spec[1:])
    if not low < high:
        raise UserError(
            f"{WHERE}: {name}: got a range from {low:g} to {high:g}, expected (unit, least, most); change them."
        )
    return low, high


def _try_output(e: Equations, numbers: PyTree) -> tuple[float, ...]:
    """Return the output at the operating point; raise UserError for an invalid function or slope."""
    n = len(e.x0)
    with config.float64():
        user_numbers, x = nonlinear.user_numbers(e, numbers), jnp.array(e.x0)
        u, dt = jnp.array(e.u0), jnp.asarray(e.tick or 0.0)
        now = Now(jnp.asarray(0.0), jnp.asarray(0), dt, u, lambda age: u)
        kind = "field" if e.field is not None else "step"
        values = {}
        for name in (kind, "output"):
            try:
                values[name] = np.asarray(jnp.asarray(getattr(e, name)(user_numbers, now, x)))
            except UserError:
                raise
            except Exception as error:
                raise UserError(
                    f"{WHERE}: {name} cannot be computed at the operating point: {describe_exception(error)}; "
                    "correct that line."
                ) from None
        if values[kind].shape != (n,):
            raise UserError(
                f"{WHERE}: {kind}: got an array of shape {values[kind].shape}, expected ({n},), a number for each state."
            )
        if values["output"].ndim != 1 or not values["output"].size:
            raise UserError(
                f"{WHERE}: output: got an array of shape {values['output'].shape}, expected (q,), a number for each output."
            )
        for name, value in values.items():
            _require_finite(name, value, e)
        y0 = tuple(map(float, values["output"]))
        if e.output_residual is not None:
            _try_residual(e.output_residual, values["output"])
        for i, error_function in enumerate(e.errors):
            _try_error(error_function, i, user_numbers, now, x)
        try:
            linear = nonlinear.nominal(e._replace(y0=y0), numbers)
        except Exception as error:
            raise UserError(
                f"{WHERE}: the slope of {kind} or output cannot be taken: {describe_exception(error)}; write it in jax.numpy."
            ) from None
    for name, matrices in ((kind, (linear.A, linear.B, linear.E)), ("output", (linear.C, linear.D))):
        for matrix in matrices:
            if matrix is not None:
                _require_finite(f"the slope of {name}", matrix, e)
    return y0


def _try_residual(residual: Callable[[Array, Array], PyTree], y0: np.ndarray) -> None:
    """Raise UserError if an output's residual is not [q], or is not 0 for equal arguments."""
    try:
        value = np.asarray(jnp.asarray(residual(jnp.asarray(y0), jnp.asarray(y0))))
    except Exception as error:
        raise UserError(
            f"{WHERE}: output_residual cannot be computed at the operating point: {describe_exception(error)}; "
            "correct that line."
        ) from None
    if value.shape != y0.shape or np.any(value != 0):
        raise UserError(
            f"{WHERE}: output_residual: got {brief_repr(value.tolist())} of an output less itself, expected {len(y0)} "
            f"zero{'s' if len(y0) > 1 else ''}: it takes (y, yhat) and returns y less yhat, a number for each output."
        )


def _try_error(error_function: ErrorFunction, i: int, numbers: PyTree, now: Now, x: Array) -> None:
    """Raise UserError if a user-defined error is not a number, or not 0 for x = xhat."""
    try:
        value = np.asarray(jnp.asarray(error_function(numbers, now, x, x)))
    except Exception as error:
        raise UserError(
            f"{WHERE}: errors: number {i + 1} cannot be computed at the operating point: "
            f"{describe_exception(error)}; correct that line."
        ) from None
    if value.shape or value != 0:
        raise UserError(
            f"{WHERE}: errors: number {i + 1} is {brief_repr(value.tolist())} where x and xhat agree, expected 0: "
            "it takes (numbers, "
            "now, x, xhat) and returns one number."
        )


def _require_finite(name: str, value: np.ndarray, e: Equations) -> None:
    if not np.isfinite(value).all():
        raise UserError(
            f"{WHERE}: {name}: got {brief_repr(np.asarray(value).tolist())} at the operating point x = "
            f"{brief_repr(list(e.x0))}, "
            f"u = {brief_repr(list(e.u0))}, expected finite numbers; use another point, or correct the function."
        )
