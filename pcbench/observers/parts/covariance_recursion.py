"""The certificate of a Kalman filter: its covariance recursion over the horizon, at the (mean) periods."""

from typing import Any

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import Certificate, DesignContext


def certificate(gains: Any, model: linear.Model, Q: Matrix, setting: DesignContext) -> Certificate:
    """Return it; its margin is the least innovation variance over the horizon, relative to R, where P stays >= 0."""
    bits = linear.bits_for(setting.ticks)
    doubled = linear.doublings(model, setting.dt, bits)
    noise = linear.noise_doublings(model, Q, setting.dt, bits)
    run = riccati.multirate(doubled, noise, gains.C, gains.R, gains.P0, setting.period, setting.ticks)
    numbers = {"P_end": run.P, "K_end": run.K, "R": gains.R, "innovation_over_R": run.innovation}
    margin = run.innovation if run.least > -1e-9 else float("nan")
    return Certificate("c P c' + r > 0 and P >= 0 at every sample", margin, "recursion", "run", numbers)
