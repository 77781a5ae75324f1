"""Riccati equations: the stationary one of the KFBO, and the covariance recursion that bounds every causal estimator.

    A P + P A' - P C' R^-1 C P + Q = 0,   K = P C' R^-1                                      (27), (26)

(26) is printed K = P C' R, but the printed gains need R^-1. The printed Q = 0.001 I does not give them either: the process
noise acts through the input, Q = 0.002 B B'. Source: Mohammed et al. 2017, section 5.

`nearest_scale` returns units of 1000^k (k whole) for an LMI, because its solution depends on the units of the states.
"""

from bisect import bisect
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_continuous_are, solve_discrete_are

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix, Model
from pcbench.errors import DesignError, first_sentence
from pcbench.synthesis.certificate import Certificate, DesignContext, least_eigenvalue
from pcbench.value_cache import cached_by_value


class Stationary(NamedTuple):
    """A stationary Kalman filter in continuous time."""

    P: Matrix  # [n, n]
    K: Matrix  # [n, q]
    certificate: Certificate


@cached_by_value
def continuous(model: Model, Q: Matrix, R: Matrix, where: str) -> Stationary:
    """Solve (27) for P and K; the margin is minus the largest real part of the poles of A - K C, NaN unless P solves (27)."""
    A, C = model.A, model.C
    try:
        P: Matrix = np.asarray(solve_continuous_are(A.T, C.T, Q, R), dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"{where}: the Riccati equation (27) was not solved (SciPy reported '{first_sentence(error)}'), "
            "expected (A, C) detectable and Q, R positive; change Q, R or the outputs."
        ) from error
    K: Matrix = np.asarray(np.linalg.solve(R, C @ P).T, dtype=np.float64)
    residual = A @ P + P @ A.T - P @ C.T @ K.T + Q
    scale = max(np.abs(A @ P).max() + np.abs(Q).max(), 1e-300)
    is_solution = least_eigenvalue(P) > 0 and np.abs(residual).max() < 1e-9 * scale
    poles = np.linalg.eigvals(A - K @ C)
    margin = float(-poles.real.max()) if is_solution else float("nan")
    numbers = {"P": P, "K": K, "poles": poles, "relative_residual": float(np.abs(residual).max() / scale)}
    return Stationary(P, K, Certificate("A - K C Hurwitz, (27) solved", margin, "scipy", "solved", numbers, margin))


def current_gain(Phi: Matrix, C: Matrix, Q: Matrix, R: Matrix, where: str) -> Matrix:
    """Return L [n, q] of the stationary Kalman filter as a current estimator, xhat = xbar + L (y - C xbar)."""
    try:
        P = solve_discrete_are(Phi.T, C.T, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"{where}: the discrete Riccati equation was not solved (SciPy reported '{first_sentence(error)}'), "
            "expected (Phi, C) detectable and Q, R positive; change Q, R or the outputs."
        ) from error
    return np.asarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T, dtype=np.float64)


def update(P: Matrix, C: Matrix, R: Matrix) -> Matrix:
    """Return the posterior covariance (Joseph form) after a measurement y = C x + v, v ~ N(0, R)."""
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    I_KC = np.eye(len(P)) - K @ C
    return I_KC @ P @ I_KC.T + K @ R @ K.T


def _over(binary_maps: Matrix, noise: Matrix, ticks: int) -> tuple[Matrix, Matrix]:
    """Return the map over some ticks, and the covariance that process noise adds."""
    return linear.over(binary_maps, ticks), linear.noise_over(binary_maps, noise, ticks)


class CovarianceRun(NamedTuple):
    """Results of a covariance recursion over a horizon."""

    P: Matrix  # [n, n] after the last update
    K: Matrix  # [n, q] the last gain of each channel
    innovation: float  # the least c P c' + r over all updates, relative to the least r
    least: float  # the least eigenvalue of any P, relative to its largest entry


@cached_by_value
def multirate(
    binary_maps: Matrix, noise: Matrix, C: Matrix, R: Matrix, P0: Matrix, period: tuple[int, ...], ticks: int
) -> CovarianceRun:
    """Run the covariance over a horizon: channel j with noise variance R[j] is sampled every period[j] ticks from 0 on.

    The result is cached, because observers and grid points of one study share it.
    """
    P, last_tick, K = P0, 0, np.zeros((len(P0), len(C)))
    over = cache(lambda gap: _over(binary_maps, noise, gap))  # gaps repeat
    innovation, least = np.inf, np.inf
    for tick in sorted({t for interval in period for t in range(0, ticks + 1, interval)}):
        E, Q = over(tick - last_tick)
        P, last_tick = E @ P @ E.T + Q, tick
        for j in [j for j, interval in enumerate(period) if tick % interval == 0]:
            c, r = C[j : j + 1], R[j : j + 1, None]
            innovation = min(innovation, float((c @ P @ c.T + r)[0, 0]) / R.min())
            K[:, j] = (P @ c.T)[:, 0] / (c @ P @ c.T + r)[0, 0]
            P = update(P, c, r)
        least = min(least, least_eigenvalue(P) / max(np.abs(P).max(), 1e-300))
    return CovarianceRun(P, K, innovation, least)


