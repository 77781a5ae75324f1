"""Stochastic cloning: copies (clones) of the estimate at the sampling times, with their joint covariance with the present.

    z = (x, x_1, ..., x_J); only x is propagated: x <- E x, P_xx <- E P_xx E' + Q, P_xi <- E P_xi

When a sample is taken (`Observer.on_sample`), a clone replaces the oldest of J. When the sample arrives, it updates z through
its clone, with h = P c_i, where c_i contains c at the place of clone i, s = c_i'h + r, and any gain K of z:

    z <- z + K (y - c'x_i),   P <- P - K h' - h K' + s K K'

This is the true covariance for every gain. `Gain` computes K. P is that of the last event, and is propagated to the next one.
J is the largest number of samples in transit. A sample whose clone has been replaced is lost.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, PyTree

from pcbench.dynamics.integrate import after, covariance_after
from pcbench.errors import UserError
from pcbench.observers.parts import kalman, linear_filter, prediction, reorder_buffer
from pcbench.observers.parts.common import for_each_channel, no_snapshot, vmap_large_as_unit
from pcbench.observers.parts.kalman import MeanAndCovariance
from pcbench.observers.parts.linear_filter import Gains
from pcbench.protocols import Arrival, InnovationStats, Now, Observer, Room
from pcbench.synthesis.certificate import DesignContext

MAX_CLONES = 16  # clones; the joint covariance has (17 n)^2 entries
# (h [joint], s, mask of the rows of the present and of the sample's clone) -> K [joint]
Gain = Callable[[Array, Array, Array], Array]


class Memory(NamedTuple):
    """The present estimate, and those at sampling times; joint = (J + 1) n."""

    xhat: Float[Array, " n"]
    clones: Float[Array, "J n"]
    P: Float[Array, "joint joint"]
    covariance_tick: Int[Array, ""]  # the tick of P
    sampling_ticks: Int[Array, " J"]  # ticks; -1: none
    n_clones: Int[Array, ""]  # number of clones made so far
    tick: Int[Array, ""]


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Return the memory at the prior, without clones."""
    first, J = linear_filter.prior(gains, xhat0), gains.extra.shape[0]
    n = first.mean.shape[0]
    P = jnp.zeros(((J + 1) * n, (J + 1) * n)).at[:n, :n].set(first.P)
    zero = jnp.asarray(0)
    return Memory(
        xhat=first.mean,
        clones=jnp.zeros((J, n)),
        P=P,
        covariance_tick=zero,
        sampling_ticks=jnp.full(J, -1),
        n_clones=zero,
        tick=zero,
    )


