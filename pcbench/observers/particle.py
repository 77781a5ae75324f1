"""particle: the bootstrap particle filter.

    x_i <- f(x_i) + w_i,  w_i ~ N(0, Q) drawn, tick by tick;   at a sample  W_i <- W_i exp(-|y - h(x_i)|^2 / 2 by R)

and where 1 / sum W_i^2, the effective number of particles, falls below a share of them: systematic resampling, particle i taken
from where (i + U) / N falls in the sum of the weights, U one uniform number. The estimate is the weighted mean, P the weighted
covariance. Particles go on to now tick by tick, and a sample of any age is used at its own time (`parts/repropagation`): one
that comes after a newer one moves the same particles by the same draws again (`parts/rng`). What a sample was expected to
say is judged by the particles' mean and covariance. p is clipped to the plant's range after every tick.
Source: Gordon, Salmond, Smith 1993; systematic resampling: Kitagawa 1996.
Found: on a linear plant its difference from `kf` falls as 1/N in mean square. Where Q is 0 resampling leaves copies of few
particles that never part again, and P does not know.
Time index: the estimate is of now, after the jump. Not claimed: perfect start, which nothing that is drawn has.
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
from pcbench.observers.parts.nonlinear_model import Gains, at_points, clip_parameters, initial_augmented, nearest
from pcbench.observers.parts.options import normals, tunable, uniforms
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.repropagation import Memory
from pcbench.protocols import InnovationStats, Leaf, Now, Room, vmap_as_unit
from pcbench.runtime import memory as machine
from pcbench.synthesis.certificate import Design, DesignContext

START, PROCESS, RESAMPLING = 0, 1, 2  # kinds of draws; resampling has one for each channel
LANES = 64  # runs a call, always: sums over particles are rounded as the compiler vectorises over runs


class Swarm(NamedTuple):
    """What it has besides a filter; S particles."""

    room: Float[Room, " S"]
    start: Float[Leaf, "N N"]  # a root of P0
    process: Float[Leaf, "N N"]  # a root of Q
    share: Float[Leaf, ""]  # of effective particles, below which they are resampled


class Cloud(NamedTuple):
    """The particles at a tick."""

    x: Float[Array, "S N"]
    weight: Float[Array, " S"]  # logarithms; their exponentials sum to 1
    words: UInt32[Array, "2"]  # the run's, by which it draws
    taken: Int[Array, ""]


class Options(nonlinear_model.Options):
    """What it assumes, and how many particles it has."""

    particles: int = Field(300, ge=2, description="number of particles")
    resample: float = tunable(
        0.5, (0.0, 1.0), ge=0, le=1, description="fraction of effective particles below which it resamples"
    )


def draw_particles(gains: Gains, z: Float[Array, " N"], words: UInt32[Array, "2"]) -> Cloud:
    """Return the particles of a run at tick 0."""
    S, zero = gains.own.room.shape[0], jnp.asarray(0)
    x = z[None] + normals(words, START, zero, (S, z.shape[0])) @ gains.own.start.T
    x = jax.vmap(lambda each: clip_parameters(gains, each))(x)
    return Cloud(x, jnp.full(S, -jnp.log(float(S))), words, zero)


def first(gains: Gains, xhat0: Array) -> Cloud:
    """Return the particles of a run that has not said who it is."""
    return draw_particles(gains, initial_augmented(gains, xhat0), jnp.zeros(2, jnp.uint32))


def init_random(gains: Gains, memory: Memory, words: UInt32[Array, "2"], xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at the start of the run of these words."""

    def begun(words: Array, xhat0: Array) -> tuple[Cloud, Array]:
        now = draw_particles(gains, initial_augmented(gains, xhat0), words)
        return now, mean(gains, now)

    now, z = vmap_as_unit(begun)(words, xhat0)
    return Memory(memory.buffer._replace(before=now), now, z)


