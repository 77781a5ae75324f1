"""A user-defined plant given by its equations; see `plants.factory`.

    x' = field(numbers, now, x)  or  x one tick later = step(numbers, now, x),        y = output(numbers, now, x)

State, input and measured output are deviations from an operating point (x0, u0) and its output y0 for the declared numbers. The
user's functions get the full x and u. Linear observers use the Jacobians there (jax); `ekf` uses derivatives at its estimate.
Observers do not get unknown inputs and parameters. An unknown input is a signal held over a tick; a parameter is constant. A
tick of a field is one Runge-Kutta step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float, PyTree

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model
from pcbench.errors import UserError
from pcbench.protocols import Leaf, Now
from pcbench.runtime import config
from pcbench.scenarios.signals import inputs

REST = 1e-9  # largest |dx/dt| at an equilibrium, relative to the operating point's size


class Equations(NamedTuple):
    """The functions, their parameters, and the operating point; n states, m inputs, q outputs."""

    field: Callable[[PyTree, Now, Array], PyTree] | None  # (numbers, now, x) -> dx/dt [n]
    step: Callable[[PyTree, Now, Array], PyTree] | None  # (numbers, now, x) -> x one tick later [n]
    output: Callable[[PyTree, Now, Array], PyTree]  # (numbers, now, x) -> y [q]
    tick: float | None  # s, of `step`
    numbers: PyTree  # the type of the user's NamedTuple
    inputs: tuple[str, ...]  # numbers that are unknown inputs
    parameters: tuple[str, ...]  # numbers that are unknown parameters
    x0: tuple[float, ...]  # [n]
    u0: tuple[float, ...]  # [m]
    y0: tuple[float, ...]  # [q]
    output_residual: Callable[[Array, Array], PyTree] | None = None  # (y, yhat) -> residual [q]; None: y - yhat
    errors: tuple[Callable[[PyTree, Now, Array, Array], ArrayLike], ...] = ()  # [d] (numbers, now, x, xhat) -> a number


@dataclass(frozen=True)
class PlantFunction:
    """A function of this module with a plant's equations as its first argument.

    Two are equal if function and equations are equal, also after a transfer to another process. `functools.partial` compares
    identities, so a program would not accept the plant it was compiled for.
    """

    function: Callable[..., PyTree]
    equations: Equations

    def __call__(self, *arguments: PyTree) -> PyTree:
        """Call the function."""
        return self.function(self.equations, *arguments)


class Params(NamedTuple):
    """Parameters as arrays, the operating point, and the unknown inputs of every tick; N ticks, r unknown inputs."""

    numbers: PyTree
    x0: Float[Leaf, " n"]
    u0: Float[Leaf, " m"]
    y0: Float[Leaf, " q"]
    f: Float[Leaf, "rows r"]  # N + 1 rows


def user_numbers(equations: Equations, numbers: PyTree) -> PyTree:
    """Return the user's NamedTuple of numbers with arrays in it; unknown inputs are 0."""
    values = numbers._asdict() | dict.fromkeys(equations.inputs, 0.0)
    return equations.numbers(**{name: np.asarray(values[name], float) for name in equations.numbers._fields})


def require_tick(dt: float, step: float) -> None:
    """Raise UserError if a tick of `dt` is not the time step of a plant that is given by its `step` [s]."""
    if abs(dt - step) > 1e-9 * step:
        raise UserError(
            f"plant: got a tick of {dt:g} s where step moves by {step:g} s, expected the same; write dt = {step:g}."
        )


def prepare(equations: Equations, numbers: PyTree, dt: float, ticks: int) -> Params:
    """Return the parameters for ticks 0 .. `ticks` of `dt` seconds; raise UserError if `step` has another tick."""
    e = equations
    if e.tick is not None:
        require_tick(dt, e.tick)
    f = inputs(numbers.unknown_input, dt * np.arange(ticks + 1.0), len(e.inputs)) if e.inputs else np.zeros((1, 0))
    return Params(user_numbers(e, numbers), np.array(e.x0), np.array(e.u0), np.array(e.y0), f)


def add_operating_input(params: Params, now: Now) -> Now:
    """Return the present with the full input instead of its deviation."""
    return now._replace(u=now.u + params.u0, past_u=lambda age: now.past_u(age) + params.u0)


def with_unknowns(equations: Equations, params: Params, values: Float[Array, " s"]) -> PyTree:
    """Return the user's parameters with the given unknown inputs and parameters [s]."""
    names = (*equations.inputs, *equations.parameters)
    return params.numbers._replace(**{name: values[i] for i, name in enumerate(names)})


def model(equations: Equations, params: Params, now: Now, x: Float[Array, " n"], p: Float[Array, " s"]) -> Array:
    """Return dx/dt with unknowns p under the held now.u."""
    e, numbers = equations, with_unknowns(equations, params, p)
    return jnp.asarray(e.field(numbers, add_operating_input(params, now), x + params.x0))  # type: ignore[misc]


