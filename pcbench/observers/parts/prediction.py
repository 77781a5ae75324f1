"""From an estimate at a sample's time to an estimate of now, whatever the age of the sample.

Between samples a linear model moves as xhat(t) = g(t) + e^{A (t - t_m)} free_m, where g is the response to the input from
zero state at t = 0 (one integral, never reset) and free_m = xhat_m - g(t_m). So the integral of the input over any past
interval is I(a, b) = g(b) - e^{A (b - a)} g(a), exact for the held input, and no e^{-As} is ever formed. The observer notes
g(t_m) when sample m is taken; nothing else of the past is kept.
g follows the plant's own modes: where an unstable model grows past 1e16 over the horizon, the difference loses all its digits.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int, PyTree

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after
from pcbench.observers.parts import reorder_buffer
from pcbench.observers.parts.reorder_buffer import Buffer, Measurement
from pcbench.protocols import Arrival, Gains, Leaf, Now, Room
from pcbench.synthesis.certificate import DesignContext

Update = Callable[[Gains, PyTree, Measurement], PyTree]


class Motion(NamedTuple):
    """A model's motion over a tick under a held input, and over any number of ticks without one."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    powers: Float[Leaf, "2 R n n"]  # e^{A h i R^level}


class Point(NamedTuple):
    """An estimate at the time of a sample."""

    free: Float[Array, " n"]  # xhat - g there
    taken: Int[Array, ""]  # tick


class Memory(NamedTuple):
    """The estimate of now and what it came from: every observer of this family keeps these."""

    g: Float[Array, " n"]  # input response from zero state
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
    pushed = motion.Gamma @ now.u
    g, xhat = motion.Phi @ memory.g + pushed, motion.Phi @ memory.xhat + pushed
    return memory._replace(g=g, xhat=xhat, tick=memory.tick + 1)


def at(motion: Motion, point: Point, tick: Int[Array, ""]) -> Float[Array, " n"]:
    """Return `free` carried on to a tick: the estimate there is g + this."""
    return after(motion.powers, tick - point.taken, point.free)


def using(update: Update, point_of: Callable[[PyTree], Point]) -> Callable[[Gains, Memory, Now, Measurement], Memory]:
    """Return what uses a sample, of an observer whose state at a sample's time follows `update` (gains, state, sample).

    It brings the state up to the sample, in the order in which samples were taken, and carries the estimate there to now.
    """

    def use(gains: Gains, memory: Memory, now: Now, arrived: Measurement) -> Memory:
        buffer, newest = reorder_buffer.replay(partial(update, gains), memory.buffer, arrived)
        there = at(gains.motion, point_of(newest), now.tick)  # e^{A d} of the estimate less g, as noted with the sample
        return memory._replace(xhat=memory.g + there, buffer=buffer)  # pccebo's (11)

    return use


def jumping(update: Update, point_of: Callable[[PyTree], Point]) -> Callable[[Gains, Memory, Now, Arrival], Memory]:
    """Return the jump of such an observer, which uses what arrives as a sample of its own time."""
    use = using(update, point_of)

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        return use(gains, memory, now, reorder_buffer.sample_of(now, arrival, gains.D))

    return jump


def motion_of(model: linear.Model, setting: DesignContext) -> Motion:
    """Return a model's motion in NumPy, for every age up to the horizon."""
    Phi, Gamma = linear.one_tick(model, setting.dt)
    return Motion(Phi, Gamma, linear.powers(model, setting.dt, setting.ticks))
