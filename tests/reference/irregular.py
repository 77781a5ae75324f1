"""Observers of a linear plant for samples at any times: jittered, lost, together or out of order, the long way.

Plant:  x' = A x + B u,  u held over a tick of h seconds,  y_j = C[j] x + D[j] u + v  at the samples of channel j.
Source: Li, Wang, Tian, "PI Piecewise Continuous Observer Design for Sampled and Delayed Linear Systems with
Variable Sampling Time Period"; its equations in brackets. pccebo and kf as in `linear`.

Times are ticks, the order of events is that of `linear`: xhat[k] is the value after the arrivals of tick k and
depends on u[0] .. u[k-1] only. D alone reads u at the sampling tick itself: the input held from that tick on.

One rule gives every observer its meaning for every order: whenever something arrives, all samples at hand are
sorted by (tick taken, channel) and the chain is recomputed from tick 0 as if they had come in that order; then
x is predicted from the newest sample's tick to now. With no sample: open loop from xhat(0).

Differs from print: (12)-(15) are written there with y_i, which has not arrived at t_i; here i counts the
samples at hand, so that step i uses y_i and y_{i-1}. L_{t-1} in (12), (15) is L_{i-1}.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_discrete_lyapunov

from .linear import Model, Sample, by_arrival, discretise, held_response, joseph_update, powers, process_noise

Array = np.ndarray
Estimate = tuple[int, Array]  # sampling tick, estimate of x [n] there


class Flow(NamedTuple):
    """What crosses j = 0 .. N ticks: Phi [N+1, n, n] = e^{A j h}, response [N+1, n, m] = e^{A j h} Bd; u [N+1, m]."""

    Phi: Array
    response: Array
    u: Array


class Memory(NamedTuple):
    """PI-PCO after the sample of tick `taken`: y [l] as received, w [n-l] the unmeasured part, L [n-l]."""

    taken: int
    y: Array
    w: Array
    L: Array


def profile(period: int, count: int) -> list[int]:
    """Return the intervals T_1 .. T_count [ticks]: T_i = max(1, round(period (1 + 0.5 sin(0.6 i))))."""
    return [max(1, round(period * (1 + 0.5 * np.sin(0.6 * i)))) for i in range(1, count + 1)]


def late_by_one(intervals: list[int]) -> list[tuple[int, int]]:
    """Return (taken, arrival) of samples 0, 1, ...: sample i-1 is taken at t_{i-1}, arrives at t_i = t_{i-1} + T_i."""
    times, t = [], 0
    for T in intervals:
        times.append((t, t + T))
        t += T
    return times


def simulate(
    model: Model,
    u: Array,
    x0: Array,
    times: list[list[tuple[int, int | None]]],
    noise: list[Array] | None = None,
    D: Array | None = None,
    plant_step: Callable[[int, Array, Array], Array] | None = None,
) -> tuple[Array, list[Sample]]:
    """Run the plant and its irregular sampler; return x [N+1, n] and the samples which arrive by tick N.

    u [N+1, m]; times[j][i]: (taken, arrival) of sample i of channel j, arrival None if it is lost;
    noise[j][i] is added to it, lost or not (None: noise off); D [q, m]: feedthrough of the applied u.
    `plant_step(k, x, u_k)` replaces the exact step from tick k to k + 1. Samples: by arrival, oldest first.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    N = len(u) - 1
    x = np.zeros((N + 1, len(Ad)))
    x[0] = x0
    for k in range(N):
        x[k + 1] = Ad @ x[k] + Bd @ u[k] if plant_step is None else plant_step(k, x[k], u[k])
    samples = []
    for j, channel in enumerate(times):
        for i, (taken, arrival) in enumerate(channel):
            if arrival is None or arrival > N:
                continue
            if not 0 <= taken <= arrival:
                raise ValueError(
                    f"channel {j}, sample {i}: taken at {taken}, arrives at {arrival}; want 0 <= taken <= it"
                )
            y = model.C[j] @ x[taken] + (0.0 if D is None else D[j] @ u[taken])
            samples.append(Sample(arrival, taken, j, i, y + (0.0 if noise is None else noise[j][i])))
    return x, sorted(samples)


def flow_of(model: Model, u: Array) -> Flow:
    """Return what `advance` needs, for every span of 0 .. N ticks."""
    Ad, Bd = discretise(model.A, model.B, model.h)
    Phi = powers(Ad, len(u))
    return Flow(Phi, Phi @ Bd, u)


def advance(flow: Flow, x: Array, a: int, b: int) -> Array:
    """Return x [n] at tick b from x at tick a <= b: e^{A(b-a)} x + I(a, b)."""
    return flow.Phi[b - a] @ x + held_response(flow.response, flow.u, a, b)


