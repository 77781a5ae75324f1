"""Kalman filter of a linear model at the sampling times, shared by `kf` and its variants for delayed samples.

    P-_m = E P_(m-1) E' + Q,   K = P- c (c'P- c + r)^-1,   P_m = (I - K c') P- (I - K c')' + K r K'

Means exclude g, the response to the input (`parts/prediction`). So they propagate without input, and a delayed sample needs
only g at its sampling time, which is its snapshot. R is the variance of one sample, and the prior is N(xhat(0), P0).
`bias_variance` adds a constant input bias to the state. An unknown input of the plant is added as a random walk.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PyTree
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after, covariance_after
from pcbench.dynamics.observability import require_detectable
from pcbench.observers.parts import assumed_noise, kalman, prediction, reorder_buffer, robust_update
from pcbench.observers.parts.common import for_each_channel
from pcbench.observers.parts.kalman import MeanAndCovariance, Posterior
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.robust_update import AnyPosterior
from pcbench.protocols import Arrival, InnovationStats, Leaf, Now, Observer, Room
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate, require_certified


class Gains(NamedTuple):
    """n states (the plant's and the added ones), m inputs, q outputs."""

    motion: Motion
    noise: Float[Leaf, "2 R n n"]  # process noise covariance over the ticks of each of motion.powers
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, " q"]  # variance of one sample
    decorrelation: Float[Leaf, "q q"] | None  # map to outputs with independent noise; None: identity
    P0: Float[Leaf, "n n"]
    room: Room  # for samples that may arrive after newer ones
    states: Float[Room, " plant"]  # number of the plant's states
    inputs: Float[Room, " r"]  # unknown inputs, the last states of the filter
    nonlinearity: Callable[[Array], Array] | None  # x[n] -> [r] the known part of f, or None
    extra: PyTree = ()  # parameters of one observer of the family
    guard: PyTree = ()  # robust_update.Guard, of a filter that rejects outliers or reduces their weight


class Options(assumed_noise.Options):
    """Assumptions of the filter, if they differ from the scenario's."""

    bias_variance: float | None = Field(
        None, gt=0, description="prior variance of a constant input bias that is estimated too; default: no bias"
    )
    input_walk: float = Field(
        1.0,
        ge=0,
        description="variance of the random walk of an unknown input, relative to unknown_std^2 [1/s]; 0: not estimated",
    )


def prior(gains: Gains, xhat0: Float[Array, " plant"]) -> Posterior:
    """Return the prior N(xhat(0), P0), with mean 0 for the added states."""
    mean = jnp.concatenate([xhat0, jnp.zeros(gains.P0.shape[0] - xhat0.shape[0])])
    return Posterior(mean, gains.P0, jnp.asarray(0))


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Return the memory at the prior."""
    first, q = prior(gains, xhat0), gains.C.shape[0]
    return prediction.start(first.mean, robust_update.initial_posterior(first, gains.guard, q), gains.room, q)


def decorrelated_value(gains: Gains, sample: Measurement) -> Float[Array, " q"]:
    """Return a sample's values of the outputs with independent noise [q]."""
    return sample.value if gains.decorrelation is None else gains.decorrelation @ sample.value


def predict_posterior(gains: Gains, before: AnyPosterior, tick: Array) -> Posterior:
    """Return mean and covariance propagated to a tick; a copy in the state stays constant."""
    n, age, powers = gains.P0.shape[0], tick - before.tick, gains.motion.powers
    free = prediction.predict_to(gains.motion, Point(before.mean[:n], before.tick), tick)
    P = covariance_after(powers, gains.noise, age, before.P[:n, :n])
    if before.mean.shape[0] == n:
        return Posterior(free, P, tick)
    cross_covariance = after(powers, age, before.P[:n, n:])
    P = jnp.block([[P, cross_covariance], [cross_covariance.T, before.P[n:, n:]]])
    return Posterior(jnp.concatenate([free, before.mean[n:]]), P, tick)


