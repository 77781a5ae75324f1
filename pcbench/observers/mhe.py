"""mhe: moving-horizon estimation: the most likely states at the newest samples, within bounds.

    min  |z_0 - m|^2_(P^-1) + sum_i |z_i - f_i(z_(i-1))|^2_(Q_i^-1) + sum_i |y_i - h(z_i)|^2_(R^-1),   lower <= z_i <= upper

The minimum is over z_0 .. z_M at the times of the M newest samples and of the one before them. m is the estimate of z_0 when
its sample was the newest, and P its covariance in an extended Kalman filter (the arrival cost). f_i propagates from sample to
sample tick by tick, and Q_i is the process noise on the way, propagated by Jacobians.
Each of a fixed number of Gauss-Newton steps linearises f_i and h, and solves the resulting quadratic program along the chain
(`parts/structured_qp`). From z_M, mean and covariance are propagated to the present as in `ekf-iterated`. A sample of any age
is used at its sampling time (`parts/repropagation`).

`lower` and `upper` bound the plant's states. Unknown inputs and parameters have the plant's range.
Source: Rao, Rawlings, Mayne 2003, with an arrival cost that is filtered.
Without bounds on a linear plant it equals `kf` up to rounding, for every M. On a nonlinear plant its advantage is that it
linearises again at earlier samples and respects the bounds.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: convergence of the Gauss-Newton steps, or that the covariance includes the effect of the bounds.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.errors import UserError, brief_repr
from pcbench.observers import ekf_iterated
from pcbench.observers.parts import kalman, nonlinear_model, reorder_buffer, repropagation, structured_qp
from pcbench.observers.parts.nonlinear_model import (
    Gains,
    clip_parameters,
    initial_joint_state,
    linearize_output,
    now_at,
    value_near,
)
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.structured_qp import Bounds, Chain
from pcbench.protocols import Now, Room
from pcbench.synthesis.certificate import Design, DesignContext

DEFAULT_WINDOW = 10  # samples of a window, by default


class Horizon(NamedTuple):
    """Parameters in addition to those of the filter."""

    window: Room  # M
    iterations: Room
    bounds: Bounds | tuple[()]  # (): none


class Window(NamedTuple):
    """The newest M samples, oldest first, with the estimates at each; in an empty place `mask` is False and the tick is 0."""

    mean: Float[Array, " N"]  # of the newest sample, propagated to tick `tick`
    P: Float[Array, "N N"]
    tick: Int[Array, ""]
    samples: Measurement  # [M]
    path: Float[Array, "M N"]  # z_1 .. z_M, from the last solution
    means: Float[Array, "M N"]  # estimate at each sample when it was the newest
    covariances: Float[Array, "M N N"]
    prior_mean: Float[Array, " N"]  # m
    prior_P: Float[Array, "N N"]  # P
    prior_tick: Int[Array, ""]  # of m


class Options(nonlinear_model.Options):
    """Assumptions, length of the window, iterations and bounds."""

    window: int | None = Field(
        None, ge=1, le=1000, description="number of measurements in the window; default: 10, or all if a run has fewer"
    )
    iterations: int = Field(2, ge=1, le=100, description="Gauss-Newton steps per measurement")
    lower: float | list[float] | None = Field(
        None, description="lower bound of all states, or n bounds; default: no bound"
    )
    upper: float | list[float] | None = Field(
        None, description="upper bound of all states, or n bounds; default: no bound"
    )


def first(gains: Gains, xhat0: Array) -> Window:
    """Return an empty window at the prior."""
    z, M = initial_joint_state(gains, xhat0), gains.extra.window.shape[0]
    empty_samples = reorder_buffer.start((), jnp.zeros(M), gains.C.shape[0], 0).samples
    row, rows, zero = jnp.tile(z, (M, 1)), jnp.tile(gains.P0, (M, 1, 1)), jnp.asarray(0)
    return Window(
        mean=z,
        P=gains.P0,
        tick=zero,
        samples=empty_samples._replace(tick=jnp.zeros(M, int)),
        path=row,
        means=row,
        covariances=rows,
        prior_mean=z,
        prior_P=gains.P0,
        prior_tick=zero,
    )


def stage(gains: Gains, now: Now, z: Array, since: Array, until: Array) -> tuple[Array, Array, Array]:
    """Return f(z) from tick `since` to tick `until`, its Jacobian, and the accumulated process noise."""

    def tick(k: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        z, F, Q = carry
        A = gains.jacobian(now_at(now, k), z)
        return gains.motion(now_at(now, k), z), A @ F, A @ Q @ A.T + gains.Q

    return lax.fori_loop(since, until, tick, (z, jnp.eye(z.shape[0]), jnp.zeros_like(gains.Q)))


def linearize_path(gains: Gains, now: Now, w: Window, path: Float[Array, "M+1 N"]) -> Chain:
    """Return the chain linearised along a path of states."""
    N, q = path.shape[1], gains.C.shape[0]
    start_ticks = jnp.append(w.prior_tick, w.samples.tick[:-1])

    def linearize_stage(z: Array, z_next: Array, start_tick: Array, sample: Measurement) -> tuple[Array, ...]:
        f, F, Q = stage(gains, now, z, start_tick, sample.tick)
        y, H = linearize_output(gains, now_at(now, sample.tick), z_next)
        value = value_near(gains, sample.value, y) - y + H @ z_next
        return F, f - F @ z, Q, H, value, jnp.where(sample.mask, 1.0 / sample.variances(gains.R), 0.0)

    rest = lax.map(lambda row: linearize_stage(*row), (path[:-1], path[1:], start_ticks, w.samples))
    head = jnp.eye(N), w.prior_mean, w.prior_P, jnp.zeros((q, N)), jnp.zeros(q), jnp.zeros(q)
    return Chain(*(jnp.concatenate([a[None], b]) for a, b in zip(head, rest, strict=True)))


def update(gains: Gains, now: Now, state: Window, sample: Measurement) -> Window:
    """Insert a sample of the state's tick into the window, drop the oldest, and solve for all states again."""
    z, P, _ = kalman.update_linearized(gains, now, state.mean, state.P, sample, state.mean)

    def shift(rows: Array, entry: Array) -> Array:
        return jnp.concatenate([rows[1:], jnp.asarray(entry)[None]])

    w = state._replace(
        samples=jax.tree.map(shift, state.samples, sample),
        covariances=shift(state.covariances, P),
        prior_mean=state.means[0],
        prior_P=state.covariances[0],
        prior_tick=state.samples.tick[0],
    )
    path = jnp.concatenate([state.path, clip_parameters(gains, z)[None]])

    def gauss_newton_step(_: Array, path: Array) -> Array:
        chain, bounds = linearize_path(gains, now, w, path), gains.extra.bounds
        return structured_qp.solve_bounded(chain, bounds, path) if bounds else structured_qp.smooth_chain(chain)

    path = lax.fori_loop(0, gains.extra.iterations.shape[0], gauss_newton_step, path)
    return w._replace(mean=path[-1], P=P, path=path[1:], means=shift(state.means, path[-1]))


