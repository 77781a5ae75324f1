"""ekf: extended Kalman filter that updates at the sampling time and propagates to the present tick by tick.

The state is z = (x, p): the plant's state x, and unknown parameters and inputs p, modelled as random walks. When a sample
arrives that was taken at t_m, the posterior of the preceding sample is propagated to t_m, tick by tick:

    P <- F P F' + Q,  F = I + h J(z, u),  J the Jacobian (jax),    z <- one Runge-Kutta step under the input of the tick

Then follow the update at t_m in Joseph form, one channel after the other, and the propagation of the mean to the present
under the stored inputs. For an output that is nonlinear in z, the update uses the Jacobian at the prediction. p is clipped to
the plant's range after every update and tick.

- Linear model: the tick is its exact map and F its matrix, so the filter is `kf` computed tick by tick.
- Plant defined by its step: the tick is that step, and F its Jacobian.
- R is the variance of one sample, and P0 = diag(prior_std^2, unknown_std^2). Q is the scenario's assumed process noise of x,
  and walk unknown_std^2 h of p.
- A sample from before t = 0 counts as a measurement of x(0). An out-of-sequence sample is inserted at its sampling time
  (`parts/reorder_buffer`).
- `gate` rejects outliers, and `huber` reduces their weight (`parts/robust_update`).

Time index: xhat is the estimate of the present, after the jump.
Not claimed: optimality, or that a parameter can be estimated if the motion contains no information on it.
Source: Jazwinski, Stochastic Processes and Filtering Theory, 1970, chapter 8.
"""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, PyTree

from pcbench.observers.parts import kalman, nonlinear_model, reorder_buffer, robust_update
from pcbench.observers.parts.common import for_each_channel, no_snapshot, vmap_large_as_unit
from pcbench.observers.parts.kalman import MeanAndCovariance, Posterior
from pcbench.observers.parts.nonlinear_model import (
    Gains,
    clip_parameters,
    decorrelate,
    linearize_sensor,
    now_at,
    predict_joint,
    value_near,
)
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.observers.parts.robust_update import AnyPosterior
from pcbench.protocols import Arrival, InnovationStats, Now, Observer
from pcbench.synthesis.certificate import Design, DesignContext


class Memory(NamedTuple):
    """The buffered samples with the posterior before them, and the present mean."""

    buffer: Buffer
    z: Float[Array, " N"]


