"""From an estimate at a sample's time to an estimate of now, whatever the age of the sample.

Between samples a linear model moves as xhat(t) = g(t) + e^{A (t - t_m)} free_m, where g is the response to the input from
zero state at t = 0 (one integral, never reset) and free_m = xhat_m - g(t_m). So the integral of the input over any past
interval is I(a, b) = g(b) - e^{A (b - a)} g(a), exact for the held input, and no e^{-As} is ever formed. The observer notes
g(t_m) when sample m is taken; nothing else of the past is kept.
g follows the plant's own modes: over a horizon on which an unstable model grows past 1e16 the difference loses its digits.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pcbench.integrate import after
from pcbench.types import Arrival, Leaf, Now


class Motion(NamedTuple):
    """A model's motion over a tick under a held input, and over any number of ticks without one."""

    Phi: Leaf  # [n, n]
    Gamma: Leaf  # [n, m]
    doublings: Leaf  # [bits, n, n] e^{A h 2^b}


class Resumable(NamedTuple):
    """An estimate that can be taken up again at a sample's time."""

    g: Array  # [n] input response from zero state
    xhat: Array  # [n] estimate of now
    free: Array  # [n] xhat - g at the newest sample used
    taken: Array  # tick at which that sample was taken


def init(xhat0: Array) -> Resumable:
    """Start from xhat(0), as if a sample had been used at tick 0."""
    return Resumable(jnp.zeros_like(xhat0), xhat0, xhat0, jnp.asarray(0))


def flow(motion: Motion, past: Resumable, now: Now) -> Resumable:
    """Advance by one tick under the held input."""
    pushed = motion.Gamma @ now.u
    return past._replace(g=motion.Phi @ past.g + pushed, xhat=motion.Phi @ past.xhat + pushed)


def gap(past: Resumable, now: Now, arrival: Arrival) -> Array:
    """Return the ticks between the newest sample used and the one that arrives."""
    return now.tick - arrival.age[0] - past.taken


def at_sample(motion: Motion, past: Resumable, now: Now, arrival: Arrival) -> Array:
    """Return `free` carried to the arriving sample's time: the estimate there, before its update, is note + free."""
    return after(motion.doublings, gap(past, now, arrival), past.free)


def resume(motion: Motion, past: Resumable, now: Now, arrival: Arrival, free: Array) -> Resumable:
    """Take the estimate up again from note + free at the sample's time, and carry it to now."""
    age = arrival.age[0]
    return Resumable(past.g, past.g + after(motion.doublings, age, free), free, now.tick - age)
