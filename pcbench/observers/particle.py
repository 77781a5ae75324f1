"""particle: bootstrap particle filter with systematic resampling.

    x_i <- f(x_i) + w_i,  w_i ~ N(0, Q) drawn, tick by tick;   at a sample  W_i <- W_i exp(-|y - h(x_i)|^2_(R^-1) / 2)

If the effective number of particles, 1 / sum W_i^2, falls below a fraction of all, they are resampled: particle i becomes a
copy of the one at (i + U) / N in the cumulative sum of the weights, with one uniform number U. The estimate is the weighted
mean, and P the weighted covariance.
Particles are propagated to the present tick by tick, and a sample of any age is used at its sampling time
(`parts/repropagation`). If a sample is out of sequence, the same particles are propagated again with the same random numbers
(`parts/options`). The innovation statistics use mean and covariance of the particles. p is clipped to the plant's range after
every tick.
Source: Gordon, Salmond, Smith 1993; systematic resampling: Kitagawa 1996.
On a linear plant the mean square of the difference from `kf` decreases as 1/N. If Q is 0, resampling leaves copies of a few
particles, which stay equal. P is then too small.
Time index: xhat is the estimate of the present, after the jump. Not claimed: perfect start, because the particles are random.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, UInt32
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import kalman, nonlinear_model, repropagation
from pcbench.observers.parts.nonlinear_model import (
    Gains,
    clip_parameters,
    initial_joint_state,
    outputs_at_points,
    value_near,
)
from pcbench.observers.parts.options import normals, tunable, uniforms
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.repropagation import Memory
from pcbench.protocols import InnovationStats, Leaf, Now, Room, vmap_as_unit
from pcbench.runtime import memory as machine
from pcbench.synthesis.certificate import Design, DesignContext

START, PROCESS, RESAMPLING = 0, 1, 2  # kinds of draws; resampling has one for each channel
LANES = 64  # fixed number of runs per call, because it affects the rounding of sums over particles


class Swarm(NamedTuple):
    """Parameters in addition to those of the filter; S particles."""

    particles: Float[Room, " S"]
    P0_root: Float[Leaf, "N N"]
    Q_root: Float[Leaf, "N N"]
    resampling_threshold: Float[Leaf, ""]  # fraction of effective particles below which they are resampled


class Cloud(NamedTuple):
    """The particles at a tick."""

    x: Float[Array, "S N"]
    weight: Float[Array, " S"]  # logarithms; their exponentials sum to 1
    words: UInt32[Array, "2"]  # random words of the run, from which it draws
    tick: Int[Array, ""]


class Options(nonlinear_model.Options):
    """Assumptions, number of particles, and threshold of resampling."""

    particles: int = Field(300, ge=2, description="number of particles")
    resample: float = tunable(
        0.5, (0.0, 1.0), ge=0, le=1, description="fraction of effective particles below which it resamples"
    )


def draw_particles(gains: Gains, z: Float[Array, " N"], words: UInt32[Array, "2"]) -> Cloud:
    """Return the particles of a run at tick 0."""
    S, zero = gains.extra.particles.shape[0], jnp.asarray(0)
    x = z[None] + normals(words, START, zero, (S, z.shape[0])) @ gains.extra.P0_root.T
    x = jax.vmap(lambda z_i: clip_parameters(gains, z_i))(x)
    return Cloud(x, jnp.full(S, -jnp.log(float(S))), words, zero)


def first(gains: Gains, xhat0: Array) -> Cloud:
    """Return the particles of a run before `init_random` sets its words."""
    return draw_particles(gains, initial_joint_state(gains, xhat0), jnp.zeros(2, jnp.uint32))


def init_random(gains: Gains, memory: Memory, words: UInt32[Array, "2"], xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at the start of a run, with particles drawn from the run's words."""

    def draw(words: Array, xhat0: Array) -> tuple[Cloud, Array]:
        cloud = draw_particles(gains, initial_joint_state(gains, xhat0), words)
        return cloud, mean(gains, cloud)

    cloud, z = vmap_as_unit(draw)(words, xhat0)
    return Memory(memory.buffer._replace(before=cloud), cloud, z)


def tick(gains: Gains, now: Now, state: Cloud) -> Cloud:
    """Propagate every particle by one tick with process noise; a particle that overflows stays, with weight 0."""
    x = jax.vmap(lambda z: gains.motion(now, z))(state.x)
    x = x + normals(state.words, PROCESS, now.tick, x.shape) @ gains.extra.Q_root.T
    x = jax.vmap(lambda z: clip_parameters(gains, z))(x)
    finite = jnp.all(jnp.isfinite(x), axis=1)
    log_weight = jnp.where(finite, state.weight, -jnp.inf)
    weight = jnp.where(jnp.all(finite), log_weight, log_weight - jax.nn.logsumexp(log_weight))
    return state._replace(x=jnp.where(finite[:, None], x, state.x), weight=weight)


