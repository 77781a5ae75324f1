"""The chain observer for unequal measurement delays and the methods it is compared with, whole histories kept.

Plant (1):  x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + D u(k) + v(k);  r_j(k) = y_j(k - tau_j) arrives at tick k.
Source: Alipouri, Zhong, Actuators 10 (2021) 281; equation numbers in brackets are the paper's, "page" is the project's
page on it. A time is a tick. Arrays u, r, y, w, v have N + 1 rows, row k is tick k. xhat[k] is read after what arrives
at k: it uses r[0 .. k] and u[0 .. k-1] (and u[k] where D != 0 and a delay is 0). Here link i = 0 .. q-1 is the paper's
chain i + 1: theta[i] = theta_{i-1}, the stamp's age, and theta[i+1], the source's age.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import place_poles

from .linear import discretise

Array = np.ndarray
power = np.linalg.matrix_power


class Plant(NamedTuple):
    """The discrete plant (1): A [n, n], B [n, m], C [q, n], D [q, m], tick Ts [s]."""

    A: Array
    B: Array
    C: Array
    D: Array
    Ts: float = 1.0


class Link(NamedTuple):
    """One link: d ticks from source to stamp, the channels it measures, F, K of (6) with T = I, and V, W of (7)."""

    d: int
    mask: list[bool]
    F: Array
    K: Array
    V: Array
    W: Array


def csth_continuous() -> tuple[Array, Array, Array]:
    """Return Ac, Bc, C of the stirred tank heater from its balances (page, "Plants")."""
    c11, c22, a21, a22, k, mc = 31.831, 3.8578e-5, 626.4371, -5.9406e-3, 36.55, 30411.5241
    r = c22 * a21 / abs(a22)  # tank temperature TT = c22 H - r V
    A = np.array([[0, 0, 0], [a21, a22, k], [-k * r / mc, k * c22 / mc, -k / mc]])
    return A, np.array([[1, 0], [0, 0], [0, 1 / mc]]), np.array([[c11, 0, 0], [-r, c22, 0], [0, 0, 1]])


def csth(kind: str) -> Plant:
    """Return the plant `literal`, `1s` or `10s` (page, "Plants"): n = 3, m = 2, q = 3, D = 0."""
    if kind == "literal":
        A = np.array([[0, 0, 0], [626.4371, -5.9406e-3, 0], [0, 0, -1.2019e-3]])
        return Plant(A, np.array([[1, 0], [0, 0], [0, 30411.5241]]), np.diag([31.831, 3.8578e-5, 1]), np.zeros((3, 2)))
    Ts = {"1s": 1.0, "10s": 10.0}[kind]
    Ac, Bc, C = csth_continuous()
    return Plant(*discretise(Ac, Bc, Ts), C, np.zeros((3, 2)), Ts)


def csth_noise(Ts: float) -> tuple[Array, Array, Array]:
    """Return Q [n, n] per tick, R [q, q] per sample, P0 [n, n] of csth/10s-noise (page); w(k), v(k) as in (1) above."""
    return Ts * np.diag([1e-3, 50, 5e-3]) ** 2, np.diag([1, 0.1, 0.1]) ** 2, np.diag([0.5, 2e4, 5]) ** 2


def csth_input(N: int, a: float) -> Array:
    """Return u [N+1, 2] (page, "Inputs"); a = 500 W, for `literal` 1e-3. u[k] is held on [k, k+1)."""
    u1 = [0.02 if k % 40 < 20 else -0.02 for k in range(N + 1)]
    u2 = [a if k % 60 < 30 else -0.6 * a for k in range(N + 1)]
    return np.column_stack([u1, u2])


def simulate(plant: Plant, u: Array, x0: Array, w: Array | None = None, v: Array | None = None) -> tuple[Array, Array]:
    """Return x [N+1, n], y [N+1, q] of (1): w[k] [n] enters x[k+1], v[k] [q] is in y[k]; None is no noise."""
    A, B, C, D, _ = plant
    x = np.zeros((len(u), len(A)))
    x[0] = x0
    for k in range(len(u) - 1):
        x[k + 1] = A @ x[k] + B @ u[k] + (0 if w is None else w[k])
    return x, x @ C.T + u @ D.T + (0 if v is None else v)


def received(y: Array, delays: list[int]) -> Array:
    """Return r [N+1, q], r[k, j] = y[k - tau_j, j]; nan before channel j's first arrival, at tick tau_j."""
    return np.array([[y[k - tau, j] if k >= tau else np.nan for j, tau in enumerate(delays)] for k in range(len(y))])


