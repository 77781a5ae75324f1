"""Filters that propagate their whole state tick by tick, shared by `ukf`, `ekf-iterated` and others.

    at the arrival of a sample taken at t_m:   state <- tick(state) until t_m,   state <- update(state, sample)

The propagation starts from the state after the preceding sample, and uses the inputs of those ticks. A copy is propagated to
the present in the same way; it is the present estimate. So a sample of any age is used at its sampling time. An
out-of-sequence sample is inserted, and newer ones are used again (`parts/reorder_buffer`). A state is a NamedTuple with its
sampling tick `tick`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

from pcbench.observers.parts import reorder_buffer
from pcbench.observers.parts.common import no_snapshot
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.nonlinear_model import Gains, initial_joint_state, now_at
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.protocols import Arrival, InnovationStats, Now, Observer, vmap_as_unit

State = Any


class Memory(NamedTuple):
    """The buffered samples with the state before them, the present state, and its mean."""

    buffer: Buffer
    now: State
    z: Float[Array, " N"]  # present states and unknowns


def prior(gains: Gains, xhat0: Float[Array, " n"]) -> Posterior:
    """Return the prior: xhat(0), the initial p, and P0."""
    return Posterior(initial_joint_state(gains, xhat0), gains.P0, jnp.asarray(0))


class FilterFunctions(NamedTuple):
    """The functions of a filter."""

    tick: Callable[[Gains, Now, State], State]  # -> the state one tick later, under now.u
    update: Callable[[Gains, Now, State, Measurement], State]  # -> the state after a sample of its tick
    innovation: Callable[[Gains, Now, State, Measurement], InnovationStats]  # -> innovation statistics of such a sample
    first: Callable[[Gains, Array], State] = prior  # (gains, xhat0[n]) -> the state at tick 0
    mean: Callable[[Gains, State], Array] = lambda gains, state: state.mean  # -> z[N]
    covariance: Callable[[Gains, State], Array] = lambda gains, state: state.P  # -> P[N, N]


def observer(functions: FilterFunctions) -> Observer:
    """Return the observer with these functions."""

    def propagate(gains: Gains, now: Now, state: State, until: Int[Array, ""]) -> State:
        end = lax.fori_loop(state.tick, until, lambda k, s: functions.tick(gains, now_at(now, k), s), state)
        return end._replace(tick=until)

    def update_at(gains: Gains, now: Now) -> reorder_buffer.Update:
        def update(before: State, sample: Measurement) -> State:
            prior = propagate(gains, now, before, sample.tick)
            return functions.update(gains, now_at(now, sample.tick), prior, sample)

        return update

    def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
        """Return the memory at the prior."""
        first = functions.first(gains, xhat0)
        return Memory(reorder_buffer.start(first, gains.room, gains.C.shape[0], 0), first, functions.mean(gains, first))

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        """Insert the arriving sample in order of sampling, and propagate the newest state to the present."""

        def apply(memory: Memory, arrival: Arrival) -> Memory:
            sample = reorder_buffer.zero_missing(reorder_buffer.sample_of(now, arrival, gains.D))
            buffer, newest = reorder_buffer.replay(update_at(gains, now), memory.buffer, sample)
            present = propagate(gains, now, newest, now.tick)
            return Memory(buffer, present, functions.mean(gains, present))

        return vmap_as_unit(apply)(memory, arrival)

    def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
        """Propagate the present state by one tick."""

        def advance(state: State) -> tuple[State, Array]:
            next_state = functions.tick(gains, now, state)
            return next_state, functions.mean(gains, next_state)

        next_state, z = vmap_as_unit(advance)(memory.now)
        return memory._replace(now=next_state._replace(tick=now.tick + 1), z=z)

    def estimate(gains: Gains, memory: Memory) -> Float[Array, " N"]:
        """Return the present xhat, and the unknowns."""
        return memory.z

    def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "N N"]:
        """Return the present covariance."""
        return vmap_as_unit(lambda state: functions.covariance(gains, state))(memory.now)

    def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
        """Return the innovation statistics of a sample; empty if it is older than the newest sample."""

        def score(memory: Memory, arrival: Arrival) -> InnovationStats:
            before = reorder_buffer.newest(update_at(gains, now), memory.buffer)
            sample = reorder_buffer.zero_missing(reorder_buffer.sample_of(now, arrival, gains.D))
            newest_sample = sample._replace(mask=sample.mask & (sample.tick >= before.tick))
            prior = propagate(gains, now, before, sample.tick)
            return functions.innovation(gains, now_at(now, sample.tick), prior, newest_sample)

        return vmap_as_unit(score)(memory, arrival)

    return Observer(init, no_snapshot, jump, flow, estimate, covariance=covariance, innovation=innovation)
