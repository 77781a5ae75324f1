"""Assumptions, motion and output of filters of a nonlinear model, such as `ekf`, `ukf`, `mhe` and `particle`.

The state is z = (x, p): the plant's state x, and unknown parameters and inputs p, modelled as random walks and clipped to the
plant's range. Filters with Jacobians propagate mean and covariance between samples tick by tick:

    P <- F P F' + Q,  F the Jacobian of a tick at z,    z <- one tick under its input

- A tick of a linear model is its exact map.
- A tick of a field is one Runge-Kutta step, with F approximated by I + h J.
- A plant that is defined by its step uses that step, and its Jacobian (jax).

p is constant over a tick. R is the variance of one sample, and P0 = diag(prior_std^2, unknown_std^2). Q is the scenario's
assumed process noise of x, and walk unknown_std^2 h of p.
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
    jacobian: Callable[[Now, Array], Array]  # (now, z[N]) -> F[N, N]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, " q"]  # variance of one sample
    decorrelation: Float[Leaf, "q q"] | None  # map to outputs with independent noise; None: identity
    Q: Float[Leaf, "N N"]  # process noise of a tick
    P0: Float[Leaf, "N N"]
    start: Float[Leaf, " s"]  # p at t = 0
    low: Float[Leaf, " s"]
    high: Float[Leaf, " s"]
    room: Room  # for samples that may arrive after newer ones
    guard: PyTree = ()  # robust_update.Guard, of a filter that rejects outliers or reduces their weight
    extra: PyTree = ()  # parameters of one observer of the family
    residual: Any = None  # (y[q], yhat[q]) -> residual of outputs that wrap, such as angles; None: y - yhat


class Options(assumed_noise.Options):
    """Assumptions of a filter."""

    walk: float = tunable(
        1.0,
        ge=0,
        description="variance of the random walk of unknown inputs and parameters, relative to unknown_std^2 [1/s]",
    )


def affine(Phi: Array, Gamma: Array, now: Now, z: Array) -> Array:
    """Return z one tick later, by a linear model."""
    return Phi @ z + Gamma @ now.u


def constant_jacobian(Phi: Array, now: Now, z: Array) -> Array:
    """Return the Jacobian of a tick of a linear model."""
    return Phi


def rate(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Return dz/dt: the model's field for x, and 0 for the unknowns p, of which `room` has the number."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([model(now, z[:n], z[n:]), jnp.zeros(room.shape[0])])


def step(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Return z one tick later, by one Runge-Kutta step of a model."""
    return rk4(lambda t, z: rate(model, room, now._replace(t=t), z), now.t, z, now.dt)


def approximate_jacobian(model: Model, room: Room, now: Now, z: Array) -> Array:
    """Return the approximate Jacobian of a tick, I + h J."""
    return jnp.eye(z.shape[0]) + now.dt * jax.jacfwd(lambda z: rate(model, room, now, z))(z)


def step_augmented(successor: Model, room: Room, now: Now, z: Array) -> Array:
    """Return z one tick later, for a plant that is defined by its step; p stays constant."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([successor(now, z[:n], z[n:]), z[n:]])


def augmented_jacobian(successor: Model, room: Room, now: Now, z: Array) -> Array:
    """Return the Jacobian of `step_augmented`."""
    return jax.jacfwd(lambda z: step_augmented(successor, room, now, z))(z)


def disturbed_derivative(
    A: Array, B: Array, E: Array, known_part: Callable[[Array], Array], now: Now, x: Array, p: Array
) -> Array:
    """Return dx/dt of a linear model with the unknown input f = known(x) + p."""
    return A @ x + B @ now.u + E @ (known_part(x) + p)


def motion_of(context: DesignContext) -> tuple[Partial, Partial]:
    """Return two functions of (now, z): z one tick later, and the Jacobian of the tick."""
    model, room = context.model, np.zeros(len(context.unknown_std))
    if context.successor is not None:
        successor = context.successor
        return Partial(step_augmented, successor, room), Partial(augmented_jacobian, successor, room)
    if context.field is None and (model.E is None or model.nonlinearity is None):
        joint_model = linear.with_unknown_input(model) if model.E is not None else model
        Phi, Gamma = linear.one_tick(joint_model, context.dt)
        return Partial(affine, Phi, Gamma), Partial(constant_jacobian, Phi)
    field = context.field or Partial(disturbed_derivative, model.A, model.B, model.E, model.nonlinearity)
    return Partial(step, field, room), Partial(approximate_jacobian, field, room)


def initial_joint_state(gains: Gains, xhat0: Float[Array, " n"]) -> Float[Array, " N"]:
    """Return z at t = 0."""
    return jnp.concatenate([xhat0, gains.start])


def clip_parameters(gains: Gains, z: Float[Array, " joint"]) -> Float[Array, " joint"]:
    """Return z with p clipped to its range; z may contain a copy after its N entries."""
    s, N = gains.start.shape[0], gains.P0.shape[0]
    copy = [z[N:]] if z.shape[0] > N else []
    return jnp.concatenate([z[: N - s], jnp.clip(z[N - s : N], gains.low, gains.high), *copy]) if s else z


def now_at(now: Now, tick: Int[Array, ""]) -> Now:
    """Return `now` as it was at an earlier tick, with the input held from there on."""
    elapsed = now.tick - tick
    return now._replace(t=tick * now.dt, tick=tick, u=now.past_u(elapsed), past_u=lambda age: now.past_u(age + elapsed))


def predict_joint(gains: Gains, now: Now, before: PyTree, until: Int[Array, ""]) -> tuple[Array, Array]:
    """Return mean and covariance propagated to a tick; a copy in the state stays constant."""
    N, copies = gains.P0.shape[0], before.mean.shape[0] - gains.P0.shape[0]

    def tick(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        (z, P), past = carry, now_at(now, k)
        F, z_next, Q = gains.jacobian(past, z[:N]), clip_parameters(gains, gains.motion(past, z[:N])), gains.Q
        if copies:
            F, Q = jax.scipy.linalg.block_diag(F, jnp.eye(copies)), jnp.pad(Q, (0, copies))
            z_next = jnp.concatenate([z_next, z[N:]])
        return z_next, F @ P @ F.T + Q

    return lax.fori_loop(before.tick, until, tick, (before.mean, before.P))


def linearize_sensor(gains: Gains, sample_now: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return output [q] and Jacobian [q, N] of a nonlinear sensor at z."""
    n = gains.C.shape[1]

    def output(z: Array) -> Array:
        y = gains.sensor(sample_now, z[:n], z[n:])
        return y if gains.decorrelation is None else gains.decorrelation @ y

    return output(z), jax.jacfwd(output)(z)


