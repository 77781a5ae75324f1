"""mmae-delay: a Kalman filter for each of several delays, weighted by likelihood.

Filter j assumes the mean delay d_j. The delay of a single sample differs from it as its timestamp shows
(`parts/unknown_delay`). The filter is `kf` for that delay: it updates at that time, and predicts to the present under the
stored inputs. With its innovations nu and their variances s,

    log w_j <- log w_j - (nu^2 / s + log s) / 2,   weights of sum 1,   xhat = sum w_j xhat_j,   tau = sum w_j d_j

and the covariance is that of the mixture. At the start w_j is the prior's density at d_j. If the true delay is one of the d_j
and the assumed noise is true, this is the posterior mean: no causal estimator has a smaller mean square error over that prior.
Not claimed: anything for a delay between two of them, where the weights converge to one neighbour and the covariance is too
small; nor for delays that vary without timestamps. The step between delays should be smaller than the standard deviation that
the samples allow (`statistics.distributions`). The computing time is proportional to the number of delays.
Time index: xhat is the estimate of the present, after the jump. An out-of-sequence sample is inserted at its sampling time
(`parts/reorder_buffer`), and changes the weights as if it had arrived in order. A sample whose assumed sampling tick is in
the future counts as taken at its arrival.
Source: Magill, IEEE Trans. Automatic Control 10 (1965), 434.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import kalman, reorder_buffer, unknown_delay
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.observers.parts.unknown_delay import Gains, signal_covariance, signals_of
from pcbench.protocols import Arrival, Now, Observer, vmap_as_unit
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate

FILTERS = 21  # default number of delays, evenly spaced from 0 to the longest
MAX_DELAYS = 200  # delays


class Filters(NamedTuple):
    """M Kalman filters, each at the sampling tick that it assumes for the newest sample."""

    x: Float[Array, "M n"]
    P: Float[Array, "M n n"]
    ticks: Int[Array, " M"]
    weight: Float[Array, " M"]  # logarithm


class Memory(NamedTuple):
    """The buffered samples with the filters before them, and the present estimate."""

    buffer: Buffer
    delay: Float[Array, ""]  # s
    xhat: Float[Array, " n"]


class Options(unknown_delay.Options):
    """Assumptions of the filters."""

    delays: list[float] | None = Field(
        None, min_length=1, description="candidate delays [s]; default: 21 values from 0 to `longest`"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory with every filter at the prior, weighted by the prior density of its delay."""
    n_models = gains.extra.shape[0]
    deviation = (gains.extra * gains.dt - gains.delay) / gains.delay_std
    weight = jax.nn.log_softmax(-0.5 * jnp.square(deviation))
    first = Filters(
        x=jnp.broadcast_to(xhat0, (n_models, *xhat0.shape)),
        P=jnp.broadcast_to(gains.P0, (n_models, *gains.P0.shape)),
        ticks=jnp.zeros(n_models, int),
        weight=weight,
    )
    return Memory(reorder_buffer.start(first, gains.room, gains.C.shape[0], 1), mean(gains, weight), xhat0)


def snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, "1"]:
    """Reserve a place for the tick of the arrival, which `jump` fills in."""
    return jnp.zeros(1)


def predict_models(gains: Gains, now: Now, x: Array, P: Array, start: Array, stop: Array) -> tuple[Array, Array]:
    """Return means [M, n] and covariances at ticks `stop` [M] from those at ticks `start`, under the stored inputs."""

    def tick(i: Array, xP: tuple[Array, Array]) -> tuple[Array, Array]:
        x, P = xP
        k = start + i
        u, is_active = jax.vmap(now.past_u)(jnp.maximum(now.tick - k, 1)), k < stop
        x_next = x @ gains.Phi.T + u @ gains.Gamma.T
        P_next = jnp.einsum("ab,mbc,dc->mad", gains.Phi, P, gains.Phi) + gains.Q[None]
        return jnp.where(is_active[:, None], x_next, x), jnp.where(is_active[:, None, None], P_next, P)

    return lax.fori_loop(0, jnp.max(stop - start), tick, (x, P))


def update_model(gains: Gains, sample: Measurement, x: Array, P: Array) -> tuple[Array, Array, Array]:
    """Return mean, covariance and log-likelihood of one filter after a sample of its tick."""
    likelihood = jnp.zeros(())
    for channel in range(gains.C.shape[0]):
        c, r, mask = gains.C[channel], gains.R[channel], sample.mask[channel]
        nu, s = sample.value[channel] - c @ x, c @ P @ c + r
        likelihood = likelihood - jnp.where(mask, 0.5 * (nu * nu / s + jnp.log(s)), 0.0)
        K = kalman.gain(P @ c, s, mask)
        x, P = x + jnp.where(mask, K * nu, 0.0), kalman.covariance(P, K, c, r)
    return x, P, likelihood


