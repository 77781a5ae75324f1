"""The car's recording of `pcbench new recording`: its delay against the truth, and its likelihood as a function of the delay.

    speed' = u + bias, bias a random walk, y = speed at the time of sampling + noise of variance R
    one tick DT:   speed <- speed + DT (bias + u), bias <- bias + noise of variance Q

The delay is a number of ticks by which each sample is older than its timestamp. The filter is the textbook one, tick by tick.
"""

from typing import NamedTuple

import numba
import numpy as np
from scipy.optimize import minimize, minimize_scalar

DT, X0, P0 = 0.002, (8.0, 0.0), (1.0, 1.0)
HELD_OUT = 0.7  # of the last tick: where the held-out part begins
START = np.log([0.004, 2e-5])  # of R and Q
FINE = {"xatol": 1e-6, "fatol": 1e-9}


def least_squares_delay(t, y, t_true, true, order=0, most=0.4):
    """Return the delay [s] for which y(t) is closest to the truth at t - delay, but for a constant, and the rms of the rest.

    With order 1 these are the differences between successive measurements.
    """
    inside = (t - most > t_true[0]) & (t < t_true[-1])

    def rest(delay):
        return np.std(np.diff(y[inside] - np.interp(t[inside] - delay, t_true, true), order))

    found = minimize_scalar(rest, bounds=(0.0, most), method="bounded", options={"xatol": 1e-7})
    return found.x, found.fun


class Record(NamedTuple):
    """The recording at ticks."""

    u: np.ndarray  # [ticks] held
    stamped: np.ndarray  # [N] tick of each sample's timestamp
    value: np.ndarray  # [N]


def record(measurements, inputs, first, last, skipped=0):
    """Return frames (sampled, value; t, u1) at ticks, of which 0 is at `first` [s], without the first `skipped` samples."""

    def ticks(t):
        return np.rint((t.to_numpy() - first) / DT).astype(int)

    last = int(np.rint((last - first) / DT))
    u = np.zeros(last + 1)
    for k, value in zip(ticks(inputs.t), inputs.u1, strict=True):
        u[k:] = value
    return Record(u, ticks(measurements.sampled)[skipped:], measurements.value.to_numpy()[skipped:])


@numba.njit
def innovations(R, Q, u, y):
    """Return innovations and their variances, NaN at ticks without a sample; y [ticks] NaN: none."""
    nu, s = np.full(len(y), np.nan), np.full(len(y), np.nan)
    (speed, bias), (p, d), c = X0, P0, 0.0  # P = [[p, c], [c, d]]
    for k in range(len(y)):
        if not np.isnan(y[k]):
            nu[k], s[k] = y[k] - speed, p + R
            g, h = p / s[k], c / s[k]
            speed, bias = speed + g * nu[k], bias + h * nu[k]
            p, c, d = p - g * p, c - g * c, d - h * c
        speed += DT * (bias + u[k])
        p, c, d = p + 2 * DT * c + DT * DT * d, c + DT * d, d + Q
    return nu, s


def log_likelihoods(R, Q, r, delay):
    """Return the log-likelihood of each sample in the order of arrival, if it is `delay` ticks older than its timestamp."""
    y, taken = np.full(len(r.u), np.nan), r.stamped - delay
    y[taken] = r.value
    nu, s = innovations(R, Q, r.u, y)
    return -0.5 * (np.log(2 * np.pi * s[taken]) + nu[taken] ** 2 / s[taken])


class Peak(NamedTuple):
    """The largest likelihood at one delay."""

    total: float  # log-likelihood of all samples, at its largest over R and Q
    held_out: float  # its mean over the held-out part, with R and Q of the other part
    R: float
    Q: float


def peak(r, delay):
    """Return the largest likelihood of a recording at a delay [ticks]."""
    early = r.stamped < int(HELD_OUT * (len(r.u) - 1))

    def best(some):
        def cost(z):
            return -log_likelihoods(*np.exp(z), r, delay)[some].sum()

        return np.exp(minimize(cost, START, method="Nelder-Mead", options=FINE).x)

    R, Q = best(np.ones_like(early))
    first = log_likelihoods(*best(early), r, delay)
    return Peak(log_likelihoods(R, Q, r, delay).sum(), first[~early].mean(), R, Q)