def in_taken_order(samples: Iterable[Sample], u: Array, D: Array | None) -> list[Sample]:
    """Return the samples by (tick taken, channel), their values freed of the feedthrough D[j] u(taken)."""
    ordered = sorted(samples, key=lambda sample: (sample.taken, sample.channel))
    if D is None:
        return ordered
    return [s._replace(value=s.value - D[s.channel] @ u[s.taken]) for s in ordered]


def whole_vectors(ordered: list[Sample], q: int) -> list[tuple[int, Array]]:
    """Return (sampling tick, y [q]), one for each instant; ValueError where a channel of an instant is missing."""
    channels: dict[int, dict[int, float]] = {}
    for sample in ordered:
        channels.setdefault(sample.taken, {})[sample.channel] = sample.value
    for taken, y in channels.items():
        if sorted(y) != list(range(q)):
            raise ValueError(f"sampled at tick {taken}: channels {sorted(y)} are here, not all {q} at once")
    return [(taken, np.array([y[j] for j in range(q)])) for taken, y in channels.items()]


def run(flow: Flow, samples: list[Sample], xhat0: Array, newest: Callable[[list[Sample]], Estimate]) -> Array:
    """Return xhat [N+1, n]: predicted to every tick from the newest sample at hand, whatever came last.

    `newest(at_hand)` recomputes the chain from tick 0 and returns its last (tick, estimate at that tick).
    """
    inbox = by_arrival(samples)
    at_hand: list[Sample] = []
    taken, x = 0, np.asarray(xhat0, float)
    xhat = np.zeros((len(flow.u), len(x)))
    for k in range(len(flow.u)):
        if k in inbox:
            at_hand += inbox[k]
            taken, x = newest(at_hand)
        xhat[k] = advance(flow, x, taken, k)  # (18) and (19) in one
    return xhat


def pccebo_chain(flow: Flow, C: Array, vectors: list[tuple[int, Array]], xhat0: Array, L: Array) -> list[Estimate]:
    """Return the estimate after each vector in taken order: xbar_i = prediction, xhat_i = xbar_i + L (y_i - C xbar_i)."""
    chain: list[Estimate] = []
    at, x = 0, np.asarray(xhat0, float)
    for taken, y in vectors:
        xbar = advance(flow, x, at, taken)
        at, x = taken, xbar + L @ (y - C @ xbar)
        chain.append((at, x))
    return chain


def pccebo(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array, D: Array | None = None) -> Array:
    """Return xhat [N+1, n] of the piecewise continuous current-estimator observer, L [n, q], D [q, m].

    All channels of one instant arrive together, or ValueError. L is the same at every interval.
    """
    flow = flow_of(model, u)

    def newest(at_hand: list[Sample]) -> Estimate:
        vectors = whole_vectors(in_taken_order(at_hand, u, D), len(model.C))
        return pccebo_chain(flow, model.C, vectors, xhat0, L)[-1]

    return run(flow, samples, xhat0, newest)


def with_input_bias(model: Model, D: Array | None) -> Model:
    """Return the plant with state [x; bias]: x' = A x + B (u + bias), bias' = 0, y = C x + D (u + bias)."""
    n, m = model.B.shape
    A = np.block([[model.A, model.B], [np.zeros((m, n + m))]])
    B = np.vstack([model.B, np.zeros((m, m))])
    return Model(A, B, np.hstack([model.C, np.zeros((len(model.C), m)) if D is None else D]), model.h)


def noise_sums(Ad: Array, Qd: Array, count: int) -> Array:
    """Return the covariance [count, n, n] that 0, 1, 2, ... ticks of process noise add, tick by tick."""
    out = [np.zeros_like(Qd)]
    for _ in range(count - 1):
        out.append(Ad @ out[-1] @ Ad.T + Qd)
    return np.stack(out)


def kf_chain(
    flow: Flow, C: Array, ordered: list[Sample], xhat0: Array, P0: Array, R: Array, added: Array
) -> list[Estimate]:
    """Return the Kalman estimate after each scalar sample in taken order; added [N+1, n, n] of `noise_sums`."""
    chain: list[Estimate] = []
    at, x, P = 0, np.asarray(xhat0, float), np.asarray(P0, float)
    for sample in ordered:
        Phi = flow.Phi[sample.taken - at]
        x = advance(flow, x, at, sample.taken)
        P = Phi @ P @ Phi.T + added[sample.taken - at]
        x, P = joseph_update(x, P, C[sample.channel], sample.value, R[sample.channel])
        at = sample.taken
        chain.append((at, x))
    return chain


