"""Which modes of a plant do its outputs not show? One test for every rank decision of this kind, whatever the units.

Of one output y = c x the states are first scaled: state i by its weight o_i in what that output may show,

    o = sum over k < n of |c| |A|^k / rho(|A|)^k        (0: no path leads from the state to the output)

A change of units x -> D x, D diagonal, changes o and nothing that follows. Then the Hessenberg form of (A', c') is taken, by
orthogonal maps: where its subdiagonal vanishes at the scale of A, what comes after it is not shown by c. The next output
is asked about that part alone, and so on; the modes of what is left are unobservable. Unlike a test at each eigenvalue, this
finds a multiple mode in any coordinates, whose computed eigenvalues differ by the root of a rounding error.

A plant is detectable if every unobservable mode decays: Re lam < 0, or |lam| < 1 for a discrete plant.
Source: staircase form (Van Dooren 1981; Paige 1981); the scaling is ours.
"""

import numpy as np
from scipy.linalg import block_diag, hessenberg

from pcbench.dynamics.linear import Matrix, Model
from pcbench.errors import UserError
from pcbench.value_cache import cached_by_value

RANK = 1e-11  # a singular value, or a coupling, below this part of the largest is zero
ROUNDING = 1e-14  # of A, in its modes; the m-th root of it where m of them may be one


def rank(M: Matrix) -> int:
    """Return the rank of a matrix whose rows may each have a unit of its own, and its columns another."""
    M = np.array(M, float)
    for _ in range(3):
        for axis in (1, 0):
            size = np.abs(M).max(axis, keepdims=True, initial=0.0)
            M = M / np.where(size > 0, size, 1.0)
    return int(np.linalg.matrix_rank(M, tol=RANK * max(float(np.linalg.norm(M, 2)), 1e-300))) if M.size else 0


def unobservable(A: Matrix, C: Matrix) -> list[complex]:
    """Return the modes of A [n, n] that C [q, n] does not see; cached, as grid points of a study have few plants."""
    return list(_unobservable(np.asarray(A), np.asarray(C)))


@cached_by_value
def _unobservable(A: Matrix, C: Matrix) -> tuple[complex, ...]:
    n, whole = len(A), _rate(A)
    for i in range(len(C)):
        A, C = _hidden(A, C, i)
    hidden, m = np.linalg.eigvals(A).astype(complex), max(len(A), 1)
    noise, own = ROUNDING * max(n, 1) * whole, _rate(A)
    return tuple(_exact(complex(mode), noise if own <= noise else own * (noise / own) ** (1 / m)) for mode in hidden)


def _exact(mode: complex, noise: float) -> complex:
    """Return a mode without what rounding adds: real, imaginary, or of size 1, if it is nearly that."""
    mode = complex(0.0 if abs(mode.real) <= noise else mode.real, 0.0 if abs(mode.imag) <= noise else mode.imag)
    return mode / abs(mode) if abs(abs(mode) - 1) <= noise else mode


def _rate(A: Matrix) -> float:
    """Return the spectral radius of |A|, a size of A that no change of units changes."""
    return float(np.abs(np.linalg.eigvals(np.abs(A))).max(initial=0.0))


def _hidden(A: Matrix, C: Matrix, output: int) -> tuple[Matrix, Matrix]:
    """Restrict A and C to the states that one output does not show."""
    reach, size = np.abs(C[output]), np.abs(A)
    rate = _rate(A) or 1.0
    weight = np.zeros_like(reach)
    for _ in range(len(A)):
        weight, reach = weight + reach, reach @ size / rate
    seen = weight > 0
    if not seen.any():
        return A, C
    o, k = weight[seen], int(seen.sum())
    pair = np.zeros((k + 1, k + 1))
    pair[1:, 0], pair[1:, 1:] = C[output, seen] / o, (A[np.ix_(seen, seen)] * o[:, None] / o).T
    H, Q = hessenberg(pair, calc_q=True)
    coupling = np.abs(np.diag(H, -1))  # of c to the first direction, of each to the next
    least = RANK * max(float(np.linalg.norm(pair[1:, 1:], 2)), 1e-300)
    shown = next((i for i in range(1, k) if coupling[i] <= least), k)
    basis = block_diag(Q[1:, 1 + shown :] / o[:, None], np.eye(len(A) - k))
    back = block_diag(Q[1:, 1 + shown :].T * o, np.eye(len(A) - k))
    order = np.concatenate([np.flatnonzero(seen), np.flatnonzero(~seen)])
    return product(back, A[np.ix_(order, order)], basis), product(C[:, order], basis)


def product(*factors: Matrix) -> Matrix:
    """Return the product of matrices, less the entries that are what rounding leaves of larger terms."""
    whole, terms = factors[0], np.abs(factors[0])
    for each in factors[1:]:
        whole, terms = whole @ each, terms @ np.abs(each)
    return np.where(np.abs(whole) > RANK * terms, whole, 0.0)


def decays(mode: complex, discrete: bool) -> bool:
    """Say whether a mode dies out by itself."""
    return abs(mode) < 1 if discrete else mode.real < 0


def require_observable(model: Model, where: str) -> None:
    """Raise UserError naming a mode that no output shows."""
    for mode in unobservable(model.A, model.C):
        raise UserError(
            f"{where}: got a plant whose mode {format_mode(mode)} is unobservable, expected an observable one; measure "
            "another output, or take kf, which needs a detectable plant only."
        )


def require_detectable(model: Model, where: str) -> None:
    """Raise UserError naming a mode that no output shows and that does not decay by itself."""
    for mode in unobservable(model.A, model.C):
        if not decays(mode, model.discrete):
            raise UserError(
                f"{where}: got a plant whose mode {format_mode(mode)} is undetectable (no output shows it and it does "
                "not decay), "
                "expected a detectable one; measure another output or leave that state out."
            )


def format_mode(mode: complex) -> str:
    """A mode as a person writes it."""
    return f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 else f"{mode.real:.4g}{mode.imag:+.4g}j"
