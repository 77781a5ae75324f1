"""Prediction of the present from an estimate at a sampling time, for any age of the sample.

Between samples the estimate of a linear model is xhat(t) = g(t) + e^{A (t - t_m)} free_m. g is the response to the input from
zero state at t = 0 (one integral, never reset), and free_m = xhat_m - g(t_m). The integral of the input over a past interval
is I(a, b) = g(b) - e^{A (b - a)} g(a), exact for a held input, without any e^{-As}. The snapshot of sample m is g(t_m);
nothing else of the past is stored.
g contains the modes of the plant. In a loop around an unstable plant, the state stays small while g grows until the
difference has no correct digits. For such a loop, g starts from zero at the oldest sample that may be used again
(`restarts`), and each arrival computes it from the stored inputs.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int, PyTree

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after
from pcbench.observers.parts import reorder_buffer
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.protocols import Arrival, Gains, Leaf, Now, Room
from pcbench.synthesis.certificate import DesignContext

Update = Callable[[Gains, PyTree, Measurement], PyTree]
LARGEST_GROWTH = 10.0  # growth of an unstable model over the horizon from which on g restarts in a loop


class Motion(NamedTuple):
    """Propagation of a model over a tick under a held input, and over several ticks without input."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    powers: Float[Leaf, "2 R n n"]  # e^{A h i R^level}
    restarts: tuple[()] | None = None  # (): g restarts, in a loop around an unstable plant; None: g starts at t = 0


class Point(NamedTuple):
    """An estimate at the time of a sample."""

    free: Float[Array, " n"]  # xhat - g at tick `tick`
    tick: Int[Array, ""]


class Memory(NamedTuple):
    """The present estimate, and the buffer that it is predicted from; shared by the observers of this family."""

    g: Float[Array, " n"]  # response to the input from zero state; 0 between arrivals if it restarts
    xhat: Float[Array, " n"]  # present estimate
    buffer: Buffer  # the recursion's state at the newest samples used
    tick: Int[Array, ""]  # present tick


def start(xhat0: Float[Array, " n"], state: PyTree, room: Room, outputs: int) -> Memory:
    """Return the memory at xhat(0), as if a sample had been used at tick 0."""
    buffer = reorder_buffer.start(state, room, outputs, xhat0.shape[0])
    return Memory(jnp.zeros_like(xhat0), xhat0, buffer, jnp.asarray(0))


def origin(xhat0: Float[Array, " n"]) -> Point:
    """Return xhat(0) as an estimate at tick 0."""
    return Point(xhat0, jnp.asarray(0))


def snapshot(gains: Gains, memory: PyTree, now: Now) -> Float[Array, " n"]:
    """Return g at the sampling time."""
    return memory.g


def flow(gains: Gains, memory: PyTree, now: Now) -> PyTree:
    """Advance a memory with g, xhat and tick by one tick under the held input, as pccebo's (12)."""
    motion: Motion = gains.motion
    increment = motion.Gamma @ now.u
    g = memory.g if motion.restarts is not None else motion.Phi @ memory.g + increment
    return memory._replace(g=g, xhat=motion.Phi @ memory.xhat + increment, tick=memory.tick + 1)


def flow_of_estimate(gains: Gains, memory: PyTree, now: Now) -> PyTree:
    """Advance xhat and tick of a memory by one tick."""
    motion: Motion = gains.motion
    return memory._replace(xhat=motion.Phi @ memory.xhat + motion.Gamma @ now.u, tick=memory.tick + 1)


def predict_to(motion: Motion, point: Point, tick: Int[Array, ""]) -> Float[Array, " n"]:
    """Return `free` propagated to a tick; the estimate there is g plus this."""
    return after(motion.powers, tick - point.tick, point.free)


