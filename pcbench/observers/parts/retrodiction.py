"""Out-of-sequence updates by retrodiction: the estimate is predicted back to the sampling time of an older sample.

The filter is at t_k, the time of the newest sample used. An older sample was taken at tau. F = e^{-A (t_k - tau)}, Q is the
process noise from tau to t_k, P- is the covariance before the update at t_k, and that update has u = H'S^-1 nu, U = H'S^-1 H:

    v = Q u (or 0),   P_vv = Q - Q U Q (or Q),   P_xv = Q - P- U Q
    x(tau) = F (x - v),   P(tau) = F (P + P_vv - P_xv - P_xv') F',   P(t_k, tau) = (P - P_xv) F'

The sample updates x through x(tau). This is the update of a state with one copy (`kalman`), where the copy is made at the
arrival. No sample is filtered twice. Means exclude the response to the input (`prediction`).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, PyTree

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after, covariance_after
from pcbench.errors import UserError
from pcbench.observers.parts import kalman, linear_filter, prediction, reorder_buffer
from pcbench.observers.parts.common import for_each_channel, select_memory
from pcbench.observers.parts.kalman import MeanAndCovariance, Posterior
from pcbench.observers.parts.linear_filter import Gains
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Arrival, InnovationStats, Leaf, Now, Observer, Room
from pcbench.synthesis.certificate import Design, DesignContext

SINGULAR = 1e12  # condition number of a discrete model's A from which on it counts as singular


class RetrodictionParams(NamedTuple):
    """Parameters in addition to those of the Kalman filter."""

    backward_powers: Float[Leaf, "2 R n n"]  # e^{-A h i R^level}
    past_samples: Room  # for their posteriors


class LastUpdate(NamedTuple):
    """The update at the newest sample's time."""

    P: Float[Array, "n n"]  # before it
    u: Float[Array, " n"]  # H'S^-1 nu
    U: Float[Array, "n n"]  # H'S^-1 H


class Past(NamedTuple):
    """Posteriors of past samples, the newest last."""

    mean: Float[Array, "K N"]
    P: Float[Array, "K N N"]
    ticks: Int[Array, " K"]


class Memory(NamedTuple):
    """The present estimate, the filter at its newest sample, its last update, and past posteriors."""

    g: Float[Array, " n"]
    xhat: Float[Array, " n"]
    posterior: Posterior
    last_update: LastUpdate
    past: Past  # before it
    tick: Int[Array, ""]


