"""From an estimate at a sample's time to an estimate of now, whatever the age of the sample.

Between samples a linear model moves as xhat(t) = g(t) + e^{A (t - t_m)} free_m, where g is the response to the input from
zero state at t = 0 (one integral, never reset) and free_m = xhat_m - g(t_m). So the integral of the input over any past
interval is I(a, b) = g(b) - e^{A (b - a)} g(a), exact for the held input, and no e^{-As} is ever formed. The observer notes
g(t_m) when sample m is taken; nothing else of the past is kept.
g follows the plant's own modes: over a horizon on which an unstable model grows past 1e16 the difference loses its digits.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pcbench.integrate import after
from pcbench.observers import in_order
from pcbench.observers.in_order import Line
from pcbench.synthesis import linear
from pcbench.synthesis.certificate import Setting
from pcbench.types import Leaf, Now


class Motion(NamedTuple):
    """A model's motion over a tick under a held input, and over any number of ticks without one."""

    Phi: Leaf  # [n, n]
    Gamma: Leaf  # [n, m]
    powers: Leaf  # [2, R, n, n] e^{A h i R^level}


class Point(NamedTuple):
    """An estimate at the time of a sample."""

    free: Array  # [n] xhat - g there
    taken: Array  # tick


class Memory(NamedTuple):
    """The estimate of now and what it came from: every observer of this family keeps these."""

    g: Array  # [n] input response from zero state
    xhat: Array  # [n] estimate of now
    line: Line  # the recursion's state at the newest samples used


def start(xhat0: Array, state: Any, places: Leaf, outputs: int) -> Memory:
    """Start from xhat(0), as if a sample had been used at tick 0."""
    return Memory(jnp.zeros_like(xhat0), xhat0, in_order.start(state, places, outputs, xhat0.shape[0]))


def origin(xhat0: Array) -> Point:
    """Return xhat(0) as an estimate at the time of a sample."""
    return Point(xhat0, jnp.asarray(0))


def flow(motion: Motion, memory: Memory, now: Now) -> Memory:
    """Advance by one tick under the held input."""
    pushed = motion.Gamma @ now.u
    return memory._replace(g=motion.Phi @ memory.g + pushed, xhat=motion.Phi @ memory.xhat + pushed)


def at(motion: Motion, point: Point, tick: Array) -> Array:
    """Return `free` carried on to a tick: the estimate there is g + this."""
    return after(motion.powers, tick - point.taken, point.free)


def resume(motion: Motion, memory: Memory, now: Now, line: Line, point: Point) -> Memory:
    """Take the estimate up again from a sample's time and carry it to now."""
    return Memory(memory.g, memory.g + at(motion, point, now.tick), line)


def motion_of(model: linear.Model, setting: Setting) -> Motion:
    """Return a model's motion in NumPy, for every age up to the horizon."""
    Phi, Gamma = linear.one_tick(model, setting.dt)
    return Motion(Phi, Gamma, linear.powers(model, setting.dt, setting.ticks))
