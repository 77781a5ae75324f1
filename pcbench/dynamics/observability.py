"""Unobservable modes of a plant, and ranks, by one test that does not depend on units.

For one output y = c x the states are first scaled. State i has the weight o_i in the output:

    o = sum over k < n of |c| |A|^k / rho(|A|)^k        (0: no path leads from the state to the output)

A change of units x -> D x, D diagonal, changes o but no later result. Then (A', c') is transformed to Hessenberg form by
orthogonal maps. Where its subdiagonal vanishes at the scale of A, the following states are not observable through c. The next
output is tested on these states only, and so on; the modes that remain are unobservable. Unlike a test at each eigenvalue,
this detects a multiple mode in any coordinates. (Its computed eigenvalues differ by the root of a rounding error.)

A plant is detectable if every unobservable mode decays: Re lam < 0, or |lam| < 1 for a discrete plant.
Source: staircase form (Van Dooren 1981; Paige 1981); the scaling is this project's.
"""

import numpy as np
from scipy.linalg import block_diag, hessenberg

from pcbench.dynamics.linear import Matrix, Model
from pcbench.errors import UserError
from pcbench.value_cache import cached_by_value

RANK = 1e-11  # a singular value or a coupling below this, relative to the largest, counts as zero
ROUNDING = 1e-14  # relative rounding error of a mode; its m-th root for m modes that may be equal


def rank(M: Matrix) -> int:
    """Return the rank of a matrix whose rows and columns may have different units."""
    M = np.array(M, float)
    for _ in range(3):
        for axis in (1, 0):
            size = np.abs(M).max(axis, keepdims=True, initial=0.0)
            M = M / np.where(size > 0, size, 1.0)
    return int(np.linalg.matrix_rank(M, tol=RANK * max(float(np.linalg.norm(M, 2)), 1e-300))) if M.size else 0


def unobservable(A: Matrix, C: Matrix) -> list[complex]:
    """Return the modes of A [n, n] that are unobservable through C [q, n]; cached, as grid points share plants."""
    return list(_unobservable(np.asarray(A), np.asarray(C)))


@cached_by_value
def _unobservable(A: Matrix, C: Matrix) -> tuple[complex, ...]:
    n, rate = len(A), _rate(A)
    for i in range(len(C)):
        A, C = _hidden(A, C, i)
    hidden, m = np.linalg.eigvals(A).astype(complex), max(len(A), 1)
    noise, hidden_rate = ROUNDING * max(n, 1) * rate, _rate(A)
    return tuple(
        _exact(complex(mode), noise if hidden_rate <= noise else hidden_rate * (noise / hidden_rate) ** (1 / m))
        for mode in hidden
    )


def _exact(mode: complex, noise: float) -> complex:
    """Return a mode without rounding errors: real, imaginary, or of absolute value 1, if it nearly is."""
    mode = complex(0.0 if abs(mode.real) <= noise else mode.real, 0.0 if abs(mode.imag) <= noise else mode.imag)
    return mode / abs(mode) if abs(abs(mode) - 1) <= noise else mode


def _rate(A: Matrix) -> float:
    """Return the spectral radius of |A|, a size of A that does not depend on units."""
    return float(np.abs(np.linalg.eigvals(np.abs(A))).max(initial=0.0))


def _hidden(A: Matrix, C: Matrix, output: int) -> tuple[Matrix, Matrix]:
    """Restrict A and C to the states that are unobservable through one output."""
    reach, size = np.abs(C[output]), np.abs(A)
    rate = _rate(A) or 1.0
    weight = np.zeros_like(reach)
    for _ in range(len(A)):
        weight, reach = weight + reach, reach @ size / rate
    is_reached = weight > 0
    if not is_reached.any():
        return A, C
    o, k = weight[is_reached], int(is_reached.sum())
    pair = np.zeros((k + 1, k + 1))
    pair[1:, 0], pair[1:, 1:] = C[output, is_reached] / o, (A[np.ix_(is_reached, is_reached)] * o[:, None] / o).T
    H, Q = hessenberg(pair, calc_q=True)
    couplings = np.abs(np.diag(H, -1))  # of c with the first direction, and of each direction with the next
    least = RANK * max(float(np.linalg.norm(pair[1:, 1:], 2)), 1e-300)
    rank = next((i for i in range(1, k) if couplings[i] <= least), k)
    basis = block_diag(Q[1:, 1 + rank :] / o[:, None], np.eye(len(A) - k))
    back = block_diag(Q[1:, 1 + rank :].T * o, np.eye(len(A) - k))
    order = np.concatenate([np.flatnonzero(is_reached), np.flatnonzero(~is_reached)])
    return product(back, A[np.ix_(order, order)], basis), product(C[:, order], basis)


def product(*factors: Matrix) -> Matrix:
    """Return the product of matrices, with 0 for entries that are rounding errors of larger terms."""
    result, terms = factors[0], np.abs(factors[0])
    for factor in factors[1:]:
        result, terms = result @ factor, terms @ np.abs(factor)
    return np.where(np.abs(result) > RANK * terms, result, 0.0)


def decays(mode: complex, discrete: bool) -> bool:
    """Return whether a mode decays without correction."""
    return abs(mode) < 1 if discrete else mode.real < 0


def require_observable(model: Model, where: str) -> None:
    """Raise UserError with the first unobservable mode."""
    for mode in unobservable(model.A, model.C):
        raise UserError(
            f"{where}: got a plant whose mode {format_mode(mode)} is unobservable, expected an observable one; measure "
            "another output, or use kf, which needs a detectable plant only."
        )


def require_detectable(model: Model, where: str) -> None:
    """Raise UserError with the first unobservable mode that does not decay."""
    for mode in unobservable(model.A, model.C):
        if not decays(mode, model.discrete):
            raise UserError(
                f"{where}: got a plant whose mode {format_mode(mode)} is undetectable (no output shows it and it does "
                "not decay), "
                "expected a detectable one; measure another output or leave that state out."
            )


def format_mode(mode: complex) -> str:
    """Return a mode as text."""
    return f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 else f"{mode.real:.4g}{mode.imag:+.4g}j"
