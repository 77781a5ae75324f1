"""Shared parts of `equal-delay` and `no-delay`, which compare a sample with their own estimate of an assumed age a ago.

With z = xhat - xbar (`sample_rate`), the innovation is e_j = r_j(k) - D_j u(k - a_j) - C_j xhat(k - a_j) if channel j has a
sample r_j at k, else 0:

    z(k) = transition z(k - stride) + filter_gain e(k),   z(k+1) = ... + predictor_gain e(k)

The recursion starts `stride` samples back. Before sample 0, xhat is xhat(0) and u is 0.
Time index: xhat is the estimate of the present, after the jump.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from pcbench.dynamics.linear import Matrix
from pcbench.observers.parts import sample_rate
from pcbench.observers.parts.common import known_input, no_snapshot
from pcbench.observers.parts.sample_rate import ModelRun, SampledModel, at_sample, ring, write
from pcbench.protocols import Arrival, Leaf, Now, Observer, Room
from pcbench.synthesis.certificate import DesignContext


class Gains(NamedTuple):
    """n states, q outputs."""

    model: SampledModel
    transition: Float[Leaf, "n n"]
    stride: Int[Leaf, ""]  # samples
    ages: Int[Leaf, " q"]  # [samples] assumed
    filter_gain: Float[Leaf, "n q"]  # of the estimate at the sample of the innovation
    predictor_gain: Float[Leaf, "n q"]  # of the estimate one sample later
    first_sample: Int[Leaf, ""]  # index of the first sample that is used
    room: Room  # for the past samples that are needed


class Memory(NamedTuple):
    """Memory between ticks."""

    run: ModelRun
    past_xbar: Float[Array, "ring n"]  # xbar at past samples
    past_z: Float[Array, "ring n"]  # z at past samples
    z: Float[Array, " n"]  # at the last sample
    correction: Float[Array, " n"]  # correction of the estimate at the next sample


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0)."""
    zeros = jnp.zeros_like(xhat0)
    return Memory(sample_rate.start(xhat0), ring(gains.room, xhat0), ring(gains.room, zeros), zeros, zeros)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Correct by the arriving channels, each with its assumed age."""
    ages, C, k = gains.ages, gains.model.C, memory.run.sample
    feedthrough = known_input(gains.model.D, now, ages * gains.model.period)
    expected = []
    for j in range(C.shape[0]):
        x_past = at_sample(memory.past_xbar, k - ages[j]) + at_sample(memory.past_z, k - ages[j])
        expected.append(C[j] @ jnp.where(ages[j] == 0, memory.run.xbar + memory.z, x_past) + feedthrough[j])
    is_used = arrival.mask & (k >= gains.first_sample)
    e = jnp.where(is_used, arrival.value - jnp.stack(expected), 0.0)
    return memory._replace(z=memory.z + gains.filter_gain @ e, correction=memory.correction + gains.predictor_gain @ e)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick; at a sampling tick, advance the recursion by one sample."""
    run, is_sample = sample_rate.flow(gains.model, memory.run, now)
    k = memory.run.sample
    past = write(memory.past_z, k, memory.z, is_sample)
    z = gains.transition @ at_sample(past, k + 1 - gains.stride) + memory.correction
    return Memory(
        run,
        write(memory.past_xbar, k + 1, run.xbar, is_sample),
        past,
        jnp.where(is_sample, z, memory.z),
        jnp.where(is_sample, 0.0, memory.correction),
    )


def estimate(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return the present xhat."""
    return memory.run.xbar + memory.run.transition @ memory.z


OBSERVER = Observer(init, no_snapshot, jump, flow, estimate)


def gains_of(
    context: DesignContext, transition: Matrix, K: Matrix, ages: tuple[int, ...], stride: int | None = None
) -> Gains:
    """Return the gains of xhat(k+1) = transition xhat(k) + B u(k) + K e(k).

    With `stride`: xhat(k) = transition xhat(k - stride) + response to the input + K e(k), from sample `stride` on.
    """
    zeros = np.zeros_like(K)
    return Gains(
        model=sample_rate.model_of(context),
        transition=transition,
        stride=np.asarray(stride or 1),
        ages=np.array(ages),
        filter_gain=K if stride else zeros,
        predictor_gain=zeros if stride else K,
        first_sample=np.asarray(stride or 0),
        room=np.zeros(max(context.reach, *ages, 1)),
    )
