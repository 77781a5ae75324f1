"""Assumptions of filters of a nonlinear model, and how it moves and measures: shared by `ekf`, `ekf-iterated`, `ukf`.

State z = (x, p): the plant's state and what is unknown beside it (parameters, unknown inputs), which walk at random. p is
clipped to the plant's range. Between samples mean and covariance go by slopes, tick by tick:

    P <- F P F' + Q,  F the slope of a tick at z,    z <- one tick under its input

A linear model moves by its exact map; a field by one Runge-Kutta step, whose slope is taken as I + h J; a plant that is given
by its step moves by that, and its slope is the Jacobian (jax). The unknowns p stand still.
R is the variance of one sample, P0 = diag(prior_std^2, unknown_std^2), Q what the scenario has designers assume for the states,
and walk unknown_std^2 h for p.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.tree_util import Partial
from jaxtyping import Float, Int, PyTree

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import rk4
from pcbench.observers.parts import assumed_noise
from pcbench.observers.parts.options import tunable
from pcbench.protocols import Leaf, Now, Room
from pcbench.synthesis.certificate import Certificate, Design, DesignContext

Model = Callable[[Now, Array, Array], Array]  # (now, x[n], p[s]) -> dx/dt[n], or x one tick later


class Gains(NamedTuple):
    """n states, s unknowns, N = n + s, q outputs."""

    motion: Callable[[Now, Array], Array]  # (now, z[N]) -> z[N] one tick later
    sensor: Any  # (now, x[n], p[s]) -> y[q]; None: C x, D u
    slope: Callable[[Now, Array], Array]  # (now, z[N]) -> F[N, N]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, " q"]  # variance of one sample
    mix: Float[Leaf, "q q"] | None  # of the outputs, so that their noise is independent; None: it is
    Q: Float[Leaf, "N N"]  # a tick
    P0: Float[Leaf, "N N"]
    start: Float[Leaf, " s"]  # p at t = 0
    low: Float[Leaf, " s"]
    high: Float[Leaf, " s"]
    room: Room  # for samples that may be overtaken
    guard: PyTree = ()  # guard.Guard, of a filter that does not take every sample for what it says
    own: PyTree = ()  # what one observer has besides
    residual: Any = None  # (y[q], yhat[q]) -> y less yhat, of outputs such as angles that wrap; None: their difference


class Options(assumed_noise.Options):
    """What a filter assumes."""

    walk: float = tunable(
        1.0,
        ge=0,
        description="variance of the random walk of unknown inputs and parameters, relative to unknown_std^2 [1/s]",
    )


def affine(Phi: Array, Gamma: Array, now: Now, z: Array) -> Array:
    """Move a linear model by one tick."""
    return Phi @ z + Gamma @ now.u


def constant(Phi: Array, now: Now, z: Array) -> Array:
    """Return the slope of a linear model."""
    return Phi


def rate(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Return dz/dt: the model's field with the unknowns p, room [s], which stand still."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([model(now, z[:n], z[n:]), jnp.zeros(room.shape[0])])


def step(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Move a model by one Runge-Kutta step."""
    return rk4(lambda t, z: rate(model, room, now._replace(t=t), z), now.t, z, now.dt)