def successor(equations: Equations, params: Params, now: Now, x: Float[Array, " n"], p: Float[Array, " s"]) -> Array:
    """Return x one tick later with unknowns p under the held now.u."""
    e, numbers = equations, with_unknowns(equations, params, p)
    if e.step is not None:
        return jnp.asarray(e.step(numbers, add_operating_input(params, now), x + params.x0)) - params.x0
    return rk4(lambda t, x: model(e, params, now._replace(t=t), x, p), now.t, x, now.dt)  # type: ignore[no-any-return]


def sensor(equations: Equations, params: Params, now: Now, x: Float[Array, " n"], p: Float[Array, " s"]) -> Array:
    """Return the measurement with unknowns p."""
    numbers = with_unknowns(equations, params, p)
    return jnp.asarray(equations.output(numbers, add_operating_input(params, now), x + params.x0)) - params.y0


def output_residual(equations: Equations, params: Params, y: Float[Array, " q"], yhat: Float[Array, " q"]) -> Array:
    """Return the plant's output residual y - yhat; both are deviations from the operating point."""
    residual = equations.output_residual or jnp.subtract
    return jnp.asarray(residual(y + params.y0, yhat + params.y0))


def errors(
    equations: Equations, params: Params, now: Now, x: Float[Array, " n"], xhat: Float[Array, " n"]
) -> Float[Array, " d"]:
    """Return the user-defined errors of an estimate."""
    full_now, x, xhat = add_operating_input(params, now), x + params.x0, xhat + params.x0
    return jnp.stack([jnp.asarray(f(params.numbers, full_now, x, xhat), float) for f in equations.errors])


def unknown(equations: Equations, params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " s"]:
    """Return the unknown inputs held over the tick, then the unknown parameters."""
    true = [params.f[now.tick, i] for i in range(len(equations.inputs))]
    true += [jnp.asarray(getattr(params.numbers, name)) for name in equations.parameters]
    return jnp.stack(true) if true else jnp.zeros(0)


def field(equations: Equations, params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return dx/dt at now.t under the held now.u."""
    return model(equations, params, now, x, unknown(equations, params, now, x))


def step(equations: Equations, params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Advance x by one tick under the held now.u."""
    return successor(equations, params, now, x, unknown(equations, params, now, x))


def output(equations: Equations, params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " q"]:
    """Return the measurement."""
    return sensor(equations, params, now, x, unknown(equations, params, now, x))


@lru_cache(maxsize=64)
def slopes(equations: Equations, numbers: PyTree) -> tuple[Model, np.ndarray]:
    """Return the linear model at the operating point, by jax, for the assumed parameters, and dx/dt there [n].

    For a `step` the second is the change over a tick. It is 0 if it is rounding.
    """
    e, n, m, r = equations, len(equations.x0), len(equations.u0), len(equations.inputs)
    with config.float64():
        params = jax.tree.map(jnp.asarray, prepare(e, numbers, e.tick or 0.0, 0))
        # unknown inputs are 0 there, for any signal
        p0 = jnp.concatenate([jnp.zeros(r), unknown(e, params, _now(e, jnp.zeros(m)), jnp.zeros(n))[r:]])

        def derivative(x: Array, u: Array, p: Array) -> Array:
            return (successor if e.step is not None else model)(e, params, _now(e, u), x, p)

        def measurement(x: Array, u: Array, p: Array) -> Array:
            return sensor(e, params, _now(e, u), x, p)

        at = (jnp.zeros(n), jnp.zeros(m), p0)
        A, B, E = (np.asarray(jacobian) for jacobian in jax.jacfwd(derivative, (0, 1, 2))(*at))
        C, D, _ = (np.asarray(jacobian) for jacobian in jax.jacfwd(measurement, (0, 1, 2))(*at))
        excess = np.asarray(derivative(*at))
    size = 1.0 + max(np.abs([*e.x0, *e.u0]).max(), np.abs(A).max())
    linear_model = Model(A, B, C, D if D.any() else None, e.step is not None, E[:, :r] if r else None)
    return linear_model, np.where(np.abs(excess) > REST * size, excess, 0.0)


def _now(equations: Equations, u: Array) -> Now:
    """Return the first tick, with u held since the infinite past."""
    dt = jnp.asarray(equations.tick or 0.0)
    return Now(jnp.asarray(0.0), jnp.asarray(0), dt, u, lambda age: u)


def nominal(equations: Equations, numbers: PyTree) -> Model:
    """Return the linear model at the operating point."""
    return slopes(equations, numbers)[0]


def residual(equations: Equations, numbers: PyTree) -> np.ndarray:
    """Return dx/dt at the operating point, [n]: 0 at an equilibrium."""
    return slopes(equations, numbers)[1]