def kf(
    model: Model,
    u: Array,
    samples: list[Sample],
    xhat0: Array,
    P0: Array,
    R: Array,
    W: Array | None = None,
    bias_variance: float | None = None,
    D: Array | None = None,
) -> Array:
    """Return xhat [N+1, n] of the delay-compensated Kalman filter with prior N(xhat0, P0 [n, n]) at tick 0.

    R [q]: variances per sample; W [n, n]: intensity of the process noise (None: none); D [q, m] of the known u.
    `bias_variance`: of a constant unknown input bias, prior mean 0, one for each input, independent of x(0);
    u + bias drives the plant and its feedthrough D, and the plant's n states alone are returned.
    """
    n, m = model.B.shape
    W = np.zeros((n, n)) if W is None else W
    start, prior = np.asarray(xhat0, float), np.asarray(P0, float)
    if bias_variance is not None:
        model = with_input_bias(model, D)
        W = block_diag(W, np.zeros((m, m)))
        start, prior = np.concatenate([start, np.zeros(m)]), block_diag(prior, bias_variance * np.eye(m))
    flow = flow_of(model, u)
    Ad, _ = discretise(model.A, model.B, model.h)
    added = noise_sums(Ad, process_noise(model.A, W, model.h), len(u))

    def newest(at_hand: list[Sample]) -> Estimate:
        return kf_chain(flow, model.C, in_taken_order(at_hand, u, D), start, prior, R, added)[-1]

    return run(flow, samples, start, newest)[:, :n]


class Blocks(NamedTuple):
    """One interval in z = T x = [y; w]: T e^{A gap} inv(T) (4) and T I(a, b) = [m1; m2] (2), partitioned at l."""

    A11: Array
    A12: Array
    A21: Array
    A22: Array
    m1: Array
    m2: Array


def blocks(flow: Flow, T: Array, l: int, a: int, b: int) -> Blocks:
    """Return the blocks of the interval from tick a to tick b."""
    Ad = T @ flow.Phi[b - a] @ np.linalg.inv(T)
    M = T @ held_response(flow.response, flow.u, a, b)
    return Blocks(Ad[:l, :l], Ad[:l, l:], Ad[l:, :l], Ad[l:, l:], M[:l], M[l:])


def check_coordinates(C: Array, T: Array) -> None:
    """Raise ValueError unless C inv(T) = [I 0], to 1e-9."""
    l, n = C.shape
    if not np.allclose(C @ np.linalg.inv(T), np.eye(l, n), rtol=0, atol=1e-9):
        raise ValueError("C inv(T) is not [I 0]: let the first rows of T be C")


def first_unmeasured(flow: Flow, T: Array, l: int, taken: int, xhat0: Array) -> Array:
    """Return w [n-l] at the first sample, which corrects nothing: of T (e^{A taken} xhat(0) + I(0, taken))."""
    return (T @ advance(flow, np.asarray(xhat0, float), 0, taken))[l:]


def pco_chain(
    flow: Flow, vectors: list[tuple[int, Array]], xhat0: Array, T: Array, Kp: Array, Ki: Array | None
) -> list[Memory]:
    """Return the memory after each vector in taken order; Kp, Ki [n-l, l] (Ki None: PCO, L stays 0)."""
    l = Kp.shape[1]
    taken, y = vectors[0]
    chain = [Memory(taken, y, first_unmeasured(flow, T, l, taken, xhat0), np.zeros(len(T) - l))]
    for taken, y in vectors[1:]:
        before = chain[-1]
        gap = blocks(flow, T, l, before.taken, taken)
        nu = y - gap.A11 @ before.y - gap.m1 - gap.A12 @ before.w  # Z - Zhat of (8), (13)
        w = gap.A22 @ before.w + gap.A21 @ before.y + gap.m2 + Kp @ nu + before.L  # (12)
        L = before.L if Ki is None else before.L + Ki @ nu  # (14)
        chain.append(Memory(taken, y, w, L))
    return chain


def estimate_of(memory: Memory, T: Array) -> Estimate:
    """Return (tick, inv(T) [y; w])."""
    return memory.taken, np.linalg.inv(T) @ np.concatenate([memory.y, memory.w])


