"""Filters whose whole state goes tick by tick, from a sample's own time to now: what `ukf`, `ekf-iterated` and others share.

    at the arrival of a sample taken at t_m:   state <- tick(state) until t_m,   state <- update(state, sample)

from the state after the sample before it, under the inputs of those ticks; a copy goes on to now in the same way, and is what
is estimated of now. So a sample of any age is used at its own time. One that comes after a newer one is put in its place, and
the newer ones are used again (`parts/reorder_buffer`). A state is a NamedTuple with `taken`, the tick that it is of.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

from pcbench.observers.parts import reorder_buffer
from pcbench.observers.parts.common import no_snapshot
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.nonlinear_model import Gains, at, initial_augmented
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.protocols import Arrival, InnovationStats, Now, Observer, vmap_as_unit

State = Any


class Memory(NamedTuple):
    """The samples that may be overtaken with the state before them, and the state of now with what it says."""

    buffer: Buffer
    now: State
    z: Float[Array, " N"]  # the states and unknowns of now


def prior(gains: Gains, xhat0: Float[Array, " n"]) -> Posterior:
    """Return the prior: xhat(0), p at its start, P0."""
    return Posterior(initial_augmented(gains, xhat0), gains.P0, jnp.asarray(0))


class Way(NamedTuple):
    """How a filter's state begins, moves and is corrected, and what it says."""

    tick: Callable[[Gains, Now, State], State]  # one tick on, under now.u
    update: Callable[[Gains, Now, State, Measurement], State]  # by a sample of its own tick
    expected: Callable[[Gains, Now, State, Measurement], InnovationStats]  # of such a sample, before it is used
    first: Callable[[Gains, Array], State] = prior  # (gains, xhat0[n]) -> the state at tick 0
    mean: Callable[[Gains, State], Array] = lambda gains, state: state.mean  # -> z[N]
    spread: Callable[[Gains, State], Array] = lambda gains, state: state.P  # -> P[N, N]


def observer(way: Way) -> Observer:
    """Return the observer that keeps to a way."""

    def carried(gains: Gains, now: Now, state: State, until: Int[Array, ""]) -> State:
        moved = lax.fori_loop(state.taken, until, lambda k, s: way.tick(gains, at(now, k), s), state)
        return moved._replace(taken=until)

    def use(gains: Gains, now: Now) -> reorder_buffer.Update:
        def update(before: State, sample: Measurement) -> State:
            ready = carried(gains, now, before, sample.taken)
            return way.update(gains, at(now, sample.taken), ready, sample)

        return update

    def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
        """Start from the prior: xhat(0), p at its start, P0."""
        first = way.first(gains, xhat0)
        return Memory(reorder_buffer.start(first, gains.room, gains.C.shape[0], 0), first, way.mean(gains, first))

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        """Put what arrived in its place, and go on to now."""

        def moved(memory: Memory, arrival: Arrival) -> Memory:
            sample = reorder_buffer.kept_of(reorder_buffer.sample_of(now, arrival, gains.D))
            buffer, newest = reorder_buffer.replay(use(gains, now), memory.buffer, sample)
            here = carried(gains, now, newest, now.tick)
            return Memory(buffer, here, way.mean(gains, here))

        return vmap_as_unit(moved)(memory, arrival)

    def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
        """Move by one tick."""

        def moved(state: State) -> tuple[State, Array]:
            here = way.tick(gains, now, state)
            return here, way.mean(gains, here)

        here, z = vmap_as_unit(moved)(memory.now)
        return memory._replace(now=here._replace(taken=now.tick + 1), z=z)

    def estimate(gains: Gains, memory: Memory) -> Float[Array, " N"]:
        """Return xhat of now, and the unknowns."""
        return memory.z

    def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "N N"]:
        """Return what the filter believes of its error now."""
        return vmap_as_unit(lambda state: way.spread(gains, state))(memory.now)

    def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
        """Return how far what arrives is from what was expected of it; what is older than the newest is not judged."""

        def judged(memory: Memory, arrival: Arrival) -> InnovationStats:
            before = reorder_buffer.newest(use(gains, now), memory.buffer)
            sample = reorder_buffer.kept_of(reorder_buffer.sample_of(now, arrival, gains.D))
            looked = sample._replace(mask=sample.mask & (sample.taken >= before.taken))
            return way.expected(gains, at(now, sample.taken), carried(gains, now, before, sample.taken), looked)

        return vmap_as_unit(judged)(memory, arrival)

    return Observer(init, no_snapshot, jump, flow, estimate, covariance=covariance, innovation=innovation)
