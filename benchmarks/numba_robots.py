"""Simulations of the arm and of the helicopter as scalar loops in numba; arguments and draws as in `numba_linear.py`.

Matrices larger than 2 x 2 are loops over preallocated arrays.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
njit = numba.njit  # without fastmath: the same arithmetic as pcbench

PARTS, WEIGHTS = (0.0, 0.5, 0.5, 1.0), (1.0, 2.0, 2.0, 1.0)  # of a Runge-Kutta step


@njit
def _add(out, j, e):
    size = abs(e)
    out[0, j], out[1, j], out[2, j] = out[0, j] + size, out[1, j] + e * e, max(out[2, j], size)


class Arm(NamedTuple):
    """The arm without input, and smo with predicted output; N ticks, delay = sampling period."""

    ticks: int
    period: int  # [ticks]
    dt: float
    noise_std: Array  # [2]
    x0: Array  # [4]
    xhat0: Array  # [4]
    stiffness: float
    gravity: float
    friction: Array  # [2]
    d: Array  # [2 N + 3] unknown input by half ticks
    F: Array  # [6, 6] of (xd, y)
    Lx: Array  # [6, 2], its last rows 0
    S: Array  # [2, 6]
    P2: Array  # [2, 2]
    rho: float
    eps: float
    fhat: Array  # [2] fhat = fhat v
    transition: Array  # [period + 1, 4, 4] Phi^age


@njit
def _arm_rate(plant, x, d):
    stiffness, gravity, link_friction, motor_friction = plant
    spring = stiffness * (x[2] - x[0])
    return x[1], spring - link_friction * x[1] - gravity * np.sin(x[0]) + d, x[3], -spring - motor_friction * x[3]


@njit
def _ahead(x, h, k):
    return x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3]


@njit
def _end(x, h, a, b, c, d):
    """Return the end of a Runge-Kutta step with these four slopes."""
    h = h / 6
    return (
        x[0] + h * (a[0] + 2 * b[0] + 2 * c[0] + d[0]),
        x[1] + h * (a[1] + 2 * b[1] + 2 * c[1] + d[1]),
        x[2] + h * (a[2] + 2 * b[2] + 2 * c[2] + d[2]),
        x[3] + h * (a[3] + 2 * b[3] + 2 * c[3] + d[3]),
    )


@njit
def _arm_step(plant, x, h, d0, d1, d2):
    a = _arm_rate(plant, x, d0)
    b = _arm_rate(plant, _ahead(x, h / 2, a), d1)
    c = _arm_rate(plant, _ahead(x, h / 2, b), d1)
    return _end(x, h, a, b, c, _arm_rate(plant, _ahead(x, h, c), d2))


@njit
def _inject(law, S, z):
    p00, p01, p10, p11, rho, eps = law
    s0 = s1 = 0.0
    for j in range(6):
        s0 += S[0, j] * z[j]
        s1 += S[1, j] * z[j]
    a, b = p00 * s0 + p01 * s1, p10 * s0 + p11 * s1
    scale = rho / (np.sqrt(a * a + b * b) + eps)
    return scale * a, scale * b


@njit
def arm(case, noise, uniform, out):
    """The arm with a sampled, delayed smo; the fifth error is that of the unknown input."""
    N, h, period, samples = case.ticks, case.dt, case.period, -(-case.ticks // case.period)
    plant = case.stiffness, case.gravity, case.friction[0], case.friction[1]
    P2, F, Lx, S, d, transition, f0, f1 = (
        case.P2,
        case.F,
        case.Lx,
        case.S,
        case.d,
        case.transition,
        case.fhat[0],
        case.fhat[1],
    )
    law = P2[0, 0], P2[0, 1], P2[1, 0], P2[1, 1], case.rho, case.eps
    x = (case.x0[0], case.x0[1], case.x0[2], case.x0[3])
    z, ahead, rate, total, xhat, y = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(4), np.zeros(2)
    z[:4] = case.xhat0
    z[4], z[5] = z[1], z[2]
    out[:] = 0.0
    for i in range(samples):
        if i:  # the sample of one period ago arrives
            z[4], z[5] = y[0], y[1]
        y[0] = x[1] + case.noise_std[0] * noise[i]
        y[1] = x[2] + case.noise_std[1] * noise[samples + i]
        for k in range(i * period, min((i + 1) * period, N)):
            age = min(k, period)
            for a in range(4):
                entry = 0.0
                for b in range(4):
                    entry += transition[age, a, b] * z[b]
                xhat[a] = entry
                _add(out, a, x[a] - entry)
            v = _inject(law, S, z)
            _add(out, 4, d[2 * k] - (f0 * v[0] + f1 * v[1] + plant[1] * np.sin(xhat[0])))
            x = _arm_step(plant, x, h, d[2 * k], d[2 * k + 1], d[2 * k + 2])
            if k < period:
                continue
            for stage in range(4):
                part, weight = PARTS[stage] * h, WEIGHTS[stage]
                for a in range(6):
                    ahead[a] = z[a] + part * rate[a]
                v = _inject(law, S, ahead)
                for a in range(6):
                    entry = Lx[a, 0] * v[0] + Lx[a, 1] * v[1]
                    for b in range(6):
                        entry += F[a, b] * ahead[b]
                    rate[a] = entry
                for a in range(6):
                    total[a] += weight * rate[a]
            for a in range(6):
                z[a], total[a] = z[a] + h / 6 * total[a], 0.0


class Helicopter(NamedTuple):
    """The helicopter under its PD controller; N ticks. A sample arrives every period, `delay` ticks after it was taken."""

    ticks: int
    period: int  # [ticks]
    delay: int  # [ticks]
    dt: float
    noise_std: Array  # [2]
    x0: Array  # [4]
    z0: Array  # [6] estimate of states and viscosities
    M1: float  # inertia of the pitch
    Jps: float
    ml2: float
    mgl: float
    K: Array  # [2, 2]
    B: Array  # [2] viscosities
    Kp: Array  # [2]
    Kd: Array  # [2]
    limit: Array  # [2]
    path: Array  # [N + lag, 2, 2] angles and rates of the path from tick -lag on
    lag: int  # [ticks] of the older of the two commands that are interpolated
    weight: float  # of the newer one
    theta: float  # high-gain
    S0: float
    P0: Array  # [6, 6] ekf
    Q: Array  # [6, 6]
    R: Array  # [2]
    highest: float  # limit of the viscosities, from 0 on


@njit
def _parts(plant, pitch, r0, r1, u):
    """Return (a, phi) of both accelerations a B + phi."""
    M1, Jps, ml2, mgl, K00, K01, K10, K11 = plant
    s, c = np.sin(pitch), np.cos(pitch)
    M2, cross = Jps + ml2 * c * c, ml2 * s * c
    phi0 = (K00 * u[0] + K01 * u[1] - cross * r1 * r1 - mgl * c) / M1
    return -r0 / M1, -r1 / M2, phi0, (K10 * u[0] + K11 * u[1] + 2 * cross * r0 * r1) / M2


@njit
def _helicopter_rate(plant, x, u, B):
    a0, a1, phi0, phi1 = _parts(plant, x[0], x[2], x[3], u)
    return x[2], x[3], a0 * B[0] + phi0, a1 * B[1] + phi1


@njit
def _helicopter_step(plant, h, x, u, B):
    a = _helicopter_rate(plant, x, u, B)
    b = _helicopter_rate(plant, _ahead(x, h / 2, a), u, B)
    c = _helicopter_rate(plant, _ahead(x, h / 2, b), u, B)
    return _end(x, h, a, b, c, _helicopter_rate(plant, _ahead(x, h, c), u, B))


@njit
def _plant_of(case):
    """Return the numbers of the equations, J, ml2, mgl and K, as scalars."""
    K = case.K
    return case.M1, case.Jps, case.ml2, case.mgl, K[0, 0], K[0, 1], K[1, 0], K[1, 1]


@njit
def _law_of(case):
    """Return Kp, Kd and the limits as scalars."""
    Kp, Kd, limit = case.Kp, case.Kd, case.limit
    return (Kp[0], Kp[1]), (Kd[0], Kd[1]), (limit[0], limit[1])


@njit
def _command(law, path, commands, row, z):
    """Store the clipped PD command of a row of the path."""
    Kp, Kd, limit = law
    for j in range(2):
        u = -Kp[j] * (z[j] - path[row, 0, j]) - Kd[j] * (z[2 + j] - path[row, 1, j])
        commands[row, j] = min(max(u, -limit[j]), limit[j])


@njit
def _input(commands, k, w):
    """Return the input over tick k, between two commands stored from tick -lag on."""
    return (1 - w) * commands[k, 0] + w * commands[k + 1, 0], (1 - w) * commands[k, 1] + w * commands[k + 1, 1]


@njit
def _score_helicopter(x, B, z, out):
    for j in range(4):
        _add(out, j, x[j] - z[j])
    _add(out, 4, B[0] - z[4])
    _add(out, 5, B[1] - z[5])


@njit
def _high_gain_rate(plant, th, m, c, u, rate):
    """Store the rates of m = (z[6], al[2], S[6 x 2]), S by the rows 11 12 13 22 23 33."""
    parts = _parts(plant, m[0], m[2], m[3], u)
    for j in range(2):
        a, phi = parts[j], parts[2 + j]
        s11, s12, s13, s22, s23, s33 = m[8 + j], m[10 + j], m[12 + j], m[14 + j], m[16 + j], m[18 + j]
        c1, c2, c3 = s22 * s33 - s23 * s23, s13 * s23 - s12 * s33, s12 * s23 - s13 * s22
        g = th * (m[6 + j] + c[j]) / (s11 * c1 + s12 * c2 + s13 * c3)
        z2, z3 = m[2 + j], m[4 + j]
        rate[j], rate[2 + j], rate[4 + j], rate[6 + j] = (
            z2 - c1 * g,
            a * z3 + phi - th * c2 * g,
            -th * th * c3 * g,
            -c1 * g,
        )
        rate[8 + j], rate[10 + j], rate[12 + j] = th * (1 - s11), th * (-s12 - s11), th * (-s13 - a * s12)
        rate[14 + j], rate[16 + j] = th * (-s22 - 2 * s12), th * (-s23 - s13 - a * s22)
        rate[18 + j] = th * (-s33 - 2 * a * s23)


@njit
def high_gain(case, noise, uniform, out):
    """The loop with the high-gain observer as printed."""
    N, h, period, delay, samples = case.ticks, case.dt, case.period, case.delay, -(-case.ticks // case.period)
    plant, law, path, lag, weight, theta = _plant_of(case), _law_of(case), case.path, case.lag, case.weight, case.theta
    x, B = (case.x0[0], case.x0[1], case.x0[2], case.x0[3]), (case.B[0], case.B[1])
    m, ahead, rate, total = np.zeros(20), np.zeros(20), np.zeros(20), np.zeros(20)
    c, y, snapshot = np.zeros(2), np.zeros(2), np.zeros(2)
    m[:6] = case.z0
    for j in range(2):
        m[8 + j] = m[14 + j] = m[18 + j] = case.S0
        y[j], snapshot[j] = x[j] + case.noise_std[j] * noise[samples * j], m[j]
    commands = np.empty((N + lag, 2))
    for row in range(lag):
        _command(law, path, commands, row, m)
    out[:] = 0.0
    for k in range(N):
        if (k + delay) % period == 0:
            i = (k + delay) // period
            for j in range(2):
                y[j] = x[j] + case.noise_std[j] * noise[samples * j + i] if i < samples else 0.0
                snapshot[j] = m[j] - m[6 + j]
        if k % period == 0:
            for j in range(2):
                c[j] = snapshot[j] - y[j]
        _score_helicopter(x, B, m, out)
        _command(law, path, commands, k + lag, m)
        u = _input(commands, k, weight)
        x = _helicopter_step(plant, h, x, u, B)
        for stage in range(4):
            for a in range(20):
                ahead[a] = m[a] + PARTS[stage] * h * rate[a]
            _high_gain_rate(plant, theta, ahead, c, u, rate)
            for a in range(20):
                total[a] += WEIGHTS[stage] * rate[a]
        for a in range(20):
            m[a], total[a] = m[a] + h / 6 * total[a], 0.0


@njit
def _congruence(F, P, work):
    """Replace P by F P F'; all are [6, 6]."""
    for i in range(6):
        for j in range(6):
            entry = 0.0
            for l in range(6):
                entry += F[i, l] * P[l, j]
            work[i, j] = entry
    for i in range(6):
        for j in range(6):
            entry = 0.0
            for l in range(6):
                entry += work[i, l] * F[j, l]
            P[i, j] = entry