def update(gains: Gains, before: AnyPosterior, sample: Measurement) -> AnyPosterior:
    """Update at the sampling time, channel by channel; the mean excludes the response to the input."""
    free, P, _ = predict_posterior(gains, before, sample.tick)
    n, rows = gains.P0.shape[0], kalman.pad_columns(gains.C, free.shape[0])

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (free, P), (C_row, c, value, r, mask, count) = posterior, channel
        nu = value - C_row @ (sample.snapshot + free[:n])
        is_used, r, count = robust_update.weigh(gains.guard, count, nu, c @ P @ c + r, r, mask)
        K = kalman.gain(P @ c, c @ P @ c + r, is_used)
        return (free + K * nu, kalman.covariance(P, K, c, r)), count

    value, R = decorrelated_value(gains, sample), sample.variances(gains.R)
    channels = gains.C, rows, value, R, sample.mask, robust_update.rejections(before)
    (free, P), rejections = for_each_channel(use_channel, (free, P), channels)
    return robust_update.new_posterior(before, free, P, sample.tick, rejections)


def newest_innovation_stats(gains: Gains, before: AnyPosterior, sample: Measurement) -> InnovationStats:
    """Return the innovation statistics of a sample, relative to the newest state `before`; empty for an older sample."""
    prior = predict_posterior(gains, before, jnp.maximum(sample.tick, before.tick))
    return innovation_stats(gains, prior, sample._replace(mask=sample.mask & (sample.tick >= before.tick)))


def innovation_stats(gains: Gains, prior: AnyPosterior, sample: Measurement) -> InnovationStats:
    """Return the innovation statistics of a sample, relative to the state at its sampling time, channel by channel."""

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (free, P), (c, value, r, mask) = posterior, channel
        nu, s = value - c @ (sample.snapshot + free), c @ P @ c + r
        K = kalman.gain(P @ c, s, mask)
        return (free + K * nu, kalman.covariance(P, K, c, r)), (nu, s)

    channels = gains.C, decorrelated_value(gains, sample), sample.variances(gains.R), sample.mask
    _, (nu, s) = for_each_channel(use_channel, (prior.mean, prior.P), channels)
    return kalman.innovation_stats(nu, s, sample.mask)


def signals_of(gains: Gains, z: Float[Array, " n"]) -> Float[Array, " plant+r"]:
    """Return the estimated signals of the filter's states: the plant's states, and the unknown inputs."""
    n, r = gains.states.shape[0], gains.inputs.shape[0]
    xhat = z[:n]
    if not r:
        return xhat
    f = z[-r:]
    return jnp.append(xhat, f - gains.nonlinearity(xhat) if gains.nonlinearity else f)


def estimate(gains: Gains, memory: PyTree) -> Float[Array, " plant+r"]:
    """Return the present xhat, and the unknown inputs."""
    return signals_of(gains, memory.xhat)


def point(posterior: AnyPosterior) -> Point:
    """Return the mean of a posterior as a `Point`."""
    return Point(posterior.mean, posterior.tick)


use_sample = prediction.make_use(update, point)
jump = prediction.make_jump(update, point)


def signal_covariance(gains: Gains, memory: PyTree, P: Float[Array, "n n"]) -> Float[Array, "signals signals"]:
    """Return the covariance of the signals that `signals_of` returns, from the covariance P of the filter's states."""
    T = jax.jacfwd(lambda z: signals_of(gains, z))(memory.xhat)
    return T @ P @ T.T


