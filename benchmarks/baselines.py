"""The same experiment without pcbench, as three people would write it: a loop per run, NumPy over runs, numba per run.

Plant, pccebo and kfbo of the mobile cart advance tick by tick; of e = x - xhat the sums of |e| and e^2 and the peak are
kept, [3, 4, L]: pccebo's two states, then kfbo's. Every run simulates its own plant, from its own start and with its own
noise. Equations and order of events are pcbench's (`observers.pccebo`, `observers.kfbo`), for one channel whose delay is
its sampling period (d = te), so the estimate that pccebo takes up on an arrival is also xbar of the next sample.

What depends on the input alone is the same in all runs: `prepare` lays it out once, outside every timing, for the two
fast baselines. That favours them slightly; pcbench computes it once a call.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Case(NamedTuple):
    """The numbers of one experiment; N ticks, M sampling periods. Index s: 0 before the first arrival, 1 after."""

    u: Array  # [N] input held over the tick
    period: int  # [ticks] te, and the delay
    noise_std: float
    xhat0: Array  # [2]
    Phi: Array  # [2, 2] plant and model, one tick
    Gamma: Array  # [2]
    E: Array  # [2, 2] the model over te
    L: Array  # [2] pccebo's gain
    Phi_z: Array  # [s, 2, 2] kfbo's filter, one tick; it stands still before the first arrival
    Gamma_z: Array  # [2]
    Gain_z: Array  # [2]
    E_z: Array  # [s, 2, 2] what kfbo's estimate takes of z
    moved: Array  # [N, 2] Gamma u
    moved_z: Array  # [N, 2] Gamma_z u one delay ago
    offset: Array  # [N, 2] what kfbo's estimate adds to E_z z
    integral: Array  # [M, 2] I(t_m, t_m + te)


def prepare(problem: Any, ticks: int) -> Case:
    """Return the numbers of the first `ticks` ticks of a pcbench cart problem with pccebo and kfbo."""
    Phi, Gamma, u = problem.params.Phi[0], problem.params.Gamma[0][:, 0], problem.inputs[:ticks, 0]
    kfbo, xhat0 = problem.gains["kfbo"], np.asarray(problem.xhat0)
    d, E = int(kfbo.lag), kfbo.E
    g, free = np.zeros((ticks + 1, 2)), np.tile(xhat0, (ticks + 1, 1))
    for k in range(ticks):
        g[k + 1], free[k + 1] = Phi @ g[k] + Gamma * u[k], Phi @ free[k]
    starts = np.arange(0, ticks - d + 1, d)
    return Case(
        u=u.copy(),
        period=d,
        noise_std=float(problem.noise_std[0]),
        xhat0=xhat0,
        Phi=np.array(Phi),
        Gamma=Gamma.copy(),
        E=E,
        L=problem.gains["pccebo"].L[:, 0].copy(),
        Phi_z=np.stack([np.eye(2), kfbo.Phi_z]),
        Gamma_z=kfbo.Gamma_z[:, 0].copy(),
        Gain_z=kfbo.Gain_z[:, 0].copy(),
        E_z=np.stack([np.zeros((2, 2)), E]),
        moved=np.outer(u, Gamma),
        moved_z=np.concatenate([np.zeros((d, 2)), np.outer(u[:-d], kfbo.Gamma_z[:, 0])]),
        offset=np.concatenate([free[:d] + g[:d], g[d:ticks] - g[: ticks - d] @ E.T]),
        integral=g[starts + d] - g[starts] @ E.T,
    )


def one_run(c: Case, x0: Array, noise: Array) -> Array:
    """Simulate one run from x0[2] with noise[M], small arrays and a loop, straight from the equations; [3, 4]."""
    x, xhat, z, xbar, integral = x0, c.xhat0, c.xhat0, c.xhat0, np.zeros(2)
    g, F, y, Y = np.zeros((len(c.u) + 1, 2)), np.eye(2), 0.0, 0.0  # F = e^{A min(t, d)}
    absolute, square, peak = np.zeros(4), np.zeros(4), np.zeros(4)
    for k, u in enumerate(c.u):
        if k % c.period == 0:
            if k > 0:  # the sample of one period ago arrives
                Y = y
                xhat = xbar = c.E @ (xbar + c.L * (y - xbar[0])) + integral
                integral = np.zeros(2)
            y = x[0] + c.noise_std * noise[k // c.period]
        started = k >= c.period
        past = g[k - c.period] if started else 0.0
        e = np.concatenate([x - xhat, x - (g[k] + F @ (z - past))])
        size = np.abs(e)
        absolute, square, peak = absolute + size, square + e * e, np.maximum(peak, size)
        pushed = c.Gamma * u
        x, xhat, integral = c.Phi @ x + pushed, c.Phi @ xhat + pushed, c.Phi @ integral + pushed
        g[k + 1] = c.Phi @ g[k] + pushed
        if started:
            z = c.Phi_z[1] @ z + c.Gamma_z * c.u[k - c.period] + c.Gain_z * Y
        else:
            F = c.Phi @ F
    return np.stack([absolute, square, peak])


def over_runs(c: Case, x0: Array, noise: Array) -> Array:
    """Simulate all runs at once from x0[2, L] with noise[M, L]; [3, 4, L].

    One product a tick gives the errors and everything at the next tick: v = [x, xhat, z, Y, 1] (8), and out of it
    [e of pccebo, e of kfbo, x, xhat, z] (10). At 1024 lanes a tick took 21 us so, and 36 us written out row by row.
    """
    lanes, joint = x0.shape[1], [_joint(c, s) for s in (0, 1)]
    last = np.concatenate([np.zeros((len(c.u), 2)), -c.offset, c.moved, c.moved, c.moved_z], 1)  # times the row of ones
    now, then = np.zeros((12, lanes)), np.zeros((12, lanes))
    now[4:6], now[6:10], now[11], then[11] = x0, np.tile(c.xhat0, 2)[:, None], 1.0, 1.0
    xbar, y = np.repeat(c.xhat0[:, None], lanes, 1), np.zeros(lanes)
    size, (absolute, square, peak) = np.empty((4, lanes)), np.zeros((3, 4, lanes))
    for k in range(len(c.u)):
        if k % c.period == 0:
            m = k // c.period
            if m > 0:
                now[10], then[10] = y, y
                xbar = c.E @ (xbar + c.L[:, None] * (y - xbar[0])) + c.integral[m - 1][:, None]
                now[6:8] = xbar
            y = now[4] + c.noise_std * noise[m]
            M = joint[min(m, 1)]
        M[:, 7] = last[k]
        np.matmul(M, now[4:], out=then[:10])
        e = then[:4]
        np.abs(e, out=size)
        np.add(absolute, size, out=absolute)
        np.maximum(peak, size, out=peak)
        np.multiply(e, e, out=size)
        np.add(square, size, out=square)
        now, then = then, now
    return np.stack([absolute, square, peak])


def _joint(c: Case, s: int) -> Array:
    """The map [10, 8] of `over_runs`, its last column left open."""
    one, none = np.eye(2), np.zeros((2, 2))
    gain, unit = np.column_stack([c.Gain_z, np.zeros(2)]), np.zeros((2, 2))
    return np.block(
        [
            [one, -one, none, unit],
            [one, none, -c.E_z[s], unit],
            [c.Phi, none, none, unit],
            [none, c.Phi, none, unit],
            [none, none, c.Phi_z[s], gain],
        ]
    )


def runs_alone(c: Case, x0: Array, noise: Array) -> Array:
    """Simulate every run alone in compiled scalars, runs shared out over numba's threads; as `over_runs`."""
    numbers = (c.period, c.noise_std, c.xhat0, c.Phi, c.E, c.L, c.Phi_z, c.Gain_z, c.E_z, c.integral)
    table = np.concatenate([c.moved, c.moved_z, c.offset], 1)  # what a tick reads lies together
    return _scalar_runs(*numbers, table, x0, noise).reshape(-1, 3, 4).transpose(1, 2, 0)