def linearize_output(gains: Gains, sample_now: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return the predicted output [q] at z, and its Jacobian [q, N]."""
    if gains.sensor is not None:
        return linearize_sensor(gains, sample_now, z)
    C = jnp.concatenate([gains.C, jnp.zeros((gains.C.shape[0], gains.start.shape[0]))], axis=1)
    return C @ z, C


def decorrelate(gains: Gains, value: Float[Array, " q"]) -> Float[Array, " q"]:
    """Return a sample's values of the outputs with independent noise [q]."""
    return value if gains.decorrelation is None else gains.decorrelation @ value


def value_near(gains: Gains, value: Float[Array, " q"], y: Float[Array, " q"]) -> Float[Array, " q"]:
    """Return `decorrelate` of a sample, or y + residual(value, y) for outputs such as angles, with the prediction y."""
    if gains.residual is None:
        return decorrelate(gains, value)
    expected = (
        y if gains.decorrelation is None else jax.scipy.linalg.solve_triangular(gains.decorrelation, y, lower=True)
    )
    return y + decorrelate(gains, gains.residual(value, expected))


def outputs_at_points(gains: Gains, sample_now: Now, points: Float[Array, "S N"]) -> Float[Array, "S q"]:
    """Return a sensor's output at several z; outputs that wrap are within half a turn of the first one's."""
    n = gains.C.shape[1]
    y = jax.vmap(lambda z: gains.sensor(sample_now, z[:n], z[n:]))(points)
    return jax.vmap(lambda y_i: value_near(gains, y_i, decorrelate(gains, y[0])))(y)


def design(
    context: DesignContext,
    options: Options,
    name: str,
    extra: Callable[[Gains], PyTree] = lambda gains: (),
    guard: PyTree = (),
) -> Design:
    """Return a filter's assumptions, and by `extra` the parameters of one observer; there is no certificate."""
    n, s, where = len(context.model.A), len(context.unknown_std), f"{name} in {context.scenario}"
    motion, jacobian = motion_of(context)
    variances = np.square(context.unknown_std)
    P0, Q = np.zeros((n + s, n + s)), np.zeros((n + s, n + s))
    P0[:n, :n], P0[n:, n:] = context.P0, np.diag(variances)
    q = assumed_noise.input_intensity(options.q, context.model.B.shape[1], context.input_intensity, where)
    process = assumed_noise.process_covariance(context, options.Q, where)
    Q[:n, :n] = process + linear.input_noise(context.model, q, context.dt)
    Q[n:, n:] = np.diag(options.walk * variances * context.dt)
    decorrelation, C, R = assumed_noise.decorrelate_outputs(context, options.R, context.model.C, where)
    low, high = np.array(context.unknown_range).T.reshape(2, s)
    gains = Gains(
        motion=motion,
        jacobian=jacobian,
        sensor=context.sensor,
        C=C,
        D=context.model.feedthrough * (context.sensor is None),  # a sensor function includes the part of the input
        R=R,
        decorrelation=decorrelation,
        Q=Q,
        P0=P0,
        start=np.array(context.unknown0, float),
        low=low,
        high=high,
        room=context.room,
        guard=guard,
        residual=context.residual,
    )
    numbers = {"R": R, **assumed_noise.covariance_option("Q", process)}
    inequality = "none: the model is nonlinear, or linearised at the estimate"
    certificate = Certificate(inequality, float("inf"), "none", "not needed", numbers)
    return Design(gains._replace(extra=extra(gains)), certificate, True if context.model.E is not None else None)