def responses(motion: Motion, now: Now, since: Int[Array, ""], ticks: Int[Array, " k"]) -> Float[Array, "k n"]:
    """Return the response to the input from zero state at tick `since`, at each of `ticks`; 0 at ticks before `since`."""

    def tick(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        g = motion.Phi @ carry[0] + motion.Gamma @ now.past_u(now.tick - k)
        return g, jnp.where((ticks == k + 1)[:, None], g, carry[1])

    zeros = jnp.zeros((ticks.shape[0], motion.Phi.shape[0]))
    return lax.fori_loop(since, now.tick, tick, (zeros[0], zeros))[1]


def restart(
    motion: Motion, memory: Memory, now: Now, measurement: Measurement, since: Int[Array, ""]
) -> tuple[Memory, Measurement]:
    """Return memory and sample with g from zero at tick `since`, the oldest sample that may be used again, if g restarts."""
    if motion.restarts is None:
        return memory, measurement
    samples = memory.buffer.samples
    ticks = jnp.concatenate([measurement.tick[None], samples.tick, jnp.asarray(now.tick)[None]])
    g = responses(motion, now, since, ticks)
    buffer = memory.buffer._replace(samples=samples._replace(snapshot=g[1:-1]))
    return memory._replace(g=g[-1], buffer=buffer), measurement._replace(snapshot=g[0])


def shift_estimates(state: PyTree, by: Float[Array, " n"]) -> PyTree:
    """Return a state with `by` added to its estimates of one tick."""
    if hasattr(state, "point"):
        return state._replace(point=shift_estimates(state.point, by))
    estimates = {name: getattr(state, name) for name in ("free", "mean", "z") if hasattr(state, name)}
    columns = {name: value + by.reshape(-1, *[1] * (value.ndim - 1)) for name, value in estimates.items()}
    return state._replace(**columns)


def make_use(
    update: Update, point_of: Callable[[PyTree], Point]
) -> Callable[[Gains, Memory, Now, Measurement], Memory]:
    """Return a function that uses a sample, for an observer with the recursion `update` (gains, state, sample).

    It propagates the state to the sample, in the order of sampling, and the newest estimate to the present.
    """

    def use(gains: Gains, memory: Memory, now: Now, measurement: Measurement) -> Memory:
        since = point_of(memory.buffer.before).tick
        memory, measurement = restart(gains.motion, memory, now, measurement, since)
        buffer, newest = reorder_buffer.replay(partial(update, gains), memory.buffer, measurement)
        free = predict_to(gains.motion, point_of(newest), now.tick)  # e^{A d} free_m
        new_memory = memory._replace(xhat=memory.g + free, buffer=buffer)  # pccebo's (11)
        if gains.motion.restarts is None:
            return new_memory
        return remove_response(gains.motion, new_memory, memory.buffer.samples, measurement)

    def remove_response(motion: Motion, memory: Memory, samples: Measurement, measurement: Measurement) -> Memory:
        """Return the memory with g removed from the states before and after the samples; g starts again at the former."""
        before, after = memory.buffer.before, memory.buffer.after
        first_tick, ticks = point_of(before).tick, jnp.append(samples.tick, measurement.tick)
        is_same_tick = ticks == first_tick
        g = jnp.concatenate([samples.snapshot, measurement.snapshot[None]])[jnp.argmax(is_same_tick)]
        g = jnp.where(jnp.any(is_same_tick), g, 0.0)
        if after is not None:
            after = shift_estimates(after, predict_to(motion, Point(g, first_tick), point_of(after).tick))
        buffer = memory.buffer._replace(before=shift_estimates(before, g), after=after)
        return memory._replace(g=jnp.zeros_like(memory.g), buffer=buffer)

    return use


def make_jump(update: Update, point_of: Callable[[PyTree], Point]) -> Callable[[Gains, Memory, Now, Arrival], Memory]:
    """Return the jump of such an observer, which uses a sample at its sampling time."""
    use = make_use(update, point_of)

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        return use(gains, memory, now, reorder_buffer.sample_of(now, arrival, gains.D))

    return jump


def motion_of(model: linear.Model, context: DesignContext, restarts: bool = True) -> Motion:
    """Return a model's motion in NumPy, for every age up to the horizon; `restarts`: whether g may restart in a loop."""
    Phi, Gamma = linear.one_tick(model, context.dt)
    with np.errstate(over="ignore"):
        grows = linear.spectral_radius(Phi) ** context.ticks > LARGEST_GROWTH
    restart_g = () if restarts and context.in_loop and grows else None
    return Motion(Phi, Gamma, linear.powers(model, context.dt, context.ticks), restart_g)
