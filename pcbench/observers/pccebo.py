"""PCCEBO: the piecewise continuous, current-estimator-based observer.

    xbar_m = Phi xhat_(m-1) + I(t_(m-1), t_m),   xbar_0 = xhat(0)                            (8a), with the exact integral
    xhat_m = xbar_m + L (y_m - C xbar_m)                                                     (8b), when sample m arrives
    xhat(t_i) = e^{A d} xhat_m + I(t_m, t_i)                                                 (11), for any age d of the sample
    xhat(t) = e^{A (t - t_i)} xhat(t_i) + I(t_i, t)                                          (12)

As piecewise continuous systems: one integrates the input, the other is the estimate, re-initialised at each arrival.
Without noise and with a true model the error is e(t) = e^{A (t - t_m)} e_m, e_m = (I - L C) Phi e_(m-1), whatever u is.

A sample that comes after a newer one is put in its place (`in_order`); one that is lost lengthens the interval of (8a).

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017) 3738-3751, doi 10.3906/elk-1606-160.
Different from print: (7) and (8a) hold the input over a whole sampling period, here the integral is exact; (11) is
printed for d = te only. Time index: the estimate is of now, read after the jump. All channels share one clock.
Not claimed: that it filters noise (with the paper's L = [1, 0] it takes every measured position as it comes), nor that the
certificate, which is for the mean period, covers intervals that vary.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel, ConfigDict, Field

from pcbench.observers import free_response
from pcbench.observers.free_response import Memory, Motion, Point
from pcbench.observers.in_order import Sample
from pcbench.observers.options import matrix, tunable
from pcbench.synthesis import cache, current_estimator, linear, riccati
from pcbench.synthesis.certificate import Design, Setting, certified, one_clock
from pcbench.synthesis.observability import require_detectable
from pcbench.types import Leaf, Observer


class Gains(NamedTuple):
    """n states, m inputs, q outputs."""

    motion: Motion
    C: Leaf  # [q, n]
    D: Leaf  # [q, m]
    L: Leaf  # [n, q]
    places: Leaf  # [K] room for samples that may be overtaken


class Options(BaseModel):
    """How the gain is found."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    gain: Literal["lmi", "riccati"] = Field("lmi", description="LMI (23), or a stationary Kalman filter's gain")
    L: list[list[float]] | None = tunable(None, description="the gain itself [n, q], in place of one that is found")
    q: float = Field(0.002, gt=0, description="riccati: assumed intensity of process noise through the input")


def init(gains: Gains, xhat0: Array) -> Memory:
    """Start from xhat(0) [n]."""
    return free_response.start(xhat0, free_response.origin(xhat0), gains.places, gains.C.shape[0])


def correct(gains: Gains, before: Point, sample: Sample) -> Point:
    """Correct at the sample's own time, (8a) and (8b)."""
    free = free_response.at(gains.motion, before, sample.taken)
    xbar = sample.note + free
    innovation = jnp.where(sample.fresh, sample.value - gains.C @ xbar, 0.0)
    return Point(free + gains.L @ innovation, sample.taken)


def estimate(gains: Gains, memory: Memory) -> Array:
    """Return xhat of now, [n]."""
    return memory.xhat


jump = free_response.jumping(correct, lambda point: point)
OBSERVER = Observer(init, free_response.note, jump, free_response.flow, estimate)


def design(setting: Setting, options: Options) -> Design:
    """Find L at the (mean) sampling period and certify it by LMI (23); raise DesignError where it cannot be."""
    period = one_clock(setting, "pccebo")
    where = f"pccebo in {setting.scenario}"
    require_detectable(setting.model, where)
    moves = free_response.motion_of(setting.model, setting)
    doubled = linear.doublings(setting.model, setting.dt, linear.bits_for(period))
    Phi, C = linear.over(doubled, period), setting.model.C
    if options.L is not None:
        found = current_estimator.lyapunov(
            Phi, C, matrix(options.L, (len(Phi), len(C)), f"{where}: L", "states x outputs")
        )
    elif options.gain == "riccati":
        tick = linear.input_noise(setting.model, options.q, setting.dt) + setting.process_noise
        noise = linear.noise_doublings(setting.model, tick, setting.dt, len(doubled))
        Q, R = linear.noise_over(doubled, noise, period), np.diag(setting.noise_variance)
        found = current_estimator.lyapunov(Phi, C, riccati.current_gain(Phi, C, Q, R, where))
    else:
        found = cache.remembered(current_estimator.Solution, "lmi23", (Phi, C), lambda: current_estimator.solve(Phi, C))
        found = current_estimator.sharpen(found, Phi, C)
    certificate = certified(current_estimator.certify(found, Phi, C), where)
    gains = Gains(moves, C, setting.model.feedthrough, np.asarray(found.L), setting.places)
    return Design(gains, certificate)
