"""Observers which reconstruct an unknown input: the sliding-mode and the PI observer on a flexible-joint arm.

Plant:  x' = A x + D f,  y = C x,  x = [link angle, link velocity, motor angle, motor velocity], input u = 0 throughout;
        f = -delta sin(x1) + d(t)  is the lumped unknown input, d the disturbance.                          (53)
Source: Peng, "Nonlinear Integral Type Observer Design for State Estimation and Unknown Input Reconstruction",
Appl. Sci. 2017, 7(1), 67; its equations in brackets. Its minus signs are lost in the text and restored here.

Both observers stand in the original coordinates, e_y = y - C xhat, s = Tp e_y:
        xhat' = A xhat + Gx e_y + Lx v,   Gx = T^-1 [G1; G2],   Lx = T^-1 [L; I],   L = [L1, 0].            (5), (12)
Errors are x - xhat and d - dhat. Arrays of a run are [time, runs, component]; all runs share a time grid.

Time: a disturbance is an array at the 2 N + 1 stage times (j/2) dt, never at an accumulated time; the fourth stage of
step i reads d((i+1) dt), so after a jump that falls there. `joint` is the continuous measurement: plant and
observer are one ODE, y(t) = C x(t) at every stage. `sampled` and `kf` get samples, te ticks apart and late by d ticks.

Differs from print: x(0), xhat(0), dt and the window's ends are not printed; those below reproduce Table 2. The paper
puts the zeros of the arm with both sensors on the link at 0.006 +- 1.9365j in size; they are -0.000625 +- 1.9365j.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, null_space, orth

from .linear import discretise, powers, process_noise

Array = np.ndarray

K_J, F_LINK, F_MOTOR, DELTA = 15 / 4, 0.006 / 4, 0.005 / 4, 0.15 * 9.8 * 0.3 / 4  # k/J, F_l/J, F_m/J, M g l/J
X0 = np.array([-0.5, 1.0, -1.5, -0.5])
DT, STEPS, TAIL = 1e-4, 100_000, 60_000  # step [s], steps to 10 s, first step of the window 6 <= t <= 10


class System(NamedTuple):
    """x' = A x + B u + D f, y = C x: A [n, n], B [n, m], C [p, n], D [n, q]."""

    A: Array
    B: Array
    C: Array
    D: Array


class Split(NamedTuple):
    """z = T x of (4): blocks of T A T^-1 at n-p, and Tp [p, p], D222 [q, q] of Tp D2 = [0; D222]."""

    T: Array
    Tp: Array
    A11: Array
    A12: Array
    A21: Array
    A22: Array
    D222: Array


class Observer(NamedTuple):
    """An observer in original coordinates: Gx [n, p], Lx [n, p], Tp [p, p]; v(s, w) [p]; w'(s) [p], w(0) = 0."""

    Gx: Array
    Lx: Array
    Tp: Array
    v: Callable[[Array, Array], Array]
    w_rate: Callable[[Array], Array]


class Trace(NamedTuple):
    """x, xhat [N+1, runs, n] and v [N+1, runs, p], all at t = i dt."""

    x: Array
    xhat: Array
    v: Array


def state_matrix(stiffness: float = 1.0, friction: float = 1.0) -> Array:
    """Return A [4, 4] of (53); the factors multiply k/J and F/J."""
    k, a, b = stiffness * K_J, friction * F_LINK, friction * F_MOTOR
    return np.array([[0, 1, 0, 0], [-k, -a, k, 0], [0, 0, 0, 1], [k, 0, -k, -b]])


C_ARM = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0]])
B_ARM, D_ARM = 0.25 * np.eye(4)[:, [3]], np.eye(4)[:, [1]]
ARM = System(state_matrix(), B_ARM, C_ARM, D_ARM)


def stage_times(steps: int, dt: float) -> Array:
    """Return (j/2) dt, j = 0 .. 2 steps: grid times at even j, middles at odd j."""
    return np.arange(2 * steps + 1) / 2 * dt


def d1(t: Array) -> Array:
    """Return the sine 0.25 sin(2 pi t)."""
    return 0.25 * np.sin(2 * np.pi * t)


def d2(t: Array) -> Array:
    """Return the saw-tooth of period 2 s, right-continuous: it jumps from 0.35 to 0."""
    return 0.025 * (2 * np.abs(10 * t - 20 * np.floor(0.5 * t) - 6.5) - 13)


def blocks(T: Array, Tp: Array, system: System) -> Split:
    """Return the blocks of (4) under z = T x with a given Tp."""
    n, p, q = len(system.A), len(system.C), system.D.shape[1]
    M, lower = T @ system.A @ np.linalg.inv(T), (T @ system.D)[n - q :]
    k = n - p
    return Split(T, Tp, M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], lower)


