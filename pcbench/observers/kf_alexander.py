"""kf-alexander: Kalman filter that updates the covariance when a sample is taken, and the estimate when it arrives.

    taken at t_m:  K_m = P c (c'P c + r)^-1,   P <- (I - K_m c') P (I - K_m c')' + K_m r K_m',
                   M_i <- (I - K_m c') M_i for every sample i in transit
    every tick:    P <- E P E' + Q,  M_i <- E M_i
    at arrival:    xhat <- xhat + M_m K_m (y - C xhat(t_m)),   M_m = I at t_m

P is the covariance of a filter without delays. xhat(t_m) is the estimate at the tick at which the sample was taken.

Source: Alexander 1991, printed for one delayed sample at a time.
Memory: xhat(t_m) and M_m K_m for each sample in transit, n (1 + q) numbers. Cost: one update when a sample is taken, and one
product when it arrives. The observer needs a signal when a sample is taken.

Properties (`test_late_samples`):

- When no sample is in transit, it equals `kf` up to rounding, however many delayed samples it has used.
- While a sample is in transit, the gains of other samples assume that it will arrive, and the error is larger than that of
  `kf`. If there is always more than one in transit, it never equals `kf`.
- After a sample is lost, P stays too small (optimistic), as it includes the lost sample.

Time index: xhat is the estimate of the present, after the jump.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from pcbench.dynamics.integrate import after, covariance_after
from pcbench.observers.parts import kalman, linear_filter, prediction, reorder_buffer, stochastic_cloning
from pcbench.observers.parts.common import no_snapshot
from pcbench.protocols import Arrival, Gains, Now, Observer
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


class Memory(NamedTuple):
    """Present estimate, covariance as if all samples had arrived, and data of J samples in transit."""

    xhat: Float[Array, " n"]
    P: Float[Array, "n n"]
    sampled_xhat: Float[Array, "J n"]  # xhat when the sample was taken
    K: Float[Array, "J n q"]  # M K: gain of its innovation at tick `covariance_tick`
    covariance_tick: Int[Array, ""]  # the tick of P and K
    sampling_ticks: Int[Array, " J"]  # ticks; -1: none
    n_samples: Int[Array, ""]  # number of samples taken so far
    tick: Int[Array, ""]


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Return the memory at the prior, with no sample in transit."""
    first, J, zero = linear_filter.prior(gains, xhat0), gains.extra.shape[0], jnp.asarray(0)
    n, q = first.mean.shape[0], gains.C.shape[0]
    return Memory(
        xhat=first.mean,
        P=first.P,
        sampled_xhat=jnp.zeros((J, n)),
        K=jnp.zeros((J, n, q)),
        covariance_tick=zero,
        sampling_ticks=jnp.full(J, -1),
        n_samples=zero,
        tick=zero,
    )


def predict_memory(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Return the memory with covariance and gains propagated to the present."""
    age, powers = now.tick - memory.covariance_tick, gains.motion.powers
    J, n, q = memory.K.shape
    columns = jnp.moveaxis(memory.K, 1, 0).reshape(n, J * q)
    K = jnp.moveaxis(after(powers, age, columns).reshape(n, J, q), 0, 1)
    return memory._replace(P=covariance_after(powers, gains.noise, age, memory.P), K=K, covariance_tick=now.tick)


def on_sample(gains: Gains, memory: Memory, now: Now, mask: Bool[Array, " q"]) -> Memory:
    """Update the covariance for the sample that is taken now, and store its gain until it arrives."""
    memory = predict_memory(gains, memory, now)
    J = memory.sampling_ticks.shape[0]
    slot = (jnp.arange(J) == memory.n_samples % J) & jnp.any(mask)
    P, L = memory.P, jnp.where(slot[:, None, None], 0.0, memory.K)
    for channel in range(gains.C.shape[0]):
        c, r = gains.C[channel], gains.R[channel]
        K = kalman.gain(P @ c, c @ P @ c + r, mask[channel])
        P = kalman.covariance(P, K, c, r)
        L = L - K[None, :, None] * jnp.einsum("n,jnq->jq", c, L)[:, None, :]
        entry = (jnp.arange(gains.C.shape[0]) == channel)[None, None, :] & slot[:, None, None]
        L = jnp.where(entry, K[None, :, None], L)
    return memory._replace(
        P=P,
        K=L,
        sampled_xhat=jnp.where(slot[:, None], memory.xhat, memory.sampled_xhat),
        sampling_ticks=jnp.where(slot, now.tick, memory.sampling_ticks),
        n_samples=memory.n_samples + jnp.any(mask),
    )


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Add the delayed innovations, multiplied by their propagated gains."""
    sample, memory = reorder_buffer.sample_of(now, arrival, gains.D), predict_memory(gains, memory, now)
    slot = (memory.sampling_ticks == sample.tick).astype(float)
    expected = gains.C @ (slot @ memory.sampled_xhat)
    e = jnp.where(sample.mask, linear_filter.decorrelated_value(gains, sample) - expected, 0.0)
    K = jnp.einsum("j,jnq->nq", slot, memory.K)
    return memory._replace(xhat=memory.xhat + K @ e)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the present covariance as if all samples taken had arrived."""
    P = covariance_after(gains.motion.powers, gains.noise, memory.tick - memory.covariance_tick, memory.P)
    return linear_filter.signal_covariance(gains, memory, P)


OBSERVER = Observer(
    init,
    no_snapshot,
    jump,
    prediction.flow_of_estimate,
    linear_filter.estimate,
    covariance=covariance,
    on_sample=on_sample,
)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, with room for the samples in transit; there is no certificate."""
    room = stochastic_cloning.room(context, "kf-alexander")
    reason = "its covariance includes measurements that have not arrived"
    return linear_filter.design(context, options, "kf-alexander", extra=room, reason=reason)
