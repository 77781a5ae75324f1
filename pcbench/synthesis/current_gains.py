"""Design methods of a current estimator's gain L [n, q], each with its certificate.

    given     L itself
    lmi       LMI (23) of Mohammed et al., with a unique solution: `current_lmi`
    riccati   a stationary Kalman filter's
    decay     the fastest decay rate that one P certifies over a range (up to e^-5 per sample), or a required rate
    h2        the least covariance, and
    hinf      the least energy gain, from noise to the estimate at a sample's arrival: `robust_lmi`

The first three are for the (mean) sampling period, in units of 1000^k (k whole) near the size of x(0), because the solution
of (23) depends on the units. If a range or a rate is required, another P certifies their gain for it.
All methods report `noise_rms` [n], exact at the mean period: the stationary rms error of the estimate at a sample's arrival,
caused by measurement noise alone.
"""

from functools import partial

import numpy as np

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError
from pcbench.synthesis import common_lyapunov, current_lmi, error_bounds, riccati, robust_lmi, solvers
from pcbench.synthesis.certificate import Certificate, DesignContext, require_certified
from pcbench.synthesis.common_lyapunov import ErrorMaps
from pcbench.synthesis.parameter_ranges import Maps
from pcbench.value_cache import cached_by_value

ROBUST = ("decay", "h2", "hinf")


def find(
    context: DesignContext,
    method: str,
    gain: Matrix | None,
    q: float,
    decay: float | None,
    maps: Maps | None,
    where: str,
) -> tuple[Matrix, Certificate]:
    """Return L and its certificate; raise DesignError if no gain is certified.

    `q`: intensity of process noise through the input, per second. `maps`: range of the certificate; None: the mean period
    only.
    """
    period, C, R = context.period[0], context.model.C, np.diag(context.noise_variance)
    Phi, Q = _over_period(context.model, context.dt, q, context.process_noise, period)
    delay = context.delay[0]
    Phi_delay = linear.over(linear.doublings(context.model, context.dt, linear.bits_for(delay)), delay)
    mean = Maps(Phi[None], Q[None], np.array([period * context.dt]), np.array([0]))
    error_bounds.require_slower(decay or 0.0, (maps or mean).seconds, where)
    S = riccati.nearest_scale(riccati.prior_size(context))
    s = riccati.nearest_scale(np.linalg.norm(C * S, axis=1))
    scaling, C1, R1 = np.outer(1 / S, S), C * S / s[:, None], R / np.outer(s, s)
    if gain is None and method in ROBUST:
        size = _error_size(context, Phi, Q, R)
        task = robust_lmi.RobustTask(maps or mean, C, R, Phi_delay / riccati.prior_size(context)[:, None], size)
        solution, certificate = robust_lmi.design(task, method, decay, where)  # type: ignore[arg-type]
        L = np.asarray(solution.L, float)
    else:
        start = None if gain is None else gain / S[:, None] * s
        L, certificate = at_the_mean(method, start, Phi * scaling, Q / np.outer(S, S), C1, R1, mean.seconds, where)
        if maps is not None or decay:
            all_maps = maps or mean
            certificate = _certify_range(L, C1, all_maps._replace(Phi=all_maps.Phi * scaling), decay or 0.0, where)
        L, P = S[:, None] * L / s, np.asarray(certificate.numbers["P"]) / np.outer(S, S)
        certificate = certificate._replace(numbers=dict(certificate.numbers) | {"P": P})
    L1 = L / S[:, None] * s
    X = Phi_delay @ (_noise_covariance(L1, C1, Phi * scaling, R1) * np.outer(S, S)) @ Phi_delay.T
    numbers = {"L": L, "noise_rms": np.sqrt(np.diag(X))}
    return L, certificate._replace(numbers=dict(certificate.numbers) | numbers)


@cached_by_value
def _over_period(model: linear.Model, dt: float, q: float, process: Matrix, period: int) -> tuple[Matrix, Matrix]:
    """Return the map over a period [ticks], and the covariance that process noise adds."""
    binary_maps = linear.doublings(model, dt, linear.bits_for(period))
    noise = linear.noise_doublings(model, linear.input_noise(model, q, dt) + process, dt, len(binary_maps))
    return linear.over(binary_maps, period), linear.noise_over(binary_maps, noise, period)


@cached_by_value
def _noise_covariance(L: Matrix, C: Matrix, Phi: Matrix, R: Matrix) -> Matrix:
    """Return the stationary covariance that measurement noise alone causes."""
    return error_bounds.covariance(error_bounds.errors(L, C, Phi), L @ R @ L.T)


@cached_by_value
def at_the_mean(
    method: str, gain: Matrix | None, Phi: Matrix, Q: Matrix, C: Matrix, R: Matrix, seconds: Matrix, where: str
) -> tuple[Matrix, Certificate]:
    """Return L and its certificate at the mean period, by one of the first three methods."""

    def certify(solution: current_lmi.CurrentGain) -> Certificate:
        return current_lmi.certify(sharpen(solution), Phi, C, float(seconds[0]))

    def sharpen(solution: current_lmi.CurrentGain) -> current_lmi.CurrentGain:
        return current_lmi.sharpen(solution, Phi, C) if gain is None and method == "lmi" else solution

    if gain is None and method == "lmi":
        solve = partial(current_lmi.solve, Phi, C, where)
        cached_solve = partial(solvers.solve_or_load, current_lmi.CurrentGain, "lmi23", (Phi, C), solve)
        solution, certificate = solvers.solve_certified(cached_solve, certify, where)
    else:
        L = riccati.current_gain(Phi, C, Q, R, where) if gain is None else gain
        solution = current_lmi.lyapunov(Phi, C, L)
        certificate = require_certified(certify(solution), where)
    return np.asarray(sharpen(solution).L, float), certificate


def _certify_range(L: Matrix, C: Matrix, maps: Maps, decay: float, where: str) -> Certificate:
    """Return the certificate of a gain over a range, at a rate [1/s]."""
    F = error_bounds.errors(L, C, maps.Phi)
    factors = np.maximum(np.abs(np.linalg.eigvals(F)).max(1), error_bounds.MIN_FACTOR)
    fastest = float((-np.log(factors) / maps.seconds).min())
    if not decay < fastest:
        raise DesignError(
            f"{where}: got a gain whose errors decay at {fastest:.3g} 1/s over some interval, expected more than {decay:g}; "
            "use a slower decay or a narrower range, or gain = 'h2'."
        )
    error_maps = ErrorMaps(F, maps.seconds)
    inequality = f"F'P F < e^{{-2 {decay:g} T}} P at every map of the range, F = (I - L C) Phi"
    corners = ErrorMaps(F[maps.corners], maps.seconds[maps.corners])
    return common_lyapunov.design(corners, lambda solution: error_maps, decay, inequality, where)[1]


def _error_size(context: DesignContext, Phi: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Return the size of the errors [n] for the solver: that of a Kalman filter if one exists, otherwise that of x(0)."""
    prior = riccati.prior_size(context)
    try:
        L = riccati.current_gain(Phi, context.model.C, Q, R, context.scenario)
    except DesignError:
        return prior
    C = context.model.C
    X = error_bounds.covariance(error_bounds.errors(L, C, Phi), error_bounds.noise(L, C, Q, R))
    size = np.sqrt(np.diag(X))
    return np.where(size > 1e-12 * prior, size, prior) if np.isfinite(size).all() else prior