def check_assumptions(system: System) -> None:
    """Raise ValueError where Assumption 1 or 2 fails, with its name and the rank found."""
    A, B, C, D = system
    n, m, p, q = len(A), B.shape[1], len(C), D.shape[1]
    rank = np.linalg.matrix_rank
    observability = np.vstack([C @ np.linalg.matrix_power(A, i) for i in range(n)])
    for holds, text in [
        (rank(C) == p, f"Assumption 1: rank C = {rank(C)}, want p = {p}"),
        (rank(D) == q, f"Assumption 1: rank D = {rank(D)}, want q = {q}"),
        (rank(C @ D) == q, f"Assumption 1: rank(C D) = {rank(C @ D)}, want q = {q}"),
        (n > p >= m, f"Assumption 2: want n > p >= m, got n = {n}, p = rank C = {p}, m = {m}"),
        (p > q, f"Assumption 2: want p > q, got p = rank C = {p}, q = rank D = {q}"),
        (rank(observability) == n, f"Assumption 2: observability matrix of rank {rank(observability)}, want n = {n}"),
    ]:
        if not holds:
            raise ValueError(text)


def transform(system: System) -> Split:
    """Return T = TD To of (2)-(4) for any system which meets Assumptions 1 and 2.

    To = [N'; C], N an orthonormal basis of null(C); TD = [I, -D1 (D2'D2)^-1 D2'; 0, Tp]; the first non-zero
    entry of each row of T is made positive, in N and in Tp alike. N and Tp are unique up to a rotation only.
    """
    check_assumptions(system)
    C, D = system.C, system.D
    k = len(system.A) - len(C)
    N = null_space(C)
    D1, D2 = N.T @ D, C @ D
    Tp = np.vstack([null_space(D2.T).T, orth(D2).T])
    T = np.vstack([N.T - D1 @ np.linalg.solve(D2.T @ D2, D2.T) @ C, Tp @ C])
    first = [row[np.flatnonzero(np.abs(row) > 1e-12)[0]] for row in T]
    sign = np.sign(first)[:, None]
    return blocks(sign * T, sign[k:] * Tp, system)


def arm_split() -> Split:
    """Return the permutation z = [x1, x4, x3, x2], to which the printed gains belong."""
    return blocks(np.eye(4)[[0, 3, 2, 1]], np.array([[0.0, 1], [1, 0]]), ARM)


def unmovable_modes(A11: Array, A211: Array) -> list[complex]:
    """Return the eigenvalues of A11 - L1 A211 which no L1 moves: rank [A11 - lambda I; A211] < n - p."""
    n, rank = len(A11), np.linalg.matrix_rank
    return [z for z in np.linalg.eigvals(A11) if rank(np.vstack([A11 - z * np.eye(n), A211]), tol=1e-9) < n]


def injection(split: Split, L1: Array, A22s: Array) -> tuple[Array, Array]:
    """Return Gx, Lx [n, p] of (12) from L1 [n-p, p-q] and A22s [p, p] (zero for the PIO, (35))."""
    T, Tp, A11, A12, A21, A22, D222 = split
    p, q = len(Tp), len(D222)
    L = np.hstack([L1, np.zeros((len(A11), q))])
    A12b = A12 - L @ A22 + A11 @ L - L @ A21 @ L
    A22b = A22 + A21 @ L
    G2 = (A22b - A22s) @ Tp
    G1 = A12b @ Tp + L @ G2
    inverse = np.linalg.inv(T)
    return inverse @ np.vstack([G1, G2]), inverse @ np.vstack([L, np.eye(p)])


def smo(split: Split, L1: Array, A22s: Array, P2: Array, rho: float = 1.0, eps: float = 0.005) -> Observer:
    """Return the sliding-mode observer (5), (21), smoothed: v = rho P2 s / (||P2 s||_2 + eps)."""

    def v(s: Array, w: Array) -> Array:
        r = s @ P2.T
        return rho * r / (np.sqrt(np.vecdot(r, r))[..., None] + eps)

    return Observer(*injection(split, L1, A22s), split.Tp, v, lambda s: 0 * s)


def pio(split: Split, L1: Array, KP: Array, KI: Array, xi: float = 2.0) -> Observer:
    """Return the PI observer (35), (37): v = KP s + w, w' = KI s + xi sgn(s), sgn(0) = 0."""
    gains = injection(split, L1, np.zeros_like(KP))
    return Observer(*gains, split.Tp, lambda s, w: s @ KP.T + w, lambda s: s @ KI.T + xi * np.sign(s))