def newest(gains: Gains, memory: Memory) -> AnyPosterior:
    """Return mean and covariance at the newest sample used."""
    return reorder_buffer.newest(lambda state, sample: update(gains, state, sample), memory.buffer)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the present covariance: that at the newest sample used, propagated."""
    before = memory.buffer.before
    empty_sample = Measurement(before.tick, jnp.zeros(len(gains.C)), jnp.zeros(len(gains.C), bool), memory.g)
    memory, _ = prediction.restart(gains.motion, memory, now, empty_sample, before.tick)
    return signal_covariance(gains, memory, predict_posterior(gains, newest(gains, memory), memory.tick).P)


def covariance_of_posterior(gains: Gains, memory: PyTree, now: Now) -> Float[Array, "signals signals"]:
    """Return the present covariance, propagated from `memory.posterior`."""
    return signal_covariance(gains, memory, predict_posterior(gains, memory.posterior, memory.tick).P)


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of a sample, predicted from all samples that arrived before, newer ones included.

    A sample older than all stored samples has empty statistics.
    """
    sample, before = reorder_buffer.sample_of(now, arrival, gains.D), memory.buffer.before
    memory, sample = prediction.restart(gains.motion, memory, now, sample, before.tick)
    buffer = memory.buffer
    if not buffer.samples.tick.shape[0]:
        return newest_innovation_stats(gains, buffer.before, sample)
    first, n = buffer.before, gains.P0.shape[0]

    def copy(state: AnyPosterior, sample: Measurement) -> AnyPosterior:
        prior = predict_posterior(gains, state, sample.tick)
        return state._replace(mean=jnp.tile(prior.mean[:n], 2), P=kalman.with_copy(prior.P, n), tick=sample.tick)

    sample = sample._replace(mask=sample.mask & (sample.tick >= first.tick))
    marker = sample._replace(tick=jnp.maximum(sample.tick, first.tick))
    joint_buffer = reorder_buffer.replace_states(
        buffer, lambda state: state._replace(mean=jnp.tile(state.mean, 2), P=kalman.with_copy(state.P, n))
    )
    state = reorder_buffer.newest_with_copy(partial(update, gains), copy, joint_buffer, marker)
    return innovation_stats(gains, Posterior(state.mean[n:], state.P[n:, n:], sample.tick), sample)


FILTER = Observer(
    init, prediction.snapshot, jump, prediction.flow, estimate, covariance=covariance, innovation=innovation
)


def design(
    context: DesignContext,
    options: Options,
    name: str,
    room: Room | None = None,
    extra: PyTree = (),
    reason: str = "",
    guard: PyTree = (),
    restarts: bool = True,
) -> Design:
    """Return the assumptions, certified by the covariance recursion over the horizon at the (mean) periods.

    `reason` is why that recursion is not a certificate of this observer. `restarts` is that of
    `prediction.motion_of`.
    """
    where = f"{name} in {context.scenario}"
    require_detectable(context.model, where)
    model, P0, n = context.model, context.P0, len(context.model.A)
    if options.bias_variance is not None:
        model, m = linear.with_input_bias(model), model.B.shape[1]
        P0 = np.block([[P0, np.zeros((n, m))], [np.zeros((m, n)), options.bias_variance * np.eye(m)]])
    q = assumed_noise.input_intensity(options.q, model.B.shape[1], context.input_intensity, where)
    inputs = np.zeros(0)
    if model.E is not None and options.input_walk:
        variances = np.square(context.unknown_std[: model.E.shape[1]])
        model, inputs = linear.with_unknown_input(model), variances
        zeros = np.zeros((len(P0), len(variances)))
        P0 = np.block([[P0, zeros], [zeros.T, np.diag(variances)]])
    decorrelation, C, R = assumed_noise.decorrelate_outputs(context, options.R, model.C, where)
    motion = prediction.motion_of(model, context, restarts)
    Q = linear.input_noise(model, q, context.dt, options.input_walk * inputs)
    Q[:n, :n] += assumed_noise.process_covariance(context, options.Q, where)
    noise = linear.noise_powers(model, Q, context.dt, context.ticks)
    gains = Gains(
        motion=motion,
        noise=noise,
        C=C,
        D=model.feedthrough,
        R=R,
        decorrelation=decorrelation,
        P0=P0,
        room=context.room if room is None else room,
        states=np.zeros(n),
        inputs=np.zeros(len(inputs) if len(inputs) == len(context.unknown_std) else 0),  # all unknown inputs, or none
        nonlinearity=context.model.nonlinearity if len(inputs) else None,
        extra=extra(model) if callable(extra) else extra,
        guard=guard,
    )
    predicts_input = True if len(inputs) else None
    Q_numbers = assumed_noise.covariance_option("Q", assumed_noise.process_covariance(context, options.Q, where))
    if reason:
        certificate = no_certificate(reason)._replace(numbers={"R": gains.R, "q": q, **Q_numbers})
        return Design(gains, certificate, predicts_input)
    certificate = kalman.certificate(gains, model, Q, context)
    certificate = certificate._replace(numbers={**certificate.numbers, "q": q, **Q_numbers})
    return Design(gains, require_certified(certificate, where), predicts_input)