def slope(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Return I + h J."""
    return jnp.eye(z.shape[0]) + now.dt * jax.jacfwd(lambda z: rate(model, room, now, z))(z)


def step_augmented(successor: Model, room: Room, now: Now, z: Array) -> Array:
    """Move a plant that is given by its step, with the unknowns p, room [s], which stand still."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([successor(now, z[:n], z[n:]), z[n:]])


def moved_slope(successor: Model, room: Room, now: Now, z: Array) -> Array:
    """Return the Jacobian of that."""
    return jax.jacfwd(lambda z: step_augmented(successor, room, now, z))(z)


def disturbed_derivative(
    A: Array, B: Array, E: Array, known: Callable[[Array], Array], now: Now, x: Array, p: Array
) -> Array:
    """Return dx/dt of a linear model pushed by f = known(x) + p."""
    return A @ x + B @ now.u + E @ (known(x) + p)


def motion_of(setting: DesignContext) -> tuple[Partial, Partial]:
    """Return how a tick moves z, and its slope: exactly where the model is linear."""
    model, room = setting.model, np.zeros(len(setting.unknown_std))
    if setting.successor is not None:
        after = setting.successor
        return Partial(step_augmented, after, room), Partial(moved_slope, after, room)
    if setting.field is None and (model.E is None or model.known is None):
        whole = linear.with_unknown_input(model) if model.E is not None else model
        Phi, Gamma = linear.one_tick(whole, setting.dt)
        return Partial(affine, Phi, Gamma), Partial(constant, Phi)
    field = setting.field or Partial(disturbed_derivative, model.A, model.B, model.E, model.known)
    return Partial(step, field, room), Partial(slope, field, room)


def initial_augmented(gains: Gains, xhat0: Float[Array, " n"]) -> Float[Array, " N"]:
    """Return z at t = 0."""
    return jnp.concatenate([xhat0, gains.start])


def clip_parameters(gains: Gains, z: Float[Array, " joint"]) -> Float[Array, " joint"]:
    """Return z with p clipped to its range; z may have a copy beside it."""
    s, N = gains.start.shape[0], gains.P0.shape[0]
    beside = [z[N:]] if z.shape[0] > N else []
    return jnp.concatenate([z[: N - s], jnp.clip(z[N - s : N], gains.low, gains.high), *beside]) if s else z


def at(now: Now, tick: Int[Array, ""]) -> Now:
    """Return the present as it was at an earlier tick, with the input held from there."""
    since = now.tick - tick
    return now._replace(t=tick * now.dt, tick=tick, u=now.past_u(since), past_u=lambda age: now.past_u(age + since))


def predict_joint(gains: Gains, now: Now, before: PyTree, until: Int[Array, ""]) -> tuple[Array, Array]:
    """Return mean and covariance carried on to a tick, one by one; a copy beside the state stays as it is."""
    N, beside = gains.P0.shape[0], before.mean.shape[0] - gains.P0.shape[0]

    def tick(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        (z, P), there = carry, at(now, k)
        F, moved, Q = gains.slope(there, z[:N]), clip_parameters(gains, gains.motion(there, z[:N])), gains.Q
        if beside:
            F, Q = jax.scipy.linalg.block_diag(F, jnp.eye(beside)), jnp.pad(Q, (0, beside))
            moved = jnp.concatenate([moved, z[N:]])
        return moved, F @ P @ F.T + Q

    return lax.fori_loop(before.taken, until, tick, (before.mean, before.P))


def linearize_sensor(gains: Gains, there: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return what a sensor that is not linear gives at z, [q], and its Jacobian, [q, N]."""
    n = gains.C.shape[1]

    def output(z: Array) -> Array:
        y = gains.sensor(there, z[:n], z[n:])
        return y if gains.mix is None else gains.mix @ y

    return output(z), jax.jacfwd(output)(z)


def linearize_output(gains: Gains, there: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return what is expected of a sample at z, [q], and its slope, [q, N]."""
    if gains.sensor is not None:
        return linearize_sensor(gains, there, z)
    C = jnp.concatenate([gains.C, jnp.zeros((gains.C.shape[0], gains.start.shape[0]))], axis=1)
    return C @ z, C


def value_of(gains: Gains, value: Float[Array, " q"]) -> Float[Array, " q"]:
    """Return what a sample says of outputs whose noise is independent."""
    return value if gains.mix is None else gains.mix @ value


def nearest(gains: Gains, value: Float[Array, " q"], y: Float[Array, " q"]) -> Float[Array, " q"]:
    """Return `value_of` a sample with y + residual(value, y) in its place, y what is expected: of an angle the nearest turn."""
    if gains.residual is None:
        return value_of(gains, value)
    expected = y if gains.mix is None else jax.scipy.linalg.solve_triangular(gains.mix, y, lower=True)
    return y + value_of(gains, gains.residual(value, expected))


def at_points(gains: Gains, there: Now, points: Float[Array, "S N"]) -> Float[Array, "S q"]:
    """Return what is expected of a sample at several z by a sensor; outputs that wrap on the turn of the first."""
    n = gains.C.shape[1]
    y = jax.vmap(lambda z: gains.sensor(there, z[:n], z[n:]))(points)
    return jax.vmap(lambda each: nearest(gains, each, value_of(gains, y[0])))(y)


def design(
    setting: DesignContext,
    options: Options,
    name: str,
    own: Callable[[Gains], PyTree] = lambda gains: (),
    guard: PyTree = (),
) -> Design:
    """Gather what a filter assumes, and by `own` what it has besides; there is no certificate for a nonlinear model."""
    n, s, where = len(setting.model.A), len(setting.unknown_std), f"{name} in {setting.scenario}"
    motion, tangent = motion_of(setting)
    size = np.square(setting.unknown_std)
    P0, Q = np.zeros((n + s, n + s)), np.zeros((n + s, n + s))
    P0[:n, :n], P0[n:, n:] = setting.P0, np.diag(size)
    q = assumed_noise.through(options.q, setting.model.B.shape[1], setting.input_intensity, where)
    process = assumed_noise.process(setting, options.Q, where)
    Q[:n, :n] = process + linear.input_noise(setting.model, q, setting.dt)
    Q[n:, n:] = np.diag(options.walk * size * setting.dt)
    mix, C, R = assumed_noise.independent(setting, options.R, setting.model.C, where)
    low, high = np.array(setting.unknown_range).T.reshape(2, s)
    gains = Gains(
        motion=motion,
        slope=tangent,
        sensor=setting.sensor,
        C=C,
        D=setting.model.feedthrough * (setting.sensor is None),  # a sensor's output has the input's part in it
        R=R,
        mix=mix,
        Q=Q,
        P0=P0,
        start=np.array(setting.unknown0, float),
        low=low,
        high=high,
        room=setting.room,
        guard=guard,
        residual=setting.residual,
    )
    numbers = {"R": R, **assumed_noise.option("Q", process)}
    why = "none: the model is nonlinear, or linearised at the estimate"
    proof = Certificate(why, float("inf"), "none", "not needed", numbers)
    return Design(gains._replace(own=own(gains)), proof, True if setting.model.E is not None else None)
