"""kf-alexander: the covariance is updated when a sample is taken, the estimate when it arrives.

    taken at t_m:  K_m = P c (c'P c + r)^-1,   P <- (I - K_m c') P (I - K_m c')' + K_m r K_m',
                   M_i <- (I - K_m c') M_i of all that are on their way
    every tick:    P <- E P E' + Q,  M_i <- E M_i
    at arrival:    xhat <- xhat + M_m K_m (y - C xhat(t_m)),   M_m = I at t_m

P is that of a filter to which nothing comes late. xhat(t_m) is what was estimated when the sample was taken.

Source: Alexander 1991, printed for one late sample at a time. Keeps xhat(t_m) and M_m K_m for each sample on its way, n x
(1 + q) numbers; costs one update when a sample is taken and one product when it arrives. Found: it must be told at
sampling time that a sample will come. Once nothing is on its way it is `kf` to rounding, with any number of late samples
between; while one is, the others are used with gains that count on it, and it lies above. A sample that is lost was
counted on for ever: it is optimistic then (`test_late_samples`). Where more than one is on its way at all times it
never is `kf`.
Time index: the estimate is of now, after the jump.
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
    """The estimate of now, the covariance as if all had arrived, and what waits for each of J samples on their way."""

    xhat: Float[Array, " n"]
    P: Float[Array, "n n"]
    then: Float[Array, "J n"]  # xhat when the sample was taken
    K: Float[Array, "J n q"]  # M K: what its innovations will be worth
    at: Int[Array, ""]  # the tick of P and K
    taken: Int[Array, " J"]  # ticks; -1: none
    made: Int[Array, ""]
    tick: Int[Array, ""]


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Start from the prior, with nothing on its way."""
    first, J, zero = linear_filter.prior(gains, xhat0), gains.own.shape[0], jnp.asarray(0)
    n, q = first.mean.shape[0], gains.C.shape[0]
    return Memory(
        xhat=first.mean,
        P=first.P,
        then=jnp.zeros((J, n)),
        K=jnp.zeros((J, n, q)),
        at=zero,
        taken=jnp.full(J, -1),
        made=zero,
        tick=zero,
    )


def predict_memory(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Return the memory with covariance and gains of now."""
    age, powers = now.tick - memory.at, gains.motion.powers
    J, n, q = memory.K.shape
    side = jnp.moveaxis(memory.K, 1, 0).reshape(n, J * q)
    K = jnp.moveaxis(after(powers, age, side).reshape(n, J, q), 0, 1)
    return memory._replace(P=covariance_after(powers, gains.noise, age, memory.P), K=K, at=now.tick)


def on_sample(gains: Gains, memory: Memory, now: Now, mask: Bool[Array, " q"]) -> Memory:
    """Update the covariance by what is taken now, and keep its gain until it arrives."""
    memory = predict_memory(gains, memory, now)
    mine = (jnp.arange(memory.taken.shape[0]) == memory.made % memory.taken.shape[0]) & jnp.any(mask)
    P, L = memory.P, jnp.where(mine[:, None, None], 0.0, memory.K)
    for channel in range(gains.C.shape[0]):
        c, r = gains.C[channel], gains.R[channel]
        K = kalman.gain(P @ c, c @ P @ c + r, mask[channel])
        P = kalman.covariance(P, K, c, r)
        L = L - K[None, :, None] * jnp.einsum("n,jnq->jq", c, L)[:, None, :]
        own = (jnp.arange(gains.C.shape[0]) == channel)[None, None, :] & mine[:, None, None]
        L = jnp.where(own, K[None, :, None], L)
    return memory._replace(
        P=P,
        K=L,
        then=jnp.where(mine[:, None], memory.xhat, memory.then),
        taken=jnp.where(mine, now.tick, memory.taken),
        made=memory.made + jnp.any(mask),
    )


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Add what the late innovations are worth now."""
    sample, memory = reorder_buffer.sample_of(now, arrival, gains.D), predict_memory(gains, memory, now)
    mine = (memory.taken == sample.taken).astype(float)
    expected = gains.C @ (mine @ memory.then)
    e = jnp.where(sample.mask, linear_filter.value_of(gains, sample) - expected, 0.0)
    K = jnp.einsum("j,jnq->nq", mine, memory.K)
    return memory._replace(xhat=memory.xhat + K @ e)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the covariance as if all that was taken had arrived, carried to now."""
    P = covariance_after(gains.motion.powers, gains.noise, memory.tick - memory.at, memory.P)
    return linear_filter.spread(gains, memory, P)


OBSERVER = Observer(
    init,
    no_snapshot,
    jump,
    prediction.flow_of_estimate,
    linear_filter.estimate,
    covariance=covariance,
    on_sample=on_sample,
)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, with room for what is on its way."""
    own, why = (
        stochastic_cloning.room(setting, "kf-alexander"),
        "its covariance includes measurements that have not arrived",
    )
    return linear_filter.design(setting, options, "kf-alexander", own=own, unproven=why)
