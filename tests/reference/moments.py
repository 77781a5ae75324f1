"""Exact second moments of the estimation error e = x - xhat over measurement noise and over a random start.

Every observer here is affine in what enters it, so by superposition
    e(t_k) = e_0(t_k) + sum_i E_i(t_k) v_i + F(t_k) (x(0) - m),   v_i and x(0) - m independent, mean 0,
where e_0 is the run without noise from x(0) = m, E_i the run at rest (u = 0, x(0) = xhat(0) = 0) with
v_i = 1 alone, and F the runs at rest with x(0) a unit vector. Then the mean of e is e_0 and its covariance
sum_i sigma_i^2 E_i E_i' + F P0 F'. Nothing is drawn. Times are ticks; the value at k is after the jump.

Gaussian noise is used only where |e| is averaged (folded normal). Not claimed: process noise in the plant.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from . import cart, linear

Array = np.ndarray
# (u [N+1, m], x0 [n], xhat0 [n], noise: one array per channel) -> e [N+1, n]
ErrorOf = Callable[[Array, Array, Array, list[Array]], Array]


class ErrorMap(NamedTuple):
    """base [N+1, n]: e without noise; noise [M, N+1, n]: e per unit of v_i; start [n, N+1, n]: of x0.

    The M samples stand channel by channel.
    """

    base: Array
    noise: Array
    start: Array


def sample_counts(ticks: int, te: list[int], d: list[int]) -> list[int]:
    """Return how many samples of each channel arrive by tick N = `ticks`."""
    return [max(0, (ticks - late) // period + 1) for period, late in zip(te, d, strict=True)]


def error_map(error_of: ErrorOf, u: Array, x0: Array, xhat0: Array, counts: list[int]) -> ErrorMap:
    """Build the map from noise and start to e by running `error_of` on one impulse at a time."""
    rest, still = np.zeros_like(u), np.zeros(len(x0))
    silent = [np.zeros(count) for count in counts]
    base = error_of(u, x0, xhat0, silent)
    responses = []
    for j, count in enumerate(counts):
        for i in range(count):
            noise = [channel.copy() for channel in silent]
            noise[j][i] = 1.0
            responses.append(error_of(rest, still, still, noise))
    start = [error_of(rest, unit, still, silent) for unit in np.eye(len(x0))]
    return ErrorMap(base, np.array(responses).reshape(-1, *base.shape), np.stack(start))


def covariance(response: ErrorMap, noise_std: Array | float, P0: Array | None = None) -> Array:
    """Return cov e(t_k) [N+1, n, n]; noise_std [M] or one number; P0 [n, n] of x(0) (None: x(0) is fixed)."""
    scaled = response.noise * np.broadcast_to(noise_std, len(response.noise))[:, None, None]
    total = np.einsum("ika,ikb->kab", scaled, scaled)
    if P0 is not None:
        total = total + np.einsum("ika,ij,jkb->kab", response.start, P0, response.start)
    return total


def folded_mean(mean: Array, variance: Array) -> Array:
    """Return E|e| of e ~ N(mean, variance), elementwise; variance 0 gives |mean|."""
    std = np.sqrt(variance)
    ratio = np.divide(mean, std * np.sqrt(2), out=np.zeros_like(mean), where=std > 0)
    spread = std * np.sqrt(2 / np.pi) * np.exp(-(ratio**2)) + mean * erf(ratio)
    return np.where(std > 0, spread, np.abs(mean))


def expected_mae(mean: Array, variance: Array, start: int = 0, stop: int = -1) -> Array:
    """Return E[MAE] [n] over ticks start .. stop-1 (to N-1 by default); mean and variance [N+1, n]."""
    return np.mean(folded_mean(mean, variance)[start:stop], axis=0)


def root_expected_mse(mean: Array, variance: Array, start: int = 0, stop: int = -1) -> Array:
    """Return sqrt(E[MSE]) [n] over ticks start .. stop-1 (to N-1 by default); mean and variance [N+1, n]."""
    return np.sqrt(np.mean((mean**2 + variance)[start:stop], axis=0))


def posterior_covariance(
    model: linear.Model,
    ticks: int,
    te: list[int],
    d: list[int],
    R: Array,
    P0: Array,
    W: Array | None = None,
) -> Array:
    """Return cov(x(t_k) | all samples arrived by tick k) [N+1, n, n]: the bound when W is None.

    R [q] variances, W [n, n] process noise intensity. Whenever something arrives, the Riccati recursion
    starts again from P0 at tick 0 and walks through all that is known: the order of arrival does not matter.
    """
    Ad, _ = linear.discretise(model.A, model.B, model.h)
    Qd = np.zeros_like(Ad) if W is None else linear.process_noise(model.A, W, model.h)
    rest = np.zeros((ticks + 1, model.B.shape[1]))
    _, samples = linear.simulate(model, rest, np.zeros(len(Ad)), te, d)
    inbox = linear.by_arrival(samples)
    P = np.asarray(P0, float)
    out = []
    for k in range(ticks + 1):
        if k in inbox:
            known = [sample for sample in samples if sample.arrival <= k]
            P = riccati(Ad, Qd, model.C, R, np.asarray(P0, float), known, k)
        out.append(P)
        P = Ad @ P @ Ad.T + Qd
    return np.stack(out)


def riccati(Ad: Array, Qd: Array, C: Array, R: Array, P: Array, known: list[linear.Sample], until: int) -> Array:
    """Return the covariance [n, n] at tick `until` given the known samples, from P at tick 0."""
    taken: dict[int, list[int]] = {}
    for sample in known:
        taken.setdefault(sample.taken, []).append(sample.channel)
    for k in range(until + 1):
        for j in taken.get(k, []):
            _, P = linear.joseph_update(np.zeros(len(P)), P, C[j], 0.0, R[j])
        if k < until:
            P = Ad @ P @ Ad.T + Qd
    return P


def cart_map(
    scenario: str,
    observer: str,
    *,
    te: int | None = None,
    d: int | None = None,
    R: float | None = None,
    ticks: int = cart.TICKS,
    lag_aware: bool = False,
) -> ErrorMap:
    """Return the error map of an observer on the cart without drift; te, d [ticks] and R may be replaced."""
    case = cart.configure(scenario, te, d, 0.0, R)

    def error_of(u: Array, start: Array, xhat0: Array, noise: list[Array]) -> Array:
        x, samples = linear.simulate(cart.MODEL, u, start, [case.te], [case.d], noise)
        return x - cart.observe(case, observer, u, samples, xhat0, lag_aware=lag_aware)

    counts = sample_counts(ticks, [case.te], [case.d])
    return error_map(error_of, cart.sawtooth(ticks), cart.X0, cart.XHAT0, counts)


def recentre(response: ErrorMap, x0: Array) -> ErrorMap:
    """Return the cart's map about x(0) = x0 in place of cart.X0: only the base moves."""
    return response._replace(base=response.base + np.tensordot(x0 - cart.X0, response.start, 1))


def cart_moments(response: ErrorMap, noise_std: float, *, random_initial_state: bool = False) -> tuple[Array, Array]:
    """Return mean and variance [N+1, 2] of e on the cart; x(0) = cart.X0 or, random, ~ N(xhat(0), P0)."""
    P0 = None
    if random_initial_state:
        response, P0 = recentre(response, cart.XHAT0), cart.P0
    return response.base, np.diagonal(covariance(response, noise_std, P0), axis1=1, axis2=2)
