"""PCCEBO: the piecewise continuous, current-estimator-based observer.

    xbar_m = Phi xhat_(m-1) + I(t_(m-1), t_m),   xbar_0 = xhat(0)                            (8a), with the exact integral
    xhat_m = xbar_m + L (y_m - C xbar_m)                                                     (8b), when sample m arrives
    xhat(t_i) = e^{A d} xhat_m + I(t_m, t_i)                                                 (11), for any age d of the sample
    xhat(t) = e^{A (t - t_i)} xhat(t_i) + I(t_i, t)                                          (12)

As piecewise continuous systems: one integrates the input, the other is the estimate, re-initialised at each arrival.
Without noise and with a true model the error is e(t) = e^{A (t - t_m)} e_m, e_m = (I - L C) Phi e_(m-1), whatever u is.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017) 3738-3751, doi 10.3906/elk-1606-160.
Different from print: (7) and (8a) hold the input over a whole sampling period, here the integral is exact; (11) is
printed for d = te only. Time index: the estimate is of now, read after the jump. Not claimed: that it filters noise;
with the paper's L = [1, 0] it takes every measured position as it comes.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel, ConfigDict

from pcbench.observers import free_response
from pcbench.observers.free_response import Motion, Resumable
from pcbench.synthesis import cache, current_estimator, linear
from pcbench.synthesis.certificate import Design, Setting, certified, one_clock
from pcbench.types import Arrival, Leaf, Now, Observer


class Gains(NamedTuple):
    """n states, q outputs."""

    motion: Motion
    C: Leaf  # [q, n]
    L: Leaf  # [n, q]


class Options(BaseModel):
    """PCCEBO has no options: its gain is the LMI's."""

    model_config = ConfigDict(extra="forbid")


def init(gains: Gains, xhat0: Array) -> Resumable:
    """Start from xhat(0) [n]."""
    return free_response.init(xhat0)


def note(gains: Gains, memory: Resumable, now: Now) -> Array:
    """Note the input response at the sample's time, [n]."""
    return memory.g


def jump(gains: Gains, memory: Resumable, now: Now, arrival: Arrival) -> Resumable:
    """Correct at the sample's own time (8b), then predict to now (11)."""
    free = free_response.at_sample(gains.motion, memory, now, arrival)
    xbar = arrival.note + free
    innovation = jnp.where(arrival.fresh, arrival.value - gains.C @ xbar, 0.0)
    return free_response.resume(gains.motion, memory, now, arrival, free + gains.L @ innovation)


def flow(gains: Gains, memory: Resumable, now: Now) -> Resumable:
    """Move by one tick under the held input (12)."""
    return free_response.flow(gains.motion, memory, now)


def estimate(gains: Gains, memory: Resumable) -> Array:
    """Return xhat of now, [n]."""
    return memory.xhat


OBSERVER = Observer(init, note, jump, flow, estimate)


def motion(setting: Setting) -> Motion:
    """Return the nominal model's motion in NumPy, for every age up to the horizon."""
    Phi, Gamma = linear.held(setting.model.A, setting.model.B, setting.dt)
    return Motion(Phi, Gamma, linear.doublings(setting.model.A, setting.dt, linear.bits_for(setting.ticks)))


def design(setting: Setting, options: Options) -> Design:
    """Find L by LMI (23) at the sampling period and certify it; raise DesignError where it cannot be."""
    period, _ = one_clock(setting, "pccebo")
    moves = motion(setting)
    Phi, C = linear.over(moves.doublings, period), setting.model.C
    found = cache.remembered(current_estimator.Solution, "lmi23", (Phi, C), lambda: current_estimator.solve(Phi, C))
    found = current_estimator.sharpen(found, Phi, C)
    certificate = certified(current_estimator.certify(found, Phi, C), f"pccebo in {setting.scenario}")
    return Design(Gains(moves, C, np.asarray(found.L)), certificate)
