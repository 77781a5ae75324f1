"""kf-delayed-horizon: Kalman filter at a fixed lag L behind the present, with a prediction of its estimate to the present.

Samples are buffered until their age is L, and then used in the order in which they were taken:

    at every tick k: update with the samples taken at k - L;   xhat(k) = e^{A (k - t_m)} xhat_m + I(t_m, k)

No sample is filtered twice. A sample that arrives with an age above L is lost.

Source: Khosravian, Trumpf, Mahony, Hamel 2015. PX4's EKF2 has this form, with a predictor that follows the delayed filter by
a slow correction; here the prediction is exact.
Memory: one mean and covariance, and the buffered samples. Cost: one update per tick.
It equals `kf` on the schedule on which every sample arrives at age L. On other schedules, with no sample older than L, its
only disadvantage is the additional waiting time. If all ages are L, it equals `kf` up to rounding.
Time index: xhat is the estimate of the present, after the jump.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import linear_filter, prediction, reorder_buffer
from pcbench.observers.parts.common import select_memory
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Arrival, Gains, Leaf, Now, Observer, Room
from pcbench.synthesis.certificate import Design, DesignContext


class HorizonParams(NamedTuple):
    """Parameters in addition to those of the Kalman filter."""

    lag: Int[Leaf, ""]  # ticks
    room: Room  # for samples that are younger than the lag


class Memory(NamedTuple):
    """The present estimate, the posterior that it was predicted from, and the buffered samples."""

    g: Float[Array, " n"]
    xhat: Float[Array, " n"]
    posterior: Posterior  # at the newest sample used
    buffer: Measurement  # unordered; `mask` is False in an empty place
    tick: Int[Array, ""]


class Options(linear_filter.Options):
    """Lag of the filter."""

    lag: float | None = Field(
        None, ge=0, description="age at which measurements are used [s]; default: the largest delay of the schedule"
    )


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Return the memory at the prior, with an empty buffer."""
    first = linear_filter.prior(gains, xhat0)
    samples = reorder_buffer.start((), gains.extra.room, gains.C.shape[0], first.mean.shape[0]).samples
    return Memory(jnp.zeros_like(first.mean), first.mean, first, samples, jnp.asarray(0))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Buffer samples younger than the lag, use samples of that age, and drop older ones."""
    sample = reorder_buffer.zero_missing(reorder_buffer.sample_of(now, arrival, gains.D))
    due = now.tick - gains.extra.lag
    is_slot = jnp.arange(memory.buffer.tick.shape[0]) == jnp.argmin(memory.buffer.tick)

    def store(room: Array, entry: Array) -> Array:
        return jnp.where(jnp.reshape(is_slot, (-1, *[1] * entry.ndim)), entry[None], room)

    with_sample = memory._replace(buffer=jax.tree.map(store, memory.buffer, sample))
    buffered = select_memory(sample.mask & (sample.tick > due), with_sample, memory)
    return select_memory(sample.mask & (sample.tick == due), _apply_sample(gains, memory, now.tick, sample), buffered)


def _apply_sample(gains: Gains, memory: Memory, tick: Array, sample: Measurement) -> Memory:
    """Return the memory after an update by a sample, predicted to `tick`."""
    posterior = Posterior(*linear_filter.update(gains, memory.posterior, sample)[:3])
    free = prediction.predict_to(gains.motion, linear_filter.point(posterior), tick)
    return memory._replace(posterior=posterior, xhat=memory.g + free)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick, and use the samples whose age is then the lag; channels sampled together form one update."""
    memory = prediction.flow(gains, memory, now)
    samples, due = memory.buffer, memory.tick - gains.extra.lag
    is_due = samples.mask & (samples.tick == due)[:, None]
    sample = Measurement(
        due, jnp.sum(jnp.where(is_due, samples.value, 0.0), 0), jnp.any(is_due, 0),
        jnp.max(jnp.where(jnp.any(is_due, 1)[:, None], samples.snapshot, -jnp.inf), 0),
    )  # fmt: skip
    sample = sample._replace(snapshot=jnp.where(jnp.any(is_due), sample.snapshot, 0.0))
    return select_memory(is_due, _apply_sample(gains, memory, memory.tick, sample), memory)


OBSERVER = Observer(
    init, prediction.snapshot, jump, flow, linear_filter.estimate, covariance=linear_filter.covariance_of_posterior
)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, the lag in ticks, and room for the buffered samples."""
    latest = max(context.latest, *context.delay)
    lag = latest if options.lag is None else round(options.lag / context.dt)
    if lag > context.ticks:
        raise UserError(
            f"kf-delayed-horizon in {context.scenario}: got a lag of {lag * context.dt:g} s, expected at most the run's "
            f"{context.ticks * context.dt:g} s; write a shorter one."
        )
    room = context.flight * max(1, -(-lag // max(latest, 1)))
    reason = "" if lag == latest else "samples are used later than necessary, or not at all"
    params = HorizonParams(np.asarray(lag), np.zeros(room))
    return linear_filter.design(
        context, options, "kf-delayed-horizon", np.zeros(0), params, reason=reason, restarts=False
    )
