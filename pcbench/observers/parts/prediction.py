"""From an estimate at a sample's time to an estimate of now, whatever the age of the sample.

Between samples a linear model moves as xhat(t) = g(t) + e^{A (t - t_m)} free_m, where g is the response to the input from
zero state at t = 0 (one integral, never reset) and free_m = xhat_m - g(t_m). So the integral of the input over any past
interval is I(a, b) = g(b) - e^{A (b - a)} g(a), exact for the held input, and no e^{-As} is ever formed. The observer notes
g(t_m) when sample m is taken; nothing else of the past is kept.
g follows the plant's own modes. In a loop around an unstable plant the state stays small and g grows, until the difference has
no digits left. There g starts from zero at the oldest sample that may be used again (`restarts`): at each arrival it is
computed from the inputs that the loop stores.
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
LARGEST_GROWTH = 10.0  # of an unstable model over the horizon, up to which g starts at t = 0 in a loop


class Motion(NamedTuple):
    """A model's motion over a tick under a held input, and over any number of ticks without one."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    powers: Float[Leaf, "2 R n n"]  # e^{A h i R^level}
    restarts: tuple[()] | None = None  # (): in a loop around an unstable plant, where g does not start at t = 0


class Point(NamedTuple):
    """An estimate at the time of a sample."""

    free: Float[Array, " n"]  # xhat - g there
    taken: Int[Array, ""]  # tick


class Memory(NamedTuple):
    """The estimate of now and what it came from: every observer of this family keeps these."""

    g: Float[Array, " n"]  # input response from zero state; 0 if it restarts
    xhat: Float[Array, " n"]  # estimate of now
    buffer: Buffer  # the recursion's state at the newest samples used
    tick: Int[Array, ""]  # now


def start(xhat0: Float[Array, " n"], state: PyTree, room: Room, outputs: int) -> Memory:
    """Start from xhat(0), as if a sample had been used at tick 0."""
    buffer = reorder_buffer.start(state, room, outputs, xhat0.shape[0])
    return Memory(jnp.zeros_like(xhat0), xhat0, buffer, jnp.asarray(0))


def origin(xhat0: Float[Array, " n"]) -> Point:
    """Return xhat(0) as an estimate at the time of a sample."""
    return Point(xhat0, jnp.asarray(0))


def snapshot(gains: Gains, memory: PyTree, now: Now) -> Float[Array, " n"]:
    """Note the input response at the sample's time; of any memory that has g."""
    return memory.g


def flow(gains: Gains, memory: PyTree, now: Now) -> PyTree:
    """Advance by one tick under the held input, pccebo's (12); of any memory that has g, xhat and tick."""
    motion: Motion = gains.motion
    g = memory.g if motion.restarts is not None else motion.Phi @ memory.g + motion.Gamma @ now.u
    return flow_of_estimate(gains, memory._replace(g=g), now)


def flow_of_estimate(gains: Gains, memory: PyTree, now: Now) -> PyTree:
    """Advance the estimate alone by one tick; of any memory that has xhat and tick."""
    motion: Motion = gains.motion
    return memory._replace(xhat=motion.Phi @ memory.xhat + motion.Gamma @ now.u, tick=memory.tick + 1)


def at(motion: Motion, point: Point, tick: Int[Array, ""]) -> Float[Array, " n"]:
    """Return `free` carried on to a tick: the estimate there is g + this."""
    return after(motion.powers, tick - point.taken, point.free)


def responses(motion: Motion, now: Now, since: Int[Array, ""], ticks: Int[Array, " k"]) -> Float[Array, "k n"]:
    """Return the response to the input from zero state at tick `since`, at each of `ticks`; 0 at a tick before `since`."""

    def tick(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        g = motion.Phi @ carry[0] + motion.Gamma @ now.past_u(now.tick - k)
        return g, jnp.where((ticks == k + 1)[:, None], g, carry[1])

    none = jnp.zeros((ticks.shape[0], motion.Phi.shape[0]))
    return lax.fori_loop(since, now.tick, tick, (none[0], none))[1]


def restart(
    motion: Motion, memory: Memory, now: Now, arrived: Measurement, since: Int[Array, ""]
) -> tuple[Memory, Measurement]:
    """Return memory and sample with g from zero at tick `since`, the oldest sample that may be used again, if g restarts."""
    if motion.restarts is None:
        return memory, arrived
    before, kept = memory.buffer
    ticks = jnp.concatenate([arrived.taken[None], kept.taken, jnp.asarray(now.tick)[None]])
    g = responses(motion, now, since, ticks)
    buffer = Buffer(before, kept._replace(snapshot=g[1:-1]))
    return memory._replace(g=g[-1], buffer=buffer), arrived._replace(snapshot=g[0])


def moved(state: PyTree, by: Float[Array, " n"]) -> PyTree:
    """Return a recursion's state with its estimates of one tick moved by `by`."""
    if hasattr(state, "point"):
        return state._replace(point=moved(state.point, by))
    estimates = {name: getattr(state, name) for name in ("free", "mean", "z") if hasattr(state, name)}
    columns = {name: each + by.reshape(-1, *[1] * (each.ndim - 1)) for name, each in estimates.items()}
    return state._replace(**columns)


def using(update: Update, point_of: Callable[[PyTree], Point]) -> Callable[[Gains, Memory, Now, Measurement], Memory]:
    """Return what uses a sample, of an observer whose state at a sample's time follows `update` (gains, state, sample).

    It brings the state up to the sample, in the order in which samples were taken, and carries the estimate there to now.
    """

    def use(gains: Gains, memory: Memory, now: Now, arrived: Measurement) -> Memory:
        since = point_of(memory.buffer.before).taken
        memory, arrived = restart(gains.motion, memory, now, arrived, since)
        buffer, newest = reorder_buffer.replay(partial(update, gains), memory.buffer, arrived)
        there = at(gains.motion, point_of(newest), now.tick)  # e^{A d} of the estimate less g, as noted with the sample
        after = memory._replace(xhat=memory.g + there, buffer=buffer)  # pccebo's (11)
        return after if gains.motion.restarts is None else stop(after, memory.buffer.samples, arrived)

    def stop(memory: Memory, kept: Measurement, arrived: Measurement) -> Memory:
        """Keep the state before the samples without g, which starts again there."""
        before = memory.buffer.before
        ticks = jnp.append(kept.taken, arrived.taken)
        same = ticks == point_of(before).taken
        g = jnp.concatenate([kept.snapshot, arrived.snapshot[None]])[jnp.argmax(same)]
        before = moved(before, jnp.where(jnp.any(same), g, 0.0))
        return memory._replace(g=jnp.zeros_like(memory.g), buffer=memory.buffer._replace(before=before))

    return use


def jumping(update: Update, point_of: Callable[[PyTree], Point]) -> Callable[[Gains, Memory, Now, Arrival], Memory]:
    """Return the jump of such an observer, which uses what arrives as a sample of its own time."""
    use = using(update, point_of)

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        return use(gains, memory, now, reorder_buffer.sample_of(now, arrival, gains.D))

    return jump


def motion_of(model: linear.Model, setting: DesignContext, restarts: bool = True) -> Motion:
    """Return a model's motion in NumPy, for every age up to the horizon; `restarts`: whether g may start again."""
    Phi, Gamma = linear.one_tick(model, setting.dt)
    with np.errstate(over="ignore"):
        grows = np.max(np.abs(np.linalg.eigvals(Phi))) ** setting.ticks > LARGEST_GROWTH
    again = () if restarts and setting.in_loop and grows else None
    return Motion(Phi, Gamma, linear.powers(model, setting.dt, setting.ticks), again)