def step(gains: Gains, now: Now, before: Filters, sample: Measurement) -> Filters:
    """Update every filter at its assumed sampling tick, and its weight by the likelihood of the sample."""
    arrival_tick = sample.snapshot[0].astype(int)
    ticks = jnp.maximum(jnp.minimum(sample.tick - gains.extra, arrival_tick), before.ticks)  # 0 at the start
    x, P = predict_models(gains, now, before.x, before.P, before.ticks, ticks)
    x, P, likelihood = jax.vmap(partial(update_model, gains, sample))(x, P)
    return Filters(x, P, ticks, jax.nn.log_softmax(before.weight + likelihood))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Insert the arriving sample in order of sampling, and mix the filters' predictions of the present."""

    def apply(memory: Memory, arrival: Arrival) -> Memory:
        arrival_tick = jnp.asarray(now.tick, float)[None]
        sample = Measurement(
            unknown_delay.expected_arrival_tick(gains, now, arrival), arrival.value, arrival.mask, arrival_tick
        )
        buffer, filters = reorder_buffer.replay(partial(step, gains, now), memory.buffer, sample)
        present_ticks = jnp.full_like(filters.ticks, now.tick)
        present = predict_models(gains, now, filters.x, filters.P, filters.ticks, present_ticks)[0]
        return Memory(buffer, mean(gains, filters.weight), jnp.exp(filters.weight) @ present)

    return vmap_as_unit(apply)(memory, arrival)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Propagate the present estimate by one tick."""
    return memory._replace(xhat=gains.Phi @ memory.xhat + gains.Gamma @ now.u)


def mean(gains: Gains, weight: Float[Array, " M"]) -> Float[Array, ""]:
    """Return the posterior mean of the delay [s]."""
    return jnp.sum(jnp.exp(weight) * gains.extra * gains.dt)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " signals"]:
    """Return the present xhat, and the delay if it is the plant's unknown."""
    return signals_of(gains, memory.xhat, memory.delay)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the covariance of the mixture: within the filters, and of their means and delays."""

    def mixture(memory: Memory) -> Array:
        filters = reorder_buffer.newest(partial(step, gains, now), memory.buffer)
        x, P = predict_models(gains, now, filters.x, filters.P, filters.ticks, jnp.full_like(filters.ticks, now.tick))
        probability, n = jnp.exp(filters.weight), gains.C.shape[1]
        z = jnp.concatenate([x, (gains.dt * gains.extra)[:, None]], 1)
        deviation = z - (probability @ z)[None]
        joint = (probability[:, None] * deviation).T @ deviation
        return signal_covariance(gains, joint.at[:n, :n].add(jnp.tensordot(probability, P, 1)))

    return vmap_as_unit(mixture)(memory)


def delay(gains: Gains, memory: Memory, now: Now) -> Float[Array, "2"]:
    """Return mean and standard deviation of the delay [s] by the weights of the filters."""
    weight = jnp.exp(reorder_buffer.newest(partial(step, gains, now), memory.buffer).weight)
    deviation = gains.extra * gains.dt - memory.delay
    return jnp.stack([memory.delay, jnp.sqrt(jnp.sum(weight * jnp.square(deviation)))])


OBSERVER = Observer(init, snapshot, jump, flow, estimate, covariance=covariance, delay=delay)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions of the filters; raise UserError for delays out of range, or for too many."""
    where, dt = f"mmae-delay in {context.scenario}", context.dt
    delays = options.delays
    if delays and options.longest is None:
        options = options.model_copy(update={"longest": max(*delays, dt)})
    gains = unknown_delay.design(context, options, "mmae-delay")
    longest = int(gains.longest)
    ticks = np.unique(np.round(np.asarray(delays) / dt if delays else np.linspace(0, longest, FILTERS)).astype(int))
    if ticks[0] < 0 or ticks[-1] > longest:
        raise UserError(
            f"{where}: delays: got {ticks[0] * dt:g} to {ticks[-1] * dt:g} s, expected 0 to the longest, {longest * dt:g} s."
        )
    if len(ticks) > MAX_DELAYS:
        raise UserError(
            f"{where}: delays: got {len(ticks)} filters, expected at most {MAX_DELAYS}; write fewer delays."
        )
    return Design(gains._replace(extra=ticks), no_certificate("the weights are not linear in the measurements"))