def shape(delays: list[int]) -> tuple[list[int], list[int], list[list[bool]]]:
    """Return theta_0 = 0 < ... < theta_q, the steps d_i and masks[i-1][j] = (tau_j <= theta_i) (page, "Chain")."""
    if min(delays) < 0 or max(delays) == 0:
        raise ValueError(f"delays {delays}: a chain needs delays >= 0, one of them positive")
    theta = [0, *sorted({tau for tau in delays if tau > 0})]
    steps = [b - a for a, b in pairwise(theta)]
    return theta, steps, [[tau <= end for tau in delays] for end in theta[1:]]


def companion(p: float, n: int) -> Array:
    """Return G [n, n] of Remark 1, (20), with the n-fold pole p: last column g, s^n - g_n s^{n-1} - ... - g_1."""
    G = np.eye(n, k=-1)
    G[:, -1] = -np.poly([p] * n)[:0:-1]
    return G


def luenberger(plant: Plant, d: int, T: Array, G: Array) -> tuple[Array, list[Array]]:
    """Return L and [H_0 .. H_{d-1}] of (8), square C: L C = T A^d - G T, H_i = T A^i B, the last one less L D."""
    A, B, C, D, _ = plant
    L = (T @ power(A, d) - G @ T) @ np.linalg.inv(C)
    H = [T @ power(A, i) @ B for i in range(d)]
    H[-1] = H[-1] - L @ D
    return L, H


def riccati(A: Array, C: Array, Q: Array, R: Array, d: int) -> Array:
    """Return K = A^d P C'(C P C' + R)^-1 (page, "Riccati gains"), P by iterating the Riccati map of (A^d, C)."""
    Ad = power(A, d)
    Qd = sum(power(A, j) @ Q @ power(A, j).T for j in range(d))
    P = Qd + np.diag(np.diag(Qd)) + 1e-12 * np.trace(Qd) * np.eye(len(A))
    for _ in range(20000):
        K = Ad @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        F = Ad - K @ C
        P, before = F @ P @ F.T + K @ R @ K.T + Qd, P
        if np.all(np.abs(P - before) <= 1e-15 * np.sqrt(np.outer(np.diag(P), np.diag(P)))):
            break
    return Ad @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)


def unseen(A: Array, C: Array, d: int, sx: Array | None = None, sy: Array | None = None) -> list[tuple[complex, Array]]:
    """Return (lambda, v) of the modes of A^d with |lambda| >= 1 - 1e-9 that C does not see (page, "Design").

    The least singular vector v of [A^d - lambda I; C] (Hautus), x scaled by sx, y by sy: so it is the worst
    combination where lambda is multiple (A = diag(1, -1), d = 2), not just the eigenvector some solver returns.
    """
    sx, sy = np.ones(len(A)) if sx is None else sx, np.ones(len(C)) if sy is None else sy
    Ad, Cs = power(A, d) / sx[:, None] * sx, C / sy[:, None] * sx
    found = []
    for lam in np.linalg.eigvals(Ad):
        _, sigma, Vh = np.linalg.svd(np.vstack([Ad - lam * np.eye(len(A)), Cs]))
        if abs(lam) >= 1 - 1e-9 and sigma[-1] < 1e-8:
            found.append((complex(lam), sx * Vh[-1].conj()))
    return found


def link(plant: Plant, d: int, mask: list[bool], K: Array, output: str = "updated") -> Link:
    """Return the link with gain K [n, q]: F = A^d - K C (8); `updated` V = C K or `deadbeat` V = C A^d C^+, W by (9)."""
    Ad, C = power(plant.A, d), plant.C
    V = {"updated": C @ K, "deadbeat": C @ Ad @ np.linalg.pinv(C)}[output]
    return Link(d, mask, Ad - K @ C, K, V, C @ Ad - V @ C)


def gain(plant: Plant, d: int, kind: str, p: float, Q: Array | None = None, R: Array | None = None) -> Array:
    """Return K [n, q] of one link (page, "Design"): `poles` (F = p I, or p (1, .9, .8, ..) placed), `companion`
    (T = C, so F = C^-1 G C) or `riccati`.
    """
    A, C = plant.A, plant.C
    if kind == "riccati":
        return riccati(A, C, Q, R, d)
    if len(C) == len(A) and kind == "companion":
        return np.linalg.solve(C, luenberger(plant, d, C, companion(p, len(A)))[0])
    if len(C) == len(A):
        return (power(A, d) - p * np.eye(len(A))) @ np.linalg.inv(C)
    return place_poles(power(A, d).T, C.T, p * (1 - 0.1 * np.arange(len(A)))).gain_matrix.T


def design(
    plant: Plant,
    delays: list[int],
    kind: str = "poles",
    output: str = "updated",
    pole: float = 1e-4,
    pole_per_tick: float | None = None,
    Q: Array | None = None,
    R: Array | None = None,
) -> list[Link]:
    """Return the links, link i for chain i + 1 (Algorithm 1); a link's pole is `pole` or `pole_per_tick` ** d_i."""
    links = []
    for d, mask in zip(*shape(delays)[1:], strict=True):
        p = pole if pole_per_tick is None else pole_per_tick**d
        links.append(link(plant, d, mask, gain(plant, d, kind, p, Q, R), output))
    return links