ChannelSample = tuple[int, int]  # a sample: the tick at which it is taken, its channel
Stage = tuple[int, Matrix]  # a tick and a root S of the covariance there, P = S S'
UpdateRoot = Callable[[Matrix, int, int], Matrix]  # (S, ticks, channel) -> S after `ticks` and a sample of the channel


class Steps(NamedTuple):
    """Results of covariance recursions of one model, noise and R, which later recursions use again."""

    # (bytes of S, ticks, channel) -> S after `ticks` and a sample of the channel
    after: dict[tuple[bytes, int, int], Matrix]
    over: dict[int, tuple[Matrix, Matrix]]  # ticks -> the map over them, and a root of the covariance that noise adds
    flow: dict[str, Matrix]  # "maps" over 0, 1, 2, ... ticks and "noise" added over them, [ticks, n, n] each
    stages: dict[bytes, Matrix]  # samples that arrive in order -> covariances [m + 1, n, n] after none, one, two ...


MAX_ENTRIES = 1 << 16  # covariances in each of the two caches of `Steps`: some ten megabytes


def no_steps() -> Steps:
    """Return an empty cache."""
    return Steps({}, {}, {}, {})


def posterior_variance(
    binary_maps: Matrix,
    noise: Matrix,
    C: Matrix,
    R: Matrix,
    P0: Matrix,
    samples: ArrayLike,
    ticks: range,
    steps: Steps | None = None,
) -> Matrix:
    """Return the mean over some ticks of the variance [n] that bounds every causal estimator from below.

    `binary_maps` and `noise` are the maps over 2^b ticks and the covariance that process noise adds over them, [bits, n, n].

    With x(0) ~ N(xhat0, P0) this is the Bayesian (posterior Cramer-Rao) bound: at tick k it uses every sample that has
    arrived. `samples` [m, 3] are (arrival, taken, channel) in ticks, in any order; R[q] are variances above 0. Source:
    Kalman; Van Trees.
    `steps` of earlier calls with the same `binary_maps`, `noise`, C and R save time, and do not change any bit.
    The recursion propagates roots of covariances by orthogonal transformations. With a prior of 1e8 times the noise, P itself
    would have no correct digit.
    """
    steps = no_steps() if steps is None else steps
    times = np.asarray(samples, int).reshape(-1, 3)
    since, sample_ticks, P = _newest(partial(_after, steps, binary_maps, noise, C, R), P0, times, steps)
    start, stop = np.maximum(since, ticks.start), np.minimum(np.append(since[1:], ticks.stop), ticks.stop)
    nonempty = start < stop
    start, stop = (start - sample_ticks)[nonempty], (stop - sample_ticks)[nonempty]  # ticks after a sample
    P = P[nonempty]
    F, G = _flow(steps, binary_maps, noise, int(stop.max()))
    total = np.zeros(len(P0))
    for i in np.sort(np.unique(start + 1j * stop, return_index=True)[1]):
        P_i = P[(start == start[i]) & (stop == stop[i])]
        F_i, G_i = (matrices[start[i] : stop[i]] for matrices in (F, G))
        total += np.einsum("ijl,jl->i", np.einsum("kij,kil->ijl", F_i, F_i), P_i.sum(0))
        total += len(P_i) * np.einsum("kii->i", G_i)
    return total / len(ticks)


def _newest(
    after: UpdateRoot, P0: Matrix, samples: NDArray[np.integer], steps: Steps
) -> tuple[NDArray[np.integer], NDArray[np.integer], Matrix]:
    """Return ticks [m] from which on a newest sample is known, those of the samples, and covariances after them [m, n, n].

    If a sample arrives after a newer one, the covariances after newer samples are computed again.
    """
    order = np.lexsort(samples.T[::-1])
    arrives, sample_ticks, channel = samples[order].T
    last = np.append(arrives[1:] != arrives[:-1], True)[: len(arrives)]  # whether it is the last arrival of its tick
    if (np.lexsort((channel, sample_ticks)) == np.arange(len(sample_ticks))).all():
        key = np.append(P0, samples[order, 1:]).tobytes()
        if key not in steps.stages:
            if sum(map(len, steps.stages.values())) + len(sample_ticks) > MAX_ENTRIES:
                steps.stages.clear()
            stages = [(0, root(P0))]
            for tick, j in zip(sample_ticks.tolist(), channel.tolist(), strict=True):
                before, S = stages[-1]
                stages.append((tick, after(S, tick - before, j)))
            steps.stages[key] = np.stack([S @ S.T for _, S in stages])
        newest = np.append(0, np.flatnonzero(last) + 1)
        since, newest_ticks = np.append(0, arrives[last]), np.append(0, sample_ticks)[newest]
        P = steps.stages[key][newest]
    else:
        since, newest_ticks, P = _newest_out_of_order(after, P0, samples[order])
    first = int(len(since) > 1 and since[1] == 0)  # 1 if a sample arrives at tick 0
    return since[first:], newest_ticks[first:], P[first:]