L1_PAPER = np.array([[0.8148], [2.4893]])
A22S_PAPER, P2_PAPER = np.array([[-2.5881, 0.0141], [0.0141, -2.6187]]), np.array([[1.007, 0.0021], [0.0021, 1.0024]])
KP_PAPER, KI_PAPER = np.array([[21.7396, 0.0278], [0.0283, 21.8043]]), np.array([[22.2876, 0.0272], [0.0288, 22.3538]])
SMO = smo(arm_split(), L1_PAPER, A22S_PAPER, P2_PAPER)
PIO = pio(arm_split(), L1_PAPER, KP_PAPER, KI_PAPER)


def rk4(field: Callable[..., Array], z: Array, stages: Array, h: float) -> Array:
    """Return z(t + h) of z' = field(z, input); stages: the input at t, t + h/2, t + h."""
    k1 = field(z, stages[0])
    k2 = field(z + h / 2 * k1, stages[1])
    k3 = field(z + h / 2 * k2, stages[1])
    k4 = field(z + h * k3, stages[2])
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def joint(observer: Observer, d: Array, x0: Array, dt: float = DT) -> Trace:
    """Run arm and observer as one ODE from x0 [runs, 4], xhat(0) = 0; d [2N+1, runs] at the stage times."""
    G, TpC, steps, p = observer.Gx @ ARM.C, observer.Tp @ ARM.C, len(d) // 2, len(ARM.C)
    M, LT = np.zeros((8 + p, 8 + p)), observer.Lx.T
    M[:4, :4], M[:4, 4:8], M[4:8, 4:8] = ARM.A.T, G.T, (ARM.A - G).T
    S = np.hstack([TpC, -TpC, np.zeros((p, p))]).T

    def field(z: Array, d: Array) -> Array:  # z = [x, xhat, w]: z M is the linear part, z S is s
        rate, s = z @ M, z @ S
        rate[:, 1] += d - DELTA * np.sin(z[:, 0])
        rate[:, 4:8] += observer.v(s, z[:, 8:]) @ LT
        rate[:, 8:] = observer.w_rate(s)
        return rate

    z = np.zeros((steps + 1, len(x0), 8 + p))
    z[0, :, :4] = x0
    for i in range(steps):
        z[i + 1] = rk4(field, z[i], d[2 * i : 2 * i + 3], dt)
    return Trace(z[..., :4], z[..., 4:8], observer.v(z @ S, z[..., 8:]))


def lumped(split: Split, v: Array) -> Array:
    """Return fhat [..., q] = D222^-1 v[p-q:]  (Remark 2)."""
    q = len(split.D222)
    return v[..., -q:] @ np.linalg.inv(split.D222).T


def disturbance(xhat: Array, v: Array) -> Array:
    """Return dhat [...] = v[1] + delta sin(xhat1), for the arm."""
    return v[..., 1] + DELTA * np.sin(xhat[..., 0])


def errors(trace: Trace, d: Array) -> Array:
    """Return [x - xhat, d - dhat] [N+1, runs, 5]; d [2N+1, runs] as given to `joint`."""
    return np.concatenate([trace.x - trace.xhat, (d[::2] - disturbance(trace.xhat, trace.v))[..., None]], axis=-1)


def table(e: Array, first: int = TAIL) -> tuple[Array, Array]:
    """Return max and mean [runs, 5] of |e| over the steps first .. N, both ends included (Table 2)."""
    tail = np.abs(e[first:])
    return tail.max(axis=0), tail.mean(axis=0)