class Options(nonlinear_model.Options):
    """Assumptions of the filter, and its treatment of outliers."""

    gate: float | None = robust_update.GATE
    gate_opens: int = robust_update.OPENS
    huber: float | None = robust_update.HUBER


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at the prior: xhat(0), the initial p, and P0."""
    z, q = nonlinear_model.initial_joint_state(gains, xhat0), gains.C.shape[0]
    first = robust_update.initial_posterior(Posterior(z, gains.P0, jnp.asarray(0)), gains.guard, q)
    return Memory(reorder_buffer.start(first, gains.room, q, 0), z)


def update(gains: Gains, now: Now, before: AnyPosterior, sample: Measurement) -> AnyPosterior:
    """Propagate mean and covariance to the sampling time, and update there, channel by channel."""
    z, P = predict_joint(gains, now, before, sample.tick)
    if gains.sensor is not None:
        z, P, rejections = update_linearized(gains, now_at(now, sample.tick), before._replace(mean=z, P=P), sample)
        return robust_update.new_posterior(before, clip_parameters(gains, z), P, sample.tick, rejections)
    n, zeros = gains.C.shape[1], jnp.zeros(z.shape[0] - gains.C.shape[1])

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (z, P), (c, value, r, mask, count) = posterior, channel
        Pc = P[:, :n] @ c
        nu = value - c @ z[:n]
        is_used, r, count = robust_update.weigh(gains.guard, count, nu, c @ Pc[:n] + r, r, mask)
        K = kalman.gain(Pc, c @ Pc[:n] + r, is_used)
        return (z + K * nu, kalman.covariance(P, K, jnp.concatenate([c, zeros]), r)), count

    value, R = decorrelate(gains, sample.value), sample.variances(gains.R)
    channels = gains.C, value, R, sample.mask, robust_update.rejections(before)
    (z, P), rejections = for_each_channel(use_channel, (z, P), channels)
    return robust_update.new_posterior(before, clip_parameters(gains, z), P, sample.tick, rejections)


def update_linearized(
    gains: Gains, sample_now: Now, before: AnyPosterior, sample: Measurement
) -> tuple[Array, Array, PyTree]:
    """Return mean, covariance and rejection counts after an update by a nonlinear sensor, linearised at the predicted z."""
    prior, R = before.mean, sample.variances(gains.R)
    y, C = linearize_sensor(gains, sample_now, prior[: gains.P0.shape[0]])

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (z, P), (c, value, y, r, mask, count) = posterior, channel
        Pc = P @ c
        nu = value - y - c @ (z - prior)
        is_used, r, count = robust_update.weigh(gains.guard, count, nu, c @ Pc + r, r, mask)
        K = kalman.gain(Pc, c @ Pc + r, is_used)
        return (z + K * nu, kalman.covariance(P, K, c, r)), count

    C, value = kalman.pad_columns(C, prior.shape[0]), value_near(gains, sample.value, y)
    channels = C, value, y, R, sample.mask, robust_update.rejections(before)
    (z, P), rejections = for_each_channel(use_channel, (prior, before.P), channels)
    return z, P, rejections


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Insert the arriving sample in order of sampling, and propagate the mean to the present."""
    sample = reorder_buffer.sample_of(now, arrival, gains.D)
    buffer, newest = reorder_buffer.replay(
        lambda state, sample: update(gains, now, state, sample), memory.buffer, sample
    )
    z = lax.fori_loop(
        newest.tick, now.tick, lambda k, z: clip_parameters(gains, gains.motion(now_at(now, k), z)), newest.mean
    )
    return Memory(buffer, z)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Propagate the mean by one tick."""
    return memory._replace(z=clip_parameters(gains, gains.motion(now, memory.z)))


def estimate(gains: Gains, memory: Memory) -> Float[Array, " N"]:
    """Return the present xhat, and the unknowns."""
    return memory.z


def newest(gains: Gains, memory: Memory, now: Now) -> AnyPosterior:
    """Return mean and covariance at the newest sample used."""
    return reorder_buffer.newest(lambda state, sample: update(gains, now, state, sample), memory.buffer)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "N N"]:
    """Return the present covariance: P at the newest sample used, propagated by the Jacobian of every tick since."""
    return predict_joint(gains, now, newest(gains, memory, now), now.tick)[1]


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of a sample, predicted from all samples that arrived before, newer ones included."""
    buffer, sample = memory.buffer, reorder_buffer.sample_of(now, arrival, gains.D)
    first, N = buffer.before, gains.P0.shape[0]
    mask, marker = sample.mask & (sample.tick >= first.tick), jnp.maximum(sample.tick, first.tick)

    def copy(state: AnyPosterior, sample: Measurement) -> AnyPosterior:
        z, P = predict_joint(gains, now, state, sample.tick)
        return state._replace(mean=jnp.tile(z[:N], 2), P=kalman.with_copy(P, N), tick=sample.tick)

    if buffer.samples.tick.shape[0]:
        update_at = partial(update, gains, now)
        joint_buffer = reorder_buffer.replace_states(
            buffer, lambda state: state._replace(mean=jnp.tile(state.mean, 2), P=kalman.with_copy(state.P, N))
        )
        state = reorder_buffer.newest_with_copy(update_at, copy, joint_buffer, sample._replace(tick=marker))
        z, P = state.mean[N:], state.P[N:, N:]
    else:
        z, P = predict_joint(gains, now, first, sample.tick)
    return kalman.update_linearized(gains, now_at(now, sample.tick), z, P, sample._replace(mask=mask), z)[2]


def _vmap_large(f: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the filter, vectorized as a unit if the covariance is large."""

    @wraps(f)
    def wrapper(gains: Gains, memory: Memory, now: Now, *arrival: Arrival) -> Any:
        return vmap_large_as_unit(gains.P0, lambda memory, *arrival: f(gains, memory, now, *arrival))(memory, *arrival)

    return wrapper


OBSERVER = Observer(
    init,
    no_snapshot,
    _vmap_large(jump),
    _vmap_large(flow),
    estimate,
    covariance=_vmap_large(covariance),
    innovation=_vmap_large(innovation),
)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; a nonlinear model has no certificate."""
    guard = robust_update.make_guard(options.gate, options.gate_opens, options.huber)
    return nonlinear_model.design(context, options, "ekf", guard=guard)
