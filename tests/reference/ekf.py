"""An extended Kalman filter for any field, with loops and lists; slopes by complex steps. Shares no code with pcbench.

z' = f(z, u), late samples y = C z(s) + v; each is taken at tick s and arrives at a later one, in order. At an arrival mean and
covariance go tick by tick from the last sample's posterior to s, are updated there, and the mean alone goes on to now:
P <- F P F' + Q with F = I + h df/dz before the step; the mean by classical Runge-Kutta. Source: Jazwinski 1970, chapter 8.
"""

import numpy as np


def rk4(f, z, u, h):
    k1 = f(z, u)
    k2 = f(z + h / 2 * k1, u)
    k3 = f(z + h / 2 * k2, u)
    k4 = f(z + h * k3, u)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def slope(f, z, u):
    """df/dz [N, N] by complex steps of 1e-30: exact to rounding."""
    columns = []
    for i in range(len(z)):
        moved = z.astype(complex)
        moved[i] += 1e-30j
        columns.append(f(moved, u).imag / 1e-30)
    return np.array(columns).T


def ekf(f, h, z0, P0, Q, R, C, u, arrivals):
    """Return the estimates of ticks 0 .. N, [N+1, n]; `arrivals[k]` lists (taken, y) that come at tick k."""
    return filter_by_arrival(f, h, z0, P0, Q, R, C, u, arrivals)[0]


def filter_by_arrival(f, h, z0, P0, Q, R, C, u, arrivals):
    """Return the same, the covariance of each tick by the slopes since the last sample, [N+1, n, n], and nu' S^-1 nu."""
    z, P, taken, now, out = np.array(z0, float), np.array(P0, float), 0, np.array(z0, float), []
    spread, squares = [], np.zeros(len(u))
    for k in range(len(u)):
        for s, y in arrivals.get(k, []):
            for tick in range(taken, s):
                F = np.eye(len(z)) + h * slope(f, z, u[tick])
                z, P = rk4(f, z, u[tick], h), F @ P @ F.T + Q
            nu = y - C @ z
            squares[k] += nu @ np.linalg.solve(C @ P @ C.T + R, nu)
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
            z, taken = z + K @ (y - C @ z), s
            keep = np.eye(len(z)) - K @ C
            P = keep @ P @ keep.T + K @ R @ K.T
            now = z
            for tick in range(s, k):
                now = rk4(f, now, u[tick], h)
        out.append(now)
        at, there = z, P
        for tick in range(taken, k):
            F = np.eye(len(z)) + h * slope(f, at, u[tick])
            at, there = rk4(f, at, u[tick], h), F @ there @ F.T + Q
        spread.append(there)
        now = rk4(f, now, u[k], h)
    return np.array(out), np.array(spread), squares