def pco(
    model: Model,
    u: Array,
    samples: list[Sample],
    xhat0: Array,
    T: Array,
    Kp: Array,
    Ki: Array | None = None,
    D: Array | None = None,
) -> Array:
    """Return xhat [N+1, n] of PCO, or of PI-PCO where Ki is given; Kp, Ki [n-l, l], D [l, m].

    T [n, n] with C inv(T) = [I_l 0]: z = T x = [y; w]. All channels of one instant arrive together, or ValueError.
    """
    flow = flow_of(model, u)
    check_coordinates(model.C, T)

    def newest(at_hand: list[Sample]) -> Estimate:
        vectors = whole_vectors(in_taken_order(at_hand, u, D), len(model.C))
        return estimate_of(pco_chain(flow, vectors, xhat0, T, Kp, Ki)[-1], T)

    return run(flow, samples, xhat0, newest)


def pco_theta(
    model: Model,
    u: Array,
    samples: list[Sample],
    xhat0: Array,
    T: Array,
    Kp: Array,
    Ki: Array | None = None,
    D: Array | None = None,
) -> Array:
    """Return xhat [N+1, n] as `pco` does, by the theta form (15)-(17) and from tick to tick; in order only.

    theta_i = w_i - Kp y_i is held together with the last y and L. ValueError where an older sample follows.
    """
    flow = flow_of(model, u)
    check_coordinates(model.C, T)
    l, n = model.C.shape
    inbox = by_arrival(samples)
    last: tuple[int, Array, Array, Array] | None = None  # taken, y, theta, L
    xhat = np.zeros((len(u), n))
    xhat[0] = xhat0
    for k in range(len(u)):
        for taken, y in whole_vectors(in_taken_order(inbox.get(k, []), u, D), l):
            if last is None:
                theta = first_unmeasured(flow, T, l, taken, xhat0) - Kp @ y
                last = (taken, y, theta, np.zeros(n - l))
                continue
            at, y_old, theta, L = last
            if taken <= at:
                raise ValueError(f"sample of tick {taken} came after that of {at}: the theta form is in order only")
            gap = blocks(flow, T, l, at, taken)
            F = gap.A22 - Kp @ gap.A12  # (16)
            G = F @ Kp + gap.A21 - Kp @ gap.A11  # (17)
            nu = y - gap.A11 @ y_old - gap.m1 - gap.A12 @ (theta + Kp @ y_old)
            theta = F @ theta + G @ y_old + (gap.m2 - Kp @ gap.m1) + L  # (15), with the old L
            last = (taken, y, theta, L if Ki is None else L + Ki @ nu)  # (14)
        if inbox.get(k) and last is not None:
            taken, y, theta, _ = last
            xhat[k] = advance(flow, np.linalg.inv(T) @ np.concatenate([y, theta + Kp @ y]), taken, k)  # (18)
        elif k > 0:
            xhat[k] = advance(flow, xhat[k - 1], k - 1, k)  # (19)
    return xhat


def stationary_variance(F: float, k: float = 0.0) -> float:
    """Return var r / sigma^2 of the position error r, A22 = 0 and A12 constant: PCO at k = 0, else PI-PCO.

    k = Ki A12, F = -Kp A12; inside k > 0, F + k < 1, 2 + 2 F + k > 0, or k = 0 and |F| < 1. White noise.
    """
    if k == 0:
        return (1 - F) / (1 + F)
    return (2 * F**2 + 3 * F * k - 4 * F + k**2 - k + 2) / ((1 - F - k) * (2 * F + k + 2))


def stationary_variance_by_lyapunov(F: float, k: float = 0.0) -> float:
    """Return the same number from S = J S J' + b b', the Lyapunov equation of s_i = [r_i; l_i] = J s_{i-1} + b v_i.

    1. With A11 = 1, A21 = A22 = 0, e_w = w - w^ and r_i = A12 e_w,i - v_i, l_i = A12 L_i:
       nu_i = v_i - v_{i-1} + A12 e_w,i-1 = v_i + r_{i-1}   (the old noise is inside r_{i-1}).
    2. e_w,i = -Kp nu_i - L_{i-1}, so r_i = F nu_i - l_{i-1} - v_i = F r_{i-1} - l_{i-1} - (1 - F) v_i.
    3. l_i = l_{i-1} + k nu_i = l_{i-1} + k (r_{i-1} + v_i).
    4. s_{i-1} depends on v_{i-1}, v_{i-2}, ... only, so v_i is independent of it; but r_{i-1} and l_{i-1} are
       correlated, and the one v_i drives both: b b' is full.
    """
    if k == 0:  # l stays 0; the pair has an eigenvalue 1 which nothing drives
        J, b = np.array([[F]]), np.array([[-(1 - F)]])
    else:
        J, b = np.array([[F, -1.0], [k, 1.0]]), np.array([[-(1 - F)], [k]])
    return float(solve_discrete_lyapunov(J, b @ b.T)[0, 0])