def predict_outputs(gains: Gains, now: Now, x: Float[Array, "S N"]) -> Float[Array, "S q"]:
    """Return the output of every particle."""
    n = gains.C.shape[1]
    if gains.sensor is None:
        return x[:, :n] @ gains.C.T
    return outputs_at_points(gains, now, x)


def update(gains: Gains, now: Now, state: Cloud, sample: Measurement) -> Cloud:
    """Weight the particles by a sample of their tick, and resample if too few are effective."""
    y = predict_outputs(gains, now, state.x)
    square = jnp.square(jax.vmap(lambda y_i: value_near(gains, sample.value, y_i) - y_i)(y))
    square = square / sample.variances(gains.R)[None]
    square = jnp.where(jnp.isnan(square), jnp.inf, square)  # a particle without a finite output has weight 0
    weight = state.weight - 0.5 * jnp.sum(jnp.where(sample.mask[None], square, 0.0), axis=1)
    weight = weight - jax.nn.logsumexp(weight)
    probability, S = jnp.exp(weight), weight.shape[0]
    is_degenerate = 1.0 / jnp.sum(probability * probability) < gains.extra.resampling_threshold * S
    U = uniforms(state.words, RESAMPLING + jnp.argmax(sample.mask), sample.tick, ())
    parents = jnp.searchsorted(jnp.cumsum(probability), (jnp.arange(S) + U) / S)
    x = jnp.where(is_degenerate, jnp.take(state.x, parents, axis=0, mode="clip"), state.x)
    return state._replace(x=x, weight=jnp.where(is_degenerate, -jnp.log(float(S)), weight))


def weighted_moments(weight: Float[Array, " S"], points: Float[Array, "S k"]) -> tuple[Array, Array]:
    """Return mean and covariance of points, by logarithms of weights."""
    m = jnp.sum(jnp.exp(weight)[:, None] * points, axis=0)
    d = points - m[None]
    return m, (jnp.exp(weight)[:, None] * d).T @ d


def mean(gains: Gains, state: Cloud) -> Float[Array, " N"]:
    """Return the weighted mean."""
    return weighted_moments(state.weight, state.x)[0]


def spread(gains: Gains, state: Cloud) -> Float[Array, "N N"]:
    """Return the weighted covariance."""
    return weighted_moments(state.weight, state.x)[1]


def innovation_of_cloud(gains: Gains, now: Now, state: Cloud, sample: Measurement) -> InnovationStats:
    """Return the innovation statistics of a sample, by mean and covariance of the particles."""
    y = predict_outputs(gains, now, state.x)
    invalid = jnp.any(~jnp.isfinite(y) & sample.mask[None], axis=1)  # as in `update`: weight 0
    log_weight = jnp.where(invalid, -jnp.inf, state.weight)
    weight = jnp.where(jnp.any(invalid), log_weight - jax.nn.logsumexp(log_weight), state.weight)
    joint = jnp.concatenate([state.x, jnp.where(jnp.isfinite(y), y, 0.0)], axis=1)
    return kalman.update_by_moments(gains, *weighted_moments(weight, joint), sample)[2]


OBSERVER = repropagation.observer(
    repropagation.FilterFunctions(tick, update, innovation_of_cloud, first, mean, spread)
)._replace(init_random=init_random)


def symmetric_root(M: np.ndarray) -> np.ndarray:
    """Return the symmetric root of a covariance, which may be singular."""
    values, V = np.linalg.eigh(M)
    return np.asarray((V * np.sqrt(np.maximum(values, 0.0))) @ V.T)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; raise UserError if the particles do not fit into memory."""
    N = len(context.model.A) + len(context.unknown_std)
    particle_size = 8 * (N + 1) * (context.oosm_lag + 3) * LANES
    if options.particles * particle_size > machine.usable():
        raise UserError(
            f"particle in {context.scenario}: got {options.particles} particles, which take "
            f"{options.particles * particle_size / 1e9:.3g} GB of memory for {LANES} runs at once, expected at most "
            f"{machine.usable() // particle_size}; write fewer."
        )

    def swarm(gains: Gains) -> Swarm:
        return Swarm(
            np.zeros(options.particles), symmetric_root(gains.P0), symmetric_root(gains.Q), np.asarray(options.resample)
        )

    return nonlinear_model.design(context, options, "particle", swarm)
