"""The recording of `pcbench new recording leg`: the lag of the magnetometer behind the gyroscope, in two ways without a filter.

A constant field m in the frame of a sensor that turns at w has m' = -w x m. Both ways are least squares over the lag:

    in the plane   the angle of the field changes between two rows by the integral of its rate, a lag earlier
    in space       m'(t) = -(M w(t - lag) + b) x (m(t) - c), with unknown M, b and c

The rates are instants here. A model that holds each row until the next uses them half a row later.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

RATE = 120.0  # rows per second
MARGIN = 1.0  # s, left out at both ends
LAGS = np.arange(-0.03, 0.0301, 0.002)


def angle(m):
    """Return the angle of the field [rad], positive about -z, without jumps."""
    return -np.unwrap(np.arctan2(m[:, 1], m[:, 0]))


def rate(w, m):
    """Return the rate of that angle [rad/s]."""
    return w[:, 2] - m[:, 2] * (w[:, 0] * m[:, 0] + w[:, 1] * m[:, 1]) / (m[:, 0] ** 2 + m[:, 1] ** 2)


def _least(rest):
    """Return the lag at the vertex of the parabola through the five sums next to the smallest."""
    sums = np.array([rest(lag) for lag in LAGS])
    best = int(sums.argmin())
    near = slice(best - 2, best + 3)
    a, b, _ = np.polyfit(LAGS[near], sums[near], 2)
    return -b / (2 * a)


def lag_in_plane(t, u, y, step):
    """Return the lag [s] of the angle y behind its rate u, for changes over `step` rows."""
    begin = np.arange(t[0] + MARGIN, t[-1] - MARGIN, 1 / RATE)
    end = begin + step / RATE
    turned, angles = CubicSpline(t, u).antiderivative(), CubicSpline(t, y)
    changes = angles(end) - angles(begin)
    return _least(lambda lag: np.var(changes - turned(end - lag) + turned(begin - lag)))


def lag_in_space(t, w, m, cutoff):
    """Return the lag [s] and the share of the power of m' that is left, of motions slower than `cutoff` [Hz]."""
    smooth = butter(3, cutoff, fs=RATE, output="sos")
    field, turn = (CubicSpline(t, sosfiltfilt(smooth, x, axis=0)) for x in (m, w))
    at = np.arange(t[0] + MARGIN, t[-1] - MARGIN, 1 / RATE)
    here, change = field(at), field(at, 1)

    def rest(lag):
        now = turn(at - lag)
        columns = [np.tile(axis, len(at)) for axis in np.eye(3)]  # b x c
        for axis in np.eye(3):
            columns += [np.cross(now, axis).ravel(), np.cross(axis, here).ravel()]  # w x c, b x m
            columns += [np.cross(axis * now[:, [k]], here).ravel() for k in range(3)]  # M w x m
        matrix = np.stack(columns, 1)
        return np.sum((change.ravel() - matrix @ np.linalg.lstsq(matrix, change.ravel())[0]) ** 2)

    lag = _least(rest)
    return lag, rest(lag) / np.sum(change**2)