def tick(gains: Gains, now: Now, state: Cloud) -> Cloud:
    """Move every particle by a tick, and by a draw of process noise; one that overflows stays, with weight 0."""
    moved = jax.vmap(lambda z: gains.motion(now, z))(state.x)
    moved = moved + normals(state.words, PROCESS, now.tick, moved.shape) @ gains.own.process.T
    moved = jax.vmap(lambda z: clip_parameters(gains, z))(moved)
    finite = jnp.all(jnp.isfinite(moved), axis=1)
    left = jnp.where(finite, state.weight, -jnp.inf)
    weight = jnp.where(jnp.all(finite), left, left - jax.nn.logsumexp(left))
    return state._replace(x=jnp.where(finite[:, None], moved, state.x), weight=weight)


def predict_outputs(gains: Gains, now: Now, x: Float[Array, "S N"]) -> Float[Array, "S q"]:
    """Return what every particle would have measured."""
    n = gains.C.shape[1]
    if gains.sensor is None:
        return x[:, :n] @ gains.C.T
    return at_points(gains, now, x)


def update(gains: Gains, now: Now, state: Cloud, sample: Measurement) -> Cloud:
    """Weigh the particles by a sample of their tick, and resample where too few are left."""
    y = predict_outputs(gains, now, state.x)
    off = jnp.square(jax.vmap(lambda each: nearest(gains, sample.value, each) - each)(y))
    off = off / sample.variances(gains.R)[None]
    off = jnp.where(jnp.isnan(off), jnp.inf, off)  # such a particle has measured nothing: weight 0
    weight = state.weight - 0.5 * jnp.sum(jnp.where(sample.mask[None], off, 0.0), axis=1)
    weight = weight - jax.nn.logsumexp(weight)
    share, S = jnp.exp(weight), weight.shape[0]
    few = 1.0 / jnp.sum(share * share) < gains.own.share * S
    U = uniforms(state.words, RESAMPLING + jnp.argmax(sample.mask), sample.taken, ())
    from_ = jnp.searchsorted(jnp.cumsum(share), (jnp.arange(S) + U) / S)
    x = jnp.where(few, jnp.take(state.x, from_, axis=0, mode="clip"), state.x)
    return state._replace(x=x, weight=jnp.where(few, -jnp.log(float(S)), weight))


def weighted_moments(weight: Float[Array, " S"], points: Float[Array, "S k"]) -> tuple[Array, Array]:
    """Return mean and covariance of points."""
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
    """Return how far a sample is from what the particles' mean and covariance expect of it."""
    y = predict_outputs(gains, now, state.x)
    lost = jnp.any(~jnp.isfinite(y) & sample.mask[None], axis=1)  # as in `update`: weight 0
    left = jnp.where(lost, -jnp.inf, state.weight)
    weight = jnp.where(jnp.any(lost), left - jax.nn.logsumexp(left), state.weight)
    both = jnp.concatenate([state.x, jnp.where(jnp.isfinite(y), y, 0.0)], axis=1)
    return kalman.by_points(gains, *weighted_moments(weight, both), sample)[2]


OBSERVER = repropagation.observer(repropagation.Way(tick, update, innovation_of_cloud, first, mean, spread))._replace(
    init_random=init_random
)


def symmetric_root(M: np.ndarray) -> np.ndarray:
    """Return the symmetric root of a covariance, which may be singular."""
    values, V = np.linalg.eigh(M)
    return np.asarray((V * np.sqrt(np.maximum(values, 0.0))) @ V.T)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what it assumes; raise UserError where so many particles do not fit the memory."""
    N = len(setting.model.A) + len(setting.unknown_std)
    each = 8 * (N + 1) * (setting.overtaking + 3) * LANES
    if options.particles * each > machine.usable():
        raise UserError(
            f"particle in {setting.scenario}: got {options.particles} particles, which take "
            f"{options.particles * each / 1e9:.3g} GB of memory for {LANES} runs at once, expected at most "
            f"{machine.usable() // each}; write fewer."
        )

    def swarm(gains: Gains) -> Swarm:
        return Swarm(
            np.zeros(options.particles), symmetric_root(gains.P0), symmetric_root(gains.Q), np.asarray(options.resample)
        )

    return nonlinear_model.design(setting, options, "particle", swarm)