def _newest_out_of_order(
    after: UpdateRoot, P0: Matrix, samples: NDArray[np.integer]
) -> tuple[NDArray[np.integer], NDArray[np.integer], Matrix]:
    """As `_newest`, for samples in the order of arrival, some of which arrive after a newer one."""
    sequence: list[ChannelSample] = []  # oldest first
    stages: list[Stage] = [(0, root(P0))]  # after none, one, two ... of them
    since = {-1: stages[0]}
    for tick, *sample in samples.tolist():
        position = bisect(sequence, tuple(sample))
        sequence.insert(position, tuple(sample))
        del stages[position + 1 :]
        for sample_tick, channel in sequence[position:]:
            last_tick, S = stages[-1]
            stages.append((sample_tick, after(S, sample_tick - last_tick, channel)))
        since[tick] = stages[-1]
    newest, roots = zip(*since.values(), strict=True)
    return np.maximum(list(since), 0), np.array(newest), np.stack([S @ S.T for S in roots])


def _after(
    steps: Steps, binary_maps: Matrix, noise: Matrix, C: Matrix, R: Matrix, S: Matrix, ticks: int, channel: int
) -> Matrix:
    """Return the root of the covariance `ticks` later, after a sample of one channel; cached in `steps`."""
    key = S.tobytes(), ticks, channel
    if (entry := steps.after.get(key)) is not None:
        return entry
    if ticks not in steps.over:
        map_, Q = _over(binary_maps, noise, ticks)
        steps.over[ticks] = map_, root(Q)
    E, G = steps.over[ticks]
    if len(steps.after) >= MAX_ENTRIES:
        steps.after.clear()
    posterior = steps.after[key] = root_after(np.hstack([E @ S, G]), C[channel], float(R[channel]))
    return posterior


def root_after(S: Matrix, c: Matrix, r: float) -> Matrix:
    """Return a root [n, n] of the posterior covariance after y = c x + v, v ~ N(0, r), from a root S [n, k] of the prior one.

    [sqrt(r), c S; 0, S] times an orthogonal matrix is [s, 0; K s, S+], lower triangular with a diagonal of at least 0.
    Source: Kailath, Sayed, Hassibi, Linear Estimation, 2000, chapter 12 (array algorithms).
    """
    n, k = S.shape
    before = np.zeros((n + 1, 1 + k))
    before[0, 0], before[0, 1:], before[1:, 1:] = np.sqrt(r), c @ S, S
    after = np.asarray(np.linalg.qr(before.T, mode="r"), float).T
    return np.asarray(after[1:, 1:] * np.where(after.diagonal()[1:] < 0, -1.0, 1.0), float)


def root(P: Matrix) -> Matrix:
    """Return a root S of P = S S'; negative eigenvalues count as 0."""
    if not np.count_nonzero(P - np.diag(P.diagonal())):
        return np.diag(np.sqrt(P.diagonal()))
    size, V = np.linalg.eigh((P + P.T) / 2)
    return np.asarray(V * np.sqrt(np.maximum(size, 0.0)), float)


def _flow(steps: Steps, binary_maps: Matrix, noise: Matrix, count: int) -> tuple[Matrix, Matrix]:
    """Return the maps over 0, 1 ... ticks and the covariance that noise adds over them, [count, n, n] each."""
    if not steps.flow or len(steps.flow["maps"]) < count:
        capacity = 1 << (count - 1).bit_length()  # a power of 2, so that slightly longer delays use it again
        maps, noises = [np.eye(len(binary_maps[0]))], [np.zeros_like(binary_maps[0])]
        for _ in range(capacity - 1):
            maps.append(binary_maps[0] @ maps[-1])
            noises.append(binary_maps[0] @ noises[-1] @ binary_maps[0].T + noise[0])
        steps.flow.update(maps=np.stack(maps), noise=np.stack(noises))
    return steps.flow["maps"][:count], steps.flow["noise"][:count]


def nearest_scale(size: Matrix) -> Matrix:
    """Return the powers of 1000 nearest to sizes [n], 1 for a size of 0; they scale with the sizes in steps of 1000."""
    return 1000.0 ** np.round(np.log10(np.where(size > 0, size, 1.0)) / 3)


def prior_size(context: DesignContext) -> Matrix:
    """Return the standard deviation of x(0) [n], 1 for a known state."""
    size = np.sqrt(np.diag(context.P0))
    return np.where(size > 0, size, 1.0)