OBSERVER = repropagation.observer(
    repropagation.FilterFunctions(ekf_iterated.tick, update, ekf_iterated.innovation_at_mean, first)
)


def bounds_of(context: DesignContext, options: Options, where: str) -> Bounds | tuple[()]:
    """Return the bounds of states and unknowns, () without bounds; raise UserError if they do not fit or exclude xhat0."""
    n = len(context.model.A)
    bounds = []
    for name, default in (("lower", -np.inf), ("upper", np.inf)):
        bound = getattr(options, name)
        if isinstance(bound, list) and len(bound) != n:
            raise UserError(f"{where}: {name}: got {brief_repr(bound)}, expected a number, or {n}, one for each state.")
        bounds.append(np.broadcast_to(default if bound is None else np.asarray(bound, float), n))
    low, high = bounds
    if not np.all(low < high):
        raise UserError(
            f"{where}: got lower = {low.tolist()} and upper = {high.tolist()}, expected the first below; change them."
        )
    start = np.array(context.xhat0 or low)
    if np.any(start < low) or np.any(start > high):
        raise UserError(
            f"{where}: got bounds that leave out xhat0 = {start.tolist()}, expected lower <= xhat0 <= upper; widen them, or "
            "start within."
        )
    unknown_range = np.array(context.unknown_range, float).reshape(-1, 2)
    low, high = np.append(low, unknown_range[:, 0]), np.append(high, unknown_range[:, 1])
    if not (np.isfinite(low) | np.isfinite(high)).any():
        return ()
    size = np.sqrt(np.append(np.diag(context.P0), np.square(context.unknown_std)))
    return Bounds(low, high, 0.01 * np.where(size > 0, size, 1.0))


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; raise UserError for a window longer than a run, or for bounds that exclude xhat0."""
    where = f"mhe in {context.scenario}"
    longest = sum(context.ticks // period + 1 for period in context.period)
    window = min(DEFAULT_WINDOW, longest) if options.window is None else options.window
    if window > longest:
        raise UserError(
            f"{where}: got a window of {window} samples, longer than the duration, in which {longest} are taken; expected "
            f"at most {longest}."
        )
    horizon = Horizon(np.zeros(window), np.zeros(options.iterations), bounds_of(context, options, where))
    return nonlinear_model.design(context, options, "mhe", lambda gains: horizon)