def chain(plant: Plant, links: list[Link], u: Array, r: Array, delays: list[int], xhat0: Array) -> Array:
    """Return xhat [N+1, n] of the chain (26), (27) in state coordinates (page, "The chain observer").

    X[i, t], Y[i, t] are link i's estimates of x(t), y(t), made at tick k = t + theta[i] from the source
    s = k - theta[i+1]; y_j(s) is read as r[s + tau_j, j], which is at hand: s + tau_j <= k where mask[j].
    Where s < 0 a link runs the model from xhat0 at t = 0. The estimate is xhat[k] = X[0, k].
    """
    A, B, C, D, _ = plant
    theta = shape(delays)[0]
    X = np.full((len(links), len(u), len(A)), np.nan)
    Y = np.full((len(links), len(u), len(C)), np.nan)
    for k in range(len(u)):
        for i in reversed(range(len(links))):
            d, mask, F, K, V, W = links[i]
            t, s = k - theta[i], k - theta[i + 1]
            if t < 0:
                continue
            if s < 0:
                X[i, t] = xhat0 if t == 0 else A @ X[i, t - 1] + B @ u[t - 1]
                Y[i, t] = C @ X[i, t] + D @ u[t]
                continue
            ybar = np.array([r[s + tau, j] if mask[j] else Y[i + 1, s, j] for j, tau in enumerate(delays)])
            lost = mask & np.isnan(ybar)  # never arrived: no correction from that channel
            ybar[lost] = (C @ X[i, s] + D @ u[s])[lost]
            pushed = sum(power(A, j) @ B @ u[t - 1 - j] for j in range(d))  # (15)
            X[i, t] = F @ X[i, s] + K @ (ybar - D @ u[s]) + pushed
            Y[i, t] = W @ X[i, s] + V @ (ybar - D @ u[s]) + C @ pushed + D @ u[t]  # Q_0 = D, Q_d less V D
    return X[0]


def theorem1(plant: Plant, u: Array, r: Array, xhat0: Array, K: Array, d: int = 2) -> Array:
    """Return xhat [N+1, n] of (6), which takes r(k) for y(k-d) (page, `equal-delay` `theorem1`).

    xhat(k) = A^d xhat(k-d) + sum_{j<d} A^j B u(k-1-j) + K e, e = r(k) - C xhat(k-d) - D u(k-d), e_j = 0 before
    channel j arrives; the model alone for k < d.
    """
    A, B, C, D, _ = plant
    xhat = np.zeros((len(u), len(A)))
    xhat[0] = xhat0
    for k in range(1, len(u)):
        back = min(d, k)
        e = np.nan_to_num(r[k] - C @ xhat[k - d] - D @ u[k - d]) if k >= d else np.zeros(len(C))
        xhat[k] = power(A, back) @ xhat[k - back] + sum(power(A, j) @ B @ u[k - 1 - j] for j in range(back)) + K @ e
    return xhat


def classic(plant: Plant, u: Array, r: Array, xhat0: Array, K: Array, ages: list[int]) -> Array:
    """Return xhat [N+1, n] of xhat(k+1) = A xhat(k) + B u(k) + K e(k) (page, "Comparison methods").

    e_j(k) = r_j(k) - C_j xhat(k - a_j) - D_j u(k - a_j), 0 before channel j arrives; before tick 0 xhat is xhat0 and
    u is 0. Ages a: [2, 2, ..] is `held`, K = (4/27) A C^-1; 0 is `plain`, tau is `aligned`, both K = (A - p I) C^-1.
    """
    A, B, C, D, _ = plant
    xhat = np.zeros((len(u), len(A)))
    xhat[0] = xhat0
    for k in range(len(u) - 1):
        e = np.zeros(len(C))
        for j, age in enumerate(ages):
            if not np.isnan(r[k, j]):
                e[j] = r[k, j] - C[j] @ xhat[max(k - age, 0)] - (D[j] @ u[k - age] if k >= age else 0)
        xhat[k + 1] = A @ xhat[k] + B @ u[k] + K @ e
    return xhat