def predict_clone(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Return the memory with the present covariance."""
    n, age = memory.xhat.shape[0], now.tick - memory.covariance_tick
    powers = gains.motion.powers
    P_now = covariance_after(powers, gains.noise, age, memory.P[:n, :n])
    cross_covariance = after(powers, age, memory.P[:n, n:])
    P = jnp.block([[P_now, cross_covariance], [cross_covariance.T, memory.P[n:, n:]]])
    return memory._replace(P=P, covariance_tick=now.tick)


def on_sample(gains: Gains, memory: Memory, now: Now, mask: Bool[Array, " q"]) -> Memory:
    """Replace the oldest clone by the present estimate."""

    def clone(memory: Memory, mask: Array) -> Memory:
        memory = predict_clone(gains, memory, now)
        J, n = memory.clones.shape
        slot = jnp.arange(J) == memory.n_clones % J
        row = jnp.repeat(jnp.append(False, slot), n)
        P_rows = jnp.tile(memory.P[:n], (J + 1, 1))
        P = jnp.where(row[:, None], P_rows, memory.P)
        P = jnp.where(row[None, :], jnp.tile(P[:, :n], (1, J + 1)), P)
        is_sampled = jnp.any(mask)
        return memory._replace(
            clones=jnp.where((slot & is_sampled)[:, None], memory.xhat, memory.clones),
            P=jnp.where(is_sampled, P, memory.P),
            sampling_ticks=jnp.where(slot & is_sampled, now.tick, memory.sampling_ticks),
            n_clones=memory.n_clones + is_sampled,
        )

    return vmap_large_as_unit(memory.P, clone)(memory, mask)


def observer(gain: Gain) -> Observer:
    """Return the observer with this gain."""

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        def apply(memory: Memory, arrival: Arrival) -> Memory:
            sample, memory = reorder_buffer.sample_of(now, arrival, gains.D), predict_clone(gains, memory, now)
            n, P = memory.xhat.shape[0], memory.P
            z = jnp.concatenate([memory.xhat, memory.clones.reshape(-1)])
            slot = jnp.append(False, memory.sampling_ticks == sample.tick)
            pair_mask = jnp.repeat(slot.at[0].set(True), n)
            value, R = linear_filter.decorrelated_value(gains, sample), sample.variances(gains.R)

            def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
                (z, P), (c, value, r, mask) = posterior, channel
                row = (slot[:, None] * c[None, :]).reshape(-1)
                h = P @ row
                s = row @ h + r
                K = jnp.where(mask, gain(h, s, pair_mask), 0.0)
                P = P - jnp.outer(K, h) - jnp.outer(h, K) + s * jnp.outer(K, K)
                return (z + K * (value - row @ z), P), ()

            channels = gains.C, value, R, sample.mask & jnp.any(slot)
            (z, P), _ = for_each_channel(use_channel, (z, P), channels)
            return memory._replace(xhat=z[:n], clones=z[n:].reshape(memory.clones.shape), P=P)

        return vmap_large_as_unit(memory.P, apply)(memory, arrival)

    return Observer(
        init,
        no_snapshot,
        jump,
        prediction.flow_of_estimate,
        linear_filter.estimate,
        covariance=covariance,
        on_sample=on_sample,
    )


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of a sample, in any order of arrival, because every sample corrects all clones."""

    def score(memory: Memory, arrival: Arrival) -> InnovationStats:
        sample, memory = reorder_buffer.sample_of(now, arrival, gains.D), predict_clone(gains, memory, now)
        z, P = jnp.concatenate([memory.xhat, memory.clones.reshape(-1)]), memory.P
        slot = jnp.append(False, memory.sampling_ticks == sample.tick)
        mask = sample.mask & jnp.any(slot)

        def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
            (z, P), (c, value, r, mask) = posterior, channel
            row = (slot[:, None] * c[None, :]).reshape(-1)
            h = P @ row
            nu, s = value - row @ z, row @ h + r
            K = kalman.gain(h, s, mask)
            return (z + K * nu, kalman.covariance(P, K, row, r)), (nu, s)

        channels = gains.C, linear_filter.decorrelated_value(gains, sample), sample.variances(gains.R), mask
        _, (nu, s) = for_each_channel(use_channel, (z, P), channels)
        return kalman.innovation_stats(nu, s, mask)

    return vmap_large_as_unit(memory.P, score)(memory, arrival)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the present covariance."""
    n = memory.xhat.shape[0]
    P = covariance_after(gains.motion.powers, gains.noise, memory.tick - memory.covariance_tick, memory.P[:n, :n])
    return linear_filter.signal_covariance(gains, memory, P)


def room(context: DesignContext, name: str) -> Room:
    """Return room for a clone of every sample in transit; raise UserError for a delay error, or for too many samples."""
    if context.error:
        raise UserError(
            f"{name} in {context.scenario}: got an assumed_delay_error of {context.error * context.dt:g} s, expected 0: it "
            "clones the state when a sample is taken and does not use its timestamp; leave it out, or use kf."
        )
    if context.flight > MAX_CLONES:
        raise UserError(
            f"{name} in {context.scenario}: got up to {context.flight} samples in transit at once, expected at most "
            f"{MAX_CLONES}: each has a copy of the state; use a longer sampling period, a shorter delay, or kf."
        )
    return np.zeros(context.flight)
