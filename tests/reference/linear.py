"""Observers of a linear plant under sampled and late measurements, written out the long way.

Plant:  x' = A x + B u,  u held over a tick of h seconds,  y_j = C[j] x + v  at the samples of channel j.
Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017) 3738-3751; its equations in brackets.

Times are ticks. At tick k: sense, deliver (jump), read xhat[k], then hold u[k] until tick k + 1.
So xhat[k] is the value after the jump at k and depends on u[0] .. u[k-1] only; u[N] is never used.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

Array = np.ndarray


class Model(NamedTuple):
    """A linear plant: A [n, n], B [n, m], C [q, n], tick h [s]."""

    A: Array
    B: Array
    C: Array
    h: float


class Sample(NamedTuple):
    """One measurement of one channel: sampled at tick `taken`, at hand from tick `arrival` on."""

    arrival: int
    taken: int
    channel: int
    index: int
    value: float


def discretise(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Return e^{Ah} [n, n] and int_0^h e^{As} ds B [n, m], exactly; A may be singular."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = A
    block[:n, n:] = B
    E = expm(block * h)
    return E[:n, :n], E[:n, n:]


def process_noise(A: Array, W: Array, h: float) -> Array:
    """Return int_0^h e^{As} W e^{A's} ds [n, n] (Van Loan; for short h only, it forms e^{-Ah})."""
    n = len(A)
    E = expm(np.block([[-A, W], [np.zeros((n, n)), A.T]]) * h)
    return E[n:, n:].T @ E[:n, n:]


def powers(M: Array, count: int) -> Array:
    """Return I, M, M^2, ... as [count, n, n]."""
    out = [np.eye(len(M))]
    for _ in range(count - 1):
        out.append(M @ out[-1])
    return np.stack(out)


def held_response(response: Array, u: Array, a: int, b: int) -> Array:
    """Return I(a, b) = int_a^b e^{A(b-s)} B u(s) ds [n] under the held input: a sum over the ticks a .. b-1.

    response [N+1, n, m]: e^{A j h} Bd, what is left of a tick's input j ticks after that tick has passed.
    """
    return np.einsum("jnm,jm->n", response[: b - a][::-1], u[a:b])


def simulate(
    model: Model,
    u: Array,
    x0: Array,
    te: list[int],
    d: list[int],
    noise: list[Array] | None = None,
    plant_step: Callable[[int, Array, Array], Array] | None = None,
) -> tuple[Array, list[Sample]]:
    """Run the plant and its delayed sampler; return x [N+1, n] and the samples which arrive by tick N.

    u [N+1, m]; te, d: period and delay of each channel [ticks]; noise[j][i]: added to sample i of channel j.
    `plant_step(k, x, u_k)` replaces the exact step from tick k to k + 1. Samples: by arrival, oldest first.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    N = len(u) - 1
    x = np.zeros((N + 1, len(Ad)))
    x[0] = x0
    for k in range(N):
        x[k + 1] = Ad @ x[k] + Bd @ u[k] if plant_step is None else plant_step(k, x[k], u[k])
    samples = []
    for j in range(len(model.C)):
        for i, taken in enumerate(range(0, N + 1, te[j])):
            if taken + d[j] <= N:
                v = 0.0 if noise is None else noise[j][i]
                samples.append(Sample(taken + d[j], taken, j, i, model.C[j] @ x[taken] + v))
    return x, sorted(samples)


def by_arrival(samples: list[Sample]) -> dict[int, list[Sample]]:
    """Return the samples which arrive at each tick, oldest sampling instant first, then by channel."""
    inbox: dict[int, list[Sample]] = {}
    for sample in sorted(samples):
        inbox.setdefault(sample.arrival, []).append(sample)
    return inbox


def whole_vectors(arrived: list[Sample], q: int) -> list[tuple[int, Array]]:
    """Return (sampling tick, y [q]) of what arrived at one tick; an instant's channels come together."""
    vectors = []
    for taken in sorted({sample.taken for sample in arrived}):
        y = {sample.channel: sample.value for sample in arrived if sample.taken == taken}
        if sorted(y) != list(range(q)):
            raise ValueError(f"sampled at tick {taken}: channels {sorted(y)} arrived, not all {q} at once")
        vectors.append((taken, np.array([y[j] for j in range(q)])))
    return vectors


def model_only(model: Model, u: Array, xhat0: Array) -> Array:
    """Return xhat [N+1, n] of the model alone: e^{At} xhat(0) + I(0, t)."""
    Ad, Bd = discretise(model.A, model.B, model.h)
    xhat = [np.asarray(xhat0, float)]
    for k in range(len(u) - 1):
        xhat.append(Ad @ xhat[-1] + Bd @ u[k])
    return np.stack(xhat)


def pccebo(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] of the piecewise continuous current-estimator observer, L [n, q].

    All channels share sampling instants and delay; the delay is any number of ticks. Nothing is carried from
    tick to tick but the list of (t_m, xhat_m) and the last restart (t_i, xhat(t_i)).
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    Phi = powers(Ad, len(u))
    response = Phi @ Bd
    inbox = by_arrival(samples)
    corrected: list[tuple[int, Array]] = []
    restart, xhat_restart = 0, np.asarray(xhat0, float)
    xhat = np.zeros((len(u), len(Ad)))
    for k in range(len(u)):
        for t_m, y in whole_vectors(inbox.get(k, []), len(model.C)):
            t_before, xhat_before = corrected[-1] if corrected else (0, np.asarray(xhat0, float))
            xbar = Phi[t_m - t_before] @ xhat_before + held_response(response, u, t_before, t_m)  # (8a)
            corrected.append((t_m, xbar + L @ (y - model.C @ xbar)))  # (8b)
            restart = k
            xhat_restart = Phi[k - t_m] @ corrected[-1][1] + held_response(response, u, t_m, k)  # (11)
        xhat[k] = Phi[k - restart] @ xhat_restart + held_response(response, u, restart, k)  # (12)
    return xhat


def kfbo(
    model: Model,
    u: Array,
    samples: list[Sample],
    xhat0: Array,
    K: Array,
    te: int,
    d: int,
    *,
    lag_aware: bool = False,
    sampled_innovation: bool = False,
) -> Array:
    """Return xhat [N+1, n] of the Kalman-filter-based observer (25), (28), (29), K [n, q]; te, d [ticks].

    z(t) estimates x(t - lag), lag = d, or d + te/2 if `lag_aware`; it stands at xhat(0) until tick lag.
    It is driven by the held sample Y, or by the innovation Y_i - C z(t_i) held if `sampled_innovation`.
    """
    if lag_aware and sampled_innovation:
        raise ValueError("lag_aware makes up for the hold of Y, sampled_innovation holds no Y: choose one")
    if lag_aware and te % 2:
        raise ValueError(f"lag_aware shifts by te/2, which must be whole ticks: got te = {te}, use an even te")
    A, B, C, h = model
    lag = d + te // 2 if lag_aware else d
    Ad, Bd = discretise(A, B, h)
    Fz, Gz = discretise(A if sampled_innovation else A - K @ C, np.hstack([B, K]), h)
    g = np.zeros((len(u), len(A)))
    for k in range(len(u) - 1):
        g[k + 1] = Ad @ g[k] + Bd @ u[k]  # (28)
    across = [expm(A * (j * h)) for j in range(lag + 1)]
    inbox = by_arrival(samples)
    z = np.asarray(xhat0, float)
    held = np.zeros(len(C))
    xhat = np.zeros((len(u), len(A)))
    for k in range(len(u)):
        for _, y in whole_vectors(inbox.get(k, []), len(C)):
            held = y - C @ z if sampled_innovation else y
        xhat[k] = g[k] + across[min(k, lag)] @ (z - g[max(k - lag, 0)])  # (29)
        if k >= lag:
            z = Fz @ z + Gz @ np.concatenate([u[k - lag], held])  # (25)
    return xhat


def joseph_update(x: Array, P: Array, c: Array, y: float, R: float) -> tuple[Array, Array]:
    """Return mean [n] and covariance [n, n] after the scalar measurement y = c x + v, var v = R."""
    gain = P @ c / (c @ P @ c + R)
    rest = np.eye(len(x)) - np.outer(gain, c)
    return x + gain * (y - c @ x), rest @ P @ rest.T + R * np.outer(gain, gain)


def kf(
    model: Model, u: Array, samples: list[Sample], xhat0: Array, P0: Array, R: Array, W: Array | None = None
) -> Array:
    """Return xhat [N+1, n] of the delay-compensated Kalman filter with prior N(xhat0, P0) at tick 0.

    Each sample updates at its own sampling tick when it arrives. R [q]: variances per sample; W [n, n]:
    intensity of the process noise (None: none), added tick by tick. ValueError where an older sample follows.
    """
    A, B, C, h = model
    Ad, Bd = discretise(A, B, h)
    Phi = powers(Ad, len(u))
    response = Phi @ Bd
    Qd = np.zeros_like(A) if W is None else process_noise(A, W, h)
    inbox = by_arrival(samples)
    at, x, P = 0, np.asarray(xhat0, float), np.asarray(P0, float)  # estimate of x at tick `at`
    xhat = np.zeros((len(u), len(A)))
    for k in range(len(u)):
        for sample in inbox.get(k, []):
            if sample.taken < at:
                raise ValueError(f"sample of tick {sample.taken} came after that of {at}: not supported")
            x = Phi[sample.taken - at] @ x + held_response(response, u, at, sample.taken)
            for _ in range(sample.taken - at):
                P = Ad @ P @ Ad.T + Qd
            x, P = joseph_update(x, P, C[sample.channel], sample.value, R[sample.channel])
            at = sample.taken
        xhat[k] = Phi[k - at] @ x + held_response(response, u, at, k)
    return xhat