def kalman(
    plant: Plant, u: Array, r: Array, delays: list[int], xhat0: Array, P0: Array, Q: Array, R: Array
) -> tuple[Array, Array]:
    """Return xhat [N+1, n], P [N+1, n, n] given all that arrived by tick k, prior N(xhat0, P0) at tick 0 (page, "kf").

    State: x(k), x(k-1), .., x(k - max tau), of which the blocks before tick 0 are never read. R [q, q] diagonal.
    """
    A, B, C, D, _ = plant
    n, long = len(A), max(delays) + 1
    shift = np.eye(n * long, k=-n)
    shift[:n, :n] = A
    z, S = np.zeros(n * long), np.zeros((n * long, n * long))
    z[:n], S[:n, :n] = xhat0, P0
    xhat, P = np.zeros((len(u), n)), np.zeros((len(u), n, n))
    for k in range(len(u)):
        if k > 0:
            z, S = shift @ z, shift @ S @ shift.T
            z[:n] += B @ u[k - 1]
            S[:n, :n] += Q
        for j, tau in enumerate(delays):
            if k >= tau:
                row = np.zeros(n * long)
                row[n * tau : n * tau + n] = C[j]
                g = S @ row / (row @ S @ row + R[j, j])
                z = z + g * (r[k, j] - row @ z - D[j] @ u[k - tau])
                rest = np.eye(n * long) - np.outer(g, row)
                S = rest @ S @ rest.T + R[j, j] * np.outer(g, g)
        xhat[k], P[k] = z[:n], S[:n, :n]
    return xhat, P


def radius(M: Array) -> float:
    """Return the spectral radius of M."""
    return float(np.abs(np.linalg.eigvals(M)).max())


def delayed_jacobian(terms: dict[int, Array]) -> Array:
    """Return the one-tick matrix of x(k+1) = sum_d terms[d] x(k-d) in (x(k), x(k-1), ..): (21) as one matrix."""
    n, long = len(next(iter(terms.values()))), max(terms) + 1
    M = np.eye(n * long, k=-n)
    for d, block in terms.items():
        M[:n, n * d : n * d + n] += block
    return M


def theorem2(A0: Array, others: list[Array], P: Array) -> float:
    """Return the largest eigenvalue of the matrix of (22): below 0 is the paper's certificate for (21)."""
    N, norms = len(others), [np.linalg.norm(M, 2) for M in others]
    eps = np.sqrt(N * sum(a * a for a in norms)) / np.linalg.norm(A0, 2)
    M = (1 + eps) * A0.T @ P @ A0 + N * (1 + eps) / eps * sum(Aj.T @ P @ Aj for Aj in others) - P
    return float(np.linalg.eigvalsh(M).max())


def jacobian(plant: Plant, links: list[Link], noise: bool = False) -> Array:
    """Return the error's matrix of one tick, [n theta_q, n theta_q], column by column: (18), (A32) in shift coordinates.

    Before tick k, row g of E [theta_q, n] is x - xhat_i at tick k-1-g, link i being the one with
    theta[i] <= g < theta[i+1]. With `noise` the state goes on with w(k-1) .. w(k-theta_q) and v(k) .. v(k-theta_q).
    """
    n, q = len(plant.A), len(plant.C)
    theta = np.cumsum([0, *[one.d for one in links]])
    errors, size = n * theta[-1], 2 * n * theta[-1] + q * (theta[-1] + 1)

    def step(z: Array) -> Array:
        E, w = z[:errors].reshape(-1, n), z[errors : 2 * errors].reshape(-1, n)
        v = z[2 * errors :].reshape(-1, q)
        after, eps = np.vstack([np.zeros(n), E[:-1]]), np.zeros(q)
        for i in reversed(range(len(links))):
            d, mask, F, K, V, W = links[i]
            old = E[theta[i + 1] - 1]  # at the source s = k - theta[i+1]
            miss = np.where(mask, -v[theta[i + 1]], eps)  # C x(s) + D u(s) - ybar(s)
            pushed = sum(power(plant.A, j) @ w[theta[i] + j] for j in range(d))
            after[theta[i]] = F @ old + K @ miss + pushed
            eps = W @ old + V @ miss + plant.C @ pushed  # C x + D u - yhat_i at the stamp, (19)
        later = [np.vstack([np.zeros(a.shape[1]), a[:-1]]).ravel() for a in (w, v)]
        return np.concatenate([after.ravel(), *later])

    M = np.column_stack([step(z) for z in np.eye(size)])
    return M if noise else M[:errors, :errors]


def stationary(plant: Plant, links: list[Link], Q: Array, R: Array) -> Array:
    """Return the error covariance [n, n] of xhat[k], k to infinity: S = M S M' + N, N = diag(.., Q, .., R, ..)."""
    n, q = len(plant.A), len(plant.C)
    M = jacobian(plant, links, noise=True)
    w = n * sum(one.d for one in links)
    S = np.zeros_like(M)
    S[w : w + n, w : w + n] = Q
    S[2 * w : 2 * w + q, 2 * w : 2 * w + q] = R
    while np.abs(M).max() > 1e-200:  # doubling: S is the sum of M^i N M'^i over ever more i
        S, M = S + M @ S @ M.T, M @ M
    return S[:n, :n]