@njit
def _jacobian(plant, h, z, u, F):
    """Store I + h J at z in F, whose other entries are those of the identity."""
    M1, Jps, ml2, mgl, _, _, K10, K11 = plant
    s, c, r0, r1 = np.sin(z[0]), np.cos(z[0]), z[2], z[3]
    M2, cross, slope = Jps + ml2 * c * c, ml2 * s * c, ml2 * (c * c - s * s)
    torque = K10 * u[0] + K11 * u[1] + 2 * cross * r0 * r1 - z[5] * r1
    F[0, 2] = F[1, 3] = h
    F[2, 0] = h * (mgl * s - slope * r1 * r1) / M1
    F[2, 2], F[2, 3], F[2, 4] = 1.0 - h * z[4] / M1, -2 * h * cross * r1 / M1, -h * r0 / M1
    F[3, 0] = h * (2 * slope * r0 * r1 + 2 * cross * torque / M2) / M2
    F[3, 2], F[3, 3], F[3, 5] = 2 * h * cross * r1 / M2, 1.0 + h * (2 * cross * r0 - z[5]) / M2, -h * r1 / M2


@njit
def _predict(plant, h, z, u):
    """Move the mean z[6] by one tick; the viscosities stay."""
    z[0], z[1], z[2], z[3] = _helicopter_step(plant, h, (z[0], z[1], z[2], z[3]), u, (z[4], z[5]))