def plant(d: Array, x0: Array, dt: float, drift: Array | None = None) -> Array:
    """Return x [N+1, runs, 4] of the arm alone; d [2N+1, runs] at the stage times.

    drift [2N+1, 3], at the stage times: the factors of k/J, M g l/J and F/J (None: 1).
    """
    factors = np.ones((len(d), 3)) if drift is None else drift
    inputs = np.concatenate([factors, d], axis=1)

    def field(x: Array, now: Array) -> Array:
        f = now[3:] - now[1] * DELTA * np.sin(x[:, 0])
        return x @ state_matrix(now[0], now[2]).T + f[:, None] * ARM.D.T

    x = np.zeros((len(d) // 2 + 1, *x0.shape))
    x[0] = x0
    for i in range(len(x) - 1):
        x[i + 1] = rk4(field, x[i], inputs[2 * i : 2 * i + 3], dt)
    return x


def samples_of(x: Array, te: int, d: int, noise: Array | None = None) -> Array:
    """Return y_i = C x(t_i) + noise_i [M, runs, 2], t_i = i te, of those M which arrive, at i te + d, by tick N."""
    y = x[: len(x) - d : te] @ ARM.C.T
    return y if noise is None else y + noise[: len(y)]


def deliver(y: Array, steps: int, te: int, d: int) -> Array:
    """Return what arrives at each tick [N+1, runs, 2]: y_i at tick i te + d, NaN where nothing does."""
    arrivals = np.full((steps + 1, *y.shape[1:]), np.nan)
    arrivals[d::te] = y
    return arrivals


def sampled(observer: Observer, arrivals: Array, dt: float, measurement: str = "predict") -> tuple[Array, Array]:
    """Return xd [N+1, runs, 4], the estimate of x(t_k - d), and fhat [N+1, runs]; arrivals [N+1, runs, 2].

    The section arm/sampled. Value at tick k: after the arrival there. Before the first arrival Y = C xhat(0) = 0.
    `hold`: e_y = Y - C xd; `predict`: e_y = wy - C xd, wy' = C A xd, wy := Y at arrivals.
    One RK4 step of (xd, w, wy) a tick; `hold` is wy' = 0. Runs may differ in te and d: both are in `arrivals`.
    """
    if measurement not in ("hold", "predict"):
        raise ValueError(f"measurement is {measurement!r}; want 'hold' or 'predict'")
    A, C, G, Tp, LT, M = ARM.A, ARM.C, observer.Gx, observer.Tp, observer.Lx.T, np.zeros((8, 8))
    M[:4, :4], M[6:, :4] = (A - G @ C).T, G.T
    M[:4, 6:] = (C @ A).T if measurement == "predict" else 0.0
    S = np.hstack([-Tp @ C, np.zeros((2, 2)), Tp]).T

    def field(z: Array, _: float) -> Array:  # z = [xd, w, wy]
        rate, s = z @ M, z @ S
        rate[:, :4] += observer.v(s, z[:, 4:6]) @ LT
        rate[:, 4:6] = observer.w_rate(s)
        return rate

    z = np.zeros((*arrivals.shape[:2], 8))
    for k in range(len(z)):
        z[k, :, 6:] = np.where(np.isnan(arrivals[k]), z[k, :, 6:], arrivals[k])
        if k + 1 < len(z):
            z[k + 1] = rk4(field, z[k], np.zeros(3), dt)
    return z[..., :4], observer.v(z @ S, z[..., 4:6])[..., 1]


def to_now(xd: Array, fhat: Array, delay: float, reconstruct: bool = False) -> Array:
    """Return xhat = e^{A delay} xd (+ int_0^delay e^{As} ds D fhat if `reconstruct`) [N+1, runs, 4]; delay [s]."""
    Phi, response = discretise(ARM.A, ARM.D, delay)
    return xd @ Phi.T + (fhat[..., None] * response[:, 0] if reconstruct else 0.0)


def kf(y: Array, steps: int, te: int, d: int, dt: float, R: float, q: float = 1.0) -> tuple[Array, Array]:
    """Return xhat [N+1, runs, 4], fhat [N+1, runs] at t_k of the Kalman filter with f' = white noise of density q.

    Augmented model A_a = [A D; 0 0], prior N(0, I) at t = 0. Sample i updates at its own time i te, once it has
    arrived at i te + d; then x is predicted to now by A_a, so that the prediction carries fhat. R: variance of a sample.
    """
    A, W = np.zeros((5, 5)), np.zeros((5, 5))
    A[:4, :4], A[:4, 4:], W[4, 4] = ARM.A, ARM.D, q
    C = np.hstack([ARM.C, np.zeros((2, 1))])
    Phi, Q = expm(A * te * dt), process_noise(A, W, te * dt)
    ahead = powers(expm(A * dt), te + d)
    x, P = np.zeros((y.shape[1], 5)), np.eye(5)
    out = np.zeros((steps + 1, y.shape[1], 5))  # before the first arrival: A_a 0 = 0
    for i, measured in enumerate(y):
        if i > 0:
            x, P = x @ Phi.T, Phi @ P @ Phi.T + Q
        L = P @ C.T @ np.linalg.inv(C @ P @ C.T + R * np.eye(2))
        x = x + (measured - x @ C.T) @ L.T
        P = (np.eye(5) - L @ C) @ P @ (np.eye(5) - L @ C).T + R * L @ L.T
        for k in range(i * te + d, min((i + 1) * te + d, steps + 1)):
            out[k] = x @ ahead[k - i * te].T
    return out[..., :4], out[..., 4]
