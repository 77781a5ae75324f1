"""High-gain observer of a chain of n integrators at constant sampling periods: its limits and its decay.

    z' = A z + L g,    L = (C(n,1) theta, C(n,2) theta^2, ...),    y = x1

Between samples the innovation g has one of three forms:

    hold        g(t) = y_k - z1(t_k)
    predictor   g(t) = w - z1,  w' = z2,  w(t_k) = y_k      output predictor; g' = -n theta g, and g = e1 at a sample
    impulse     g = 0, and z+ = z + T L (y - z1) at a sample

Time is scaled by theta and the states by its powers, so that the result depends on theta T only. Without sampling, all n
eigenvalues are -theta. At constant S, `high-gain` is the predictor with n = 3; `high-gain-predictor` is the predictor.
Source: Karafyllis, Kravaris, IEEE TAC 54(9), 2009, for the output predictor; the limits are this project's, by the map over
one period.
"""

from math import comb
from typing import Literal

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.constant_periods import held_map, jump_map, largest_stable, predictor_map
from pcbench.synthesis.error_bounds import rate_of

Form = Literal["hold", "predictor", "impulse"]
UPPER = 8.0  # theta T up to which a limit is searched


def error_map(form: Form, n: int, interval: float) -> Matrix:
    """Return the map [n, n] of the scaled error over an interval theta T."""
    A, C = np.eye(n, k=1), np.eye(n)[:1]
    L = np.array([[comb(n, i + 1)] for i in range(n)], float)
    if form == "hold":
        return held_map(A, L, C, interval)
    if form == "impulse":
        return jump_map(A, interval * L, C, interval)
    return predictor_map(A, L, C, interval)


def radius(form: Form, n: int, interval: float) -> float:
    """Return the spectral radius of the error's map at a constant interval theta T; errors grow if it is above 1."""
    return spectral_radius(error_map(form, n, interval))


def limit(form: Form, n: int) -> float:
    """Return the largest constant theta T below which errors decay."""
    return largest_stable(lambda interval: radius(form, n, interval), UPPER)


def decay_rate(form: Form, n: int, interval: float) -> float:
    """Return the decay rate of the error at a constant interval theta T, in units of theta; 1 without sampling."""
    return rate_of(radius(form, n, interval), interval)


def certificate(theta: float, period: float) -> Certificate:
    """Return the linear limit of `high-gain` for a gain parameter [1/s] and a sampling period [s], without delay.

    The observer is nonlinear, so the numbers are not a certificate.
    """
    numbers = {
        "theta_Ts": theta * period,
        "linear_limit": limit("predictor", 3),
        "radius": radius("predictor", 3, theta * period),
    }
    reason = "none: the observer is nonlinear; the numbers are of its linear limit"
    return Certificate(reason, float("inf"), "none", "not needed", numbers)