@njit
def _update(P, z, j, nu, R, gain, update, work):
    """Update z[6] and P by the sample of state j, in Joseph form; `update` is the identity before and after."""
    s = P[j, j] + R
    for a in range(6):
        gain[a] = P[a, j] / s
    for a in range(6):
        z[a] += gain[a] * nu
        update[a, j] -= gain[a]
    _congruence(update, P, work)
    for a in range(6):
        update[a, j] = 1.0 if a == j else 0.0
        for b in range(6):
            P[a, b] += R * gain[a] * gain[b]


@njit
def ekf(case, noise, uniform, out):
    """The loop with the extended Kalman filter: from sample to sample, and the mean on to the present."""
    N, h, period, delay, samples = case.ticks, case.dt, case.period, case.delay, -(-case.ticks // case.period)
    plant, law, path, lag, weight, Q = _plant_of(case), _law_of(case), case.path, case.lag, case.weight, case.Q
    x, B, highest, last = (case.x0[0], case.x0[1], case.x0[2], case.x0[3]), (case.B[0], case.B[1]), case.highest, 0
    z, then, gain, y = case.z0.copy(), case.z0.copy(), np.zeros(6), np.zeros(2)
    P, F, update, work, commands = case.P0.copy(), np.eye(6), np.eye(6), np.empty((6, 6)), np.empty((N + lag, 2))
    for row in range(lag):
        _command(law, path, commands, row, z)
    out[:] = 0.0
    for j in range(2):
        y[j] = x[j] + case.noise_std[j] * noise[samples * j]
    for k in range(N):
        if (k + delay) % period == 0:
            i = (k + delay) // period
            for j in range(2):
                y[j] = x[j] + case.noise_std[j] * noise[samples * j + i] if i < samples else 0.0
        if k % period == 0:
            taken = max(k - delay, 0)
            for t in range(last, taken):
                u = _input(commands, t, weight)
                _jacobian(plant, h, then, u, F)
                _predict(plant, h, then, u)
                _congruence(F, P, work)
                for a in range(6):
                    P[a, a] += Q[a, a]
            for j in range(2):
                _update(P, then, j, y[j] - then[j], case.R[j], gain, update, work)
            then[4], then[5] = min(max(then[4], 0.0), highest), min(max(then[5], 0.0), highest)
            last, z[:] = taken, then
            for t in range(taken, k):
                _predict(plant, h, z, _input(commands, t, weight))
        _score_helicopter(x, B, z, out)
        _command(law, path, commands, k + lag, z)
        u = _input(commands, k, weight)
        x = _helicopter_step(plant, h, x, u, B)
        _predict(plant, h, z, u)