# (gains, memory, tau) -> an update equivalent to all updates after tau
Retrodict = Callable[[Gains, Memory, Array], LastUpdate]


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Return the memory at the prior, with the prior as past posteriors."""
    first, N = linear_filter.prior(gains, xhat0), gains.extra.past_samples.shape[0]
    n = first.mean.shape[0]
    no_update = LastUpdate(first.P, jnp.zeros(n), jnp.zeros((n, n)))
    past = Past(jnp.tile(first.mean, (N, 1)), jnp.tile(first.P, (N, 1, 1)), jnp.zeros(N, int))
    return Memory(jnp.zeros(n), first.mean, first, no_update, past, jnp.asarray(0))


def forward(gains: Gains, memory: Memory, sample: Measurement) -> Memory:
    """Update by a sample that is at least as new as the newest; channels of one tick count as one update."""
    before, same_tick = memory.posterior, sample.tick == memory.posterior.tick
    prior = linear_filter.predict_posterior(gains, before, sample.tick)
    P = jnp.where(same_tick, memory.last_update.P, prior.P)
    u, U = jnp.where(same_tick, memory.last_update.u, 0.0), jnp.where(same_tick, memory.last_update.U, 0.0)
    value, mean, R = linear_filter.decorrelated_value(gains, sample), prior.mean - P @ u, sample.variances(gains.R)
    for channel in range(gains.C.shape[0]):
        c, mask = gains.C[channel], sample.mask[channel]
        b = c - U @ (P @ c)
        s = c @ P @ b + R[channel]
        nu = value[channel] - c @ (sample.snapshot + mean + P @ u)
        u = u + jnp.where(mask, b * nu / s, 0.0)
        U = U + jnp.where(mask, jnp.outer(b, b) / s, 0.0)
    posterior = Posterior(*linear_filter.update(gains, before, sample)[:3])

    def shift(past: Array, entry: Array) -> Array:
        return jnp.where(same_tick, past, jnp.concatenate([past[1:], jnp.reshape(entry, (1, *past.shape[1:]))]))

    past = Past(*(shift(a, jnp.asarray(b)) for a, b in zip(memory.past, before, strict=True)))
    return memory._replace(posterior=posterior, last_update=LastUpdate(P, u, U), past=past)


def backward(
    gains: Gains, memory: Memory, sample: Measurement, last: LastUpdate, neglect_noise: bool
) -> tuple[Memory, InnovationStats]:
    """Return the memory after an update by an older sample, and the innovation statistics of that sample.

    With `neglect_noise`, the estimated process noise in between is 0.
    """
    (x, P, k), (P_prior, u, U) = memory.posterior, last
    n, age = x.shape[0], k - sample.tick
    Q = covariance_after(gains.motion.powers, gains.noise, age, jnp.zeros_like(P))
    noise = jnp.zeros(n) if neglect_noise else Q @ u
    vv = Q if neglect_noise else Q - Q @ U @ Q
    xv = Q - P_prior @ U @ Q
    P_sample = after(gains.extra.backward_powers, age, P + vv - xv - xv.T)
    P_sample = after(gains.extra.backward_powers, age, P_sample.T)
    cross_covariance = after(gains.extra.backward_powers, age, (P - xv).T).T
    z = jnp.concatenate([x, after(gains.extra.backward_powers, age, x - noise)])
    joint = jnp.block([[P, cross_covariance], [cross_covariance.T, P_sample]])

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (z, joint), (c, value, r, mask) = posterior, channel
        nu, s = value - c[n:] @ sample.snapshot - c @ z, c @ joint @ c + r
        K = kalman.gain(joint @ c, s, mask)
        return (z + K * nu, kalman.covariance(joint, K, c, r)), (nu, s)

    rows = jnp.concatenate([jnp.zeros_like(gains.C), gains.C], 1)
    channels = rows, linear_filter.decorrelated_value(gains, sample), sample.variances(gains.R), sample.mask
    (z, joint), (nu, s) = for_each_channel(use_channel, (z, joint), channels)
    return memory._replace(posterior=Posterior(z[:n], joint[:n, :n], k)), kalman.innovation_stats(nu, s, sample.mask)


def observer(retrodict: Retrodict, neglect_noise: bool) -> Observer:
    """Return the observer with this retrodiction; with `neglect_noise`, the estimated process noise in between is 0."""

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        sample = reorder_buffer.sample_of(now, arrival, gains.D)
        is_older = sample.tick < memory.posterior.tick
        update = retrodict(gains, memory, sample.tick)
        backward_memory = select_memory(is_older, backward(gains, memory, sample, update, neglect_noise)[0], memory)
        is_stored = sample.tick >= memory.past.ticks[0]
        forward_memory = forward(gains, memory, sample._replace(tick=jnp.maximum(sample.tick, memory.posterior.tick)))
        memory = select_memory(is_older, select_memory(is_stored, backward_memory, memory), forward_memory)
        free = prediction.predict_to(gains.motion, linear_filter.point(memory.posterior), now.tick)
        return memory._replace(xhat=memory.g + free)

    def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
        """Return the innovation statistics of a sample that is used; empty if it is older than the stored posteriors."""
        sample = reorder_buffer.sample_of(now, arrival, gains.D)
        is_stored = (sample.tick < memory.posterior.tick) & (sample.tick >= memory.past.ticks[0])
        older = sample._replace(mask=sample.mask & is_stored, tick=jnp.minimum(sample.tick, memory.posterior.tick))
        backward_stats = backward(gains, memory, older, retrodict(gains, memory, older.tick), neglect_noise)[1]
        forward_stats = linear_filter.newest_innovation_stats(gains, memory.posterior, sample)
        return select_memory(is_stored, backward_stats, forward_stats)

    return Observer(
        init,
        prediction.snapshot,
        jump,
        prediction.flow,
        linear_filter.estimate,
        covariance=linear_filter.covariance_of_posterior,
        innovation=innovation,
    )


def design(context: DesignContext, options: linear_filter.Options, name: str, past: int, reason: str) -> Design:
    """Return the assumptions, and the maps back in time; raise UserError for a model that is not invertible.

    `past` is the number of stored posteriors. `reason` is why there is no certificate on a schedule with out-of-sequence
    samples.
    """

    def params_of(model: linear.Model) -> RetrodictionParams:
        A = model.A
        if model.discrete and np.linalg.cond(A) > SINGULAR:
            raise UserError(
                f"{name} in {context.scenario}: got a discrete model whose A is singular, expected one that can be run "
                "backwards: it retrodicts; use kf or kf-cloning."
            )
        A_backward: linear.Matrix = np.asarray(np.linalg.inv(A) if model.discrete else -A, np.float64)
        reverse = model._replace(A=A_backward)
        with np.errstate(over="ignore", invalid="ignore"):
            return RetrodictionParams(linear.powers(reverse, context.dt, context.ticks), np.zeros(past))

    return linear_filter.design(
        context, options, name, extra=params_of, reason=reason if context.oosm_lag else "", restarts=False
    )