# The numbers go one by one: handed over as the tuple they are, they took numba twice as long to compile.
@numba.njit(parallel=True)
def _scalar_runs(period, noise_std, xhat0, Phi, E, L, Phi_z, Gain_z, E_z, integral, table, x0, noise):
    out = np.empty((x0.shape[1], 12))
    for lane in numba.prange(x0.shape[1]):
        _scalar_run(period, noise_std, xhat0, Phi, E, L, Phi_z, Gain_z, E_z, integral, table, x0, noise, lane, out)
    return out


@numba.njit
def _scalar_run(period, noise_std, xhat0, Phi, E, L, Phi_z, Gain_z, E_z, integral, table, start, noise, lane, out):
    x0, x1, p0, p1, z0, z1 = start[0, lane], start[1, lane], xhat0[0], xhat0[1], xhat0[0], xhat0[1]
    b0, b1, y, Y = p0, p1, 0.0, 0.0
    f00, f01, f10, f11 = Phi[0, 0], Phi[0, 1], Phi[1, 0], Phi[1, 1]
    s0 = s1 = s2 = s3 = q0 = q1 = q2 = q3 = m0 = m1 = m2 = m3 = 0.0
    for first in range(0, len(table), period):
        i, s = first // period, min(first, 1)
        if i > 0:
            Y, innovation = y, y - b0
            l0, l1 = b0 + L[0] * innovation, b1 + L[1] * innovation
            b0 = p0 = E[0, 0] * l0 + E[0, 1] * l1 + integral[i - 1, 0]
            b1 = p1 = E[1, 0] * l0 + E[1, 1] * l1 + integral[i - 1, 1]
        y = x0 + noise_std * noise[i, lane]
        h00, h01, h10, h11 = Phi_z[s, 0, 0], Phi_z[s, 0, 1], Phi_z[s, 1, 0], Phi_z[s, 1, 1]
        r00, r01, r10, r11 = E_z[s, 0, 0], E_z[s, 0, 1], E_z[s, 1, 0], E_z[s, 1, 1]
        c0, c1 = Gain_z[0] * Y, Gain_z[1] * Y
        for k in range(first, min(first + period, len(table))):
            u0, u1, w0, w1, o0, o1 = table[k, 0], table[k, 1], table[k, 2], table[k, 3], table[k, 4], table[k, 5]
            e0, e1 = x0 - p0, x1 - p1
            e2, e3 = x0 - (r00 * z0 + r01 * z1 + o0), x1 - (r10 * z0 + r11 * z1 + o1)
            s0, s1, s2, s3 = s0 + abs(e0), s1 + abs(e1), s2 + abs(e2), s3 + abs(e3)
            q0, q1, q2, q3 = q0 + e0 * e0, q1 + e1 * e1, q2 + e2 * e2, q3 + e3 * e3
            m0, m1, m2, m3 = max(m0, abs(e0)), max(m1, abs(e1)), max(m2, abs(e2)), max(m3, abs(e3))
            x0, x1 = f00 * x0 + f01 * x1 + u0, f10 * x0 + f11 * x1 + u1
            p0, p1 = f00 * p0 + f01 * p1 + u0, f10 * p0 + f11 * p1 + u1
            z0, z1 = h00 * z0 + h01 * z1 + w0 + c0, h10 * z0 + h11 * z1 + w1 + c1
    for i, value in enumerate((s0, s1, s2, s3, q0, q1, q2, q3, m0, m1, m2, m3)):
        out[lane, i] = value
