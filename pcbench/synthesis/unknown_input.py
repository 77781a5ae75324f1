"""Coordinates of a plant with an unknown input, shared by the sliding-mode observer and the PI observer.

    x' = A x + B u + E f,   y = C x;      z = T x,   T E = [0; 0; E222],   C inv(T) = [0, inv(Tp)]        (1) to (4)
    xhat' = A xhat + B u + Gx e_y + Lx v,   e_y = y - C xhat,   s = Tp e_y                                (5), (21)

There are n states, m inputs, p outputs and r unknown inputs (q in print, where E is D, and our E222 is D222). Errors are x -
xhat; T times the error is [e1; s], and v is subtracted from the rate of s. With ebar1 = e1 - L s, L = [L1, 0], and the gains
of `injection`,

    ebar1' = (A11 - L1 A211) ebar1,   s' = A21 ebar1 + A22s s + [0; E222] f - v                           (13), (14), (36)

for all f and v. So the unmeasured part decays independently of f, and v must tend to [0; E222] f. Feedthrough changes e_y
only.
Source: Peng, Appl. Sci. 2017, 7(1), 67. Not in print: the orthonormal bases of T, which `split` defines.
Assumptions 1 and 2 do not guarantee an L1: no gain may move some modes of (A11, A211), see `require_movable`. For the arm
with its link angle and velocity measured, those are printed at -0.006 +- 1.9365j; they are -0.000625 +- 1.9365j.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from pcbench.dynamics.linear import Matrix, Model
from pcbench.dynamics.observability import format_mode, product, rank, unobservable
from pcbench.errors import UserError
from pcbench.synthesis.certificate import RATE_TOL, Certificate, require_certified

TIE = 1e-9  # relative tolerance of equal lengths and zero entries


class Split(NamedTuple):
    """A plant in the coordinates z = T x = [z1; z2], where z2 = Tp y is measured and f acts on its last r entries."""

    T: Matrix  # [n, n]
    Tp: Matrix  # [p, p] orthogonal
    A11: Matrix  # [n-p, n-p], a block of T A inv(T), as the next three
    A12: Matrix  # [n-p, p]
    A21: Matrix  # [p, n-p]
    A22: Matrix  # [p, p]
    E222: Matrix  # [r, r], the last rows of Tp C E

    @property
    def A211(self) -> Matrix:
        """Return the rows of A21 for the outputs on which f does not act, [p-r, n-p]."""
        return self.A21[: len(self.Tp) - len(self.E222)]


def split(model: Model, where: str) -> Split:
    """Return the plant in coordinates in which f acts on the last r outputs only; raise UserError if there are none.

    T = TD [N'; C], TD = [I, -D1 pinv(D2); 0, Tp], D1 = N'E, D2 = C E. N is a basis of null(C), and Tp one of null(D2')
    followed by one of the span of D2, each by `_basis`. The first non-zero entry of each row of T is positive. For the arm, T
    is the permutation [x1, x4, x3, x2], for which the gains are printed.
    """
    E0 = _require_assumptions(model, where)
    n, p, r = len(model.A), len(model.C), E0.shape[1]
    C, rows = model.C, _unit(model.C)
    # f scaled so that each moves y by 1, for a pseudo-inverse independent of units
    E = E0 / np.linalg.norm(C @ E0, axis=0)
    E2, E2_pinv = C @ E, np.linalg.pinv(C @ E)
    N = _basis(np.eye(n) - np.linalg.pinv(rows) @ rows, n - p)
    Tp = np.vstack([_basis(np.eye(p) - E2 @ E2_pinv, p - r), _basis(E2 @ E2_pinv, r)])
    T = np.vstack([N - N @ E @ E2_pinv @ C, Tp @ C])
    is_nonzero = np.abs(T) > TIE * np.abs(T).max(1, keepdims=True)
    sign = np.sign(np.take_along_axis(T, is_nonzero.argmax(1)[:, None], 1))
    T, Tp = sign * T, sign[n - p :] * Tp
    A, k = T @ model.A @ np.linalg.inv(T), n - p
    blocks = {"A11": A[:k, :k], "A12": A[:k, k:], "A21": A[k:, :k], "A22": A[k:, k:]}
    return Split(T=T, Tp=Tp, **blocks, E222=Tp[p - r :] @ C @ E0)


def injection(plant: Split, L1: Matrix, A22s: Matrix) -> tuple[Matrix, Matrix]:
    """Return Gx and Lx [n, p] in the plant's own coordinates, (12) and (35); L1 [n-p, p-r], A22s [p, p] (PI observer: 0)."""
    L = np.hstack([L1, np.zeros((len(plant.A11), len(plant.E222)))])
    A12b = plant.A12 - L @ plant.A22 + plant.A11 @ L - L @ plant.A21 @ L
    G2 = (plant.A22 + plant.A21 @ L - A22s) @ plant.Tp
    G1 = A12b @ plant.Tp + L @ G2
    gains = np.block([[G1, L], [G2, np.eye(len(G2))]])
    Gx, Lx = np.hsplit(np.asarray(np.linalg.solve(plant.T, gains), dtype=np.float64), 2)
    return Gx, Lx


def unmovable(plant: Split) -> list[complex]:
    """Return the modes of A11 - L1 A211 that no L1 moves: the zeros of the plant from f to the outputs."""
    return unobservable(plant.A11, plant.A211)


def require_movable(plant: Split, rate: float, where: str) -> None:
    """Raise UserError with the modes that no L1 moves, if one of them does not decay faster than `rate` [1/s]."""
    fixed_modes = unmovable(plant)
    slowest = max((mode.real for mode in fixed_modes), default=-np.inf)
    if slowest >= -rate:
        advice = f"use a rate below {-slowest:.4g} 1/s or " if slowest < 0 else ""
        raise UserError(
            f"{where}: got modes of (A11, A211) that no gain L1 moves, {', '.join(map(format_mode, fixed_modes))}, expected "
            f"each left of {-rate:.4g} 1/s; {advice}measure other outputs."
        )


def proven_rate(A: Matrix, P: Matrix) -> float:
    """Return the largest rate [1/s] with A' P + P A + 2 rate P <= 0; NaN unless P is positive definite."""
    P = (P + P.T) / 2
    try:
        return float(-eigh(A.T @ P + P @ A, P, eigvals_only=True)[-1] / 2)
    except (np.linalg.LinAlgError, ValueError):
        return float("nan")


def require_rate(certificate: Certificate, rate: float, where: str) -> Certificate:
    """Return the certificate with the required rate; raise DesignError if it certifies less."""
    numbers = dict(certificate.numbers) | {"rate_asked": rate}
    return require_certified(certificate._replace(numbers=numbers), where, rate_to_certify(rate))


def rate_to_certify(rate: float) -> float:
    """Return the rate [1/s] that must be certified for a required rate: slightly less, as an optimum is on the boundary."""
    return rate * (1 - RATE_TOL)


def _require_assumptions(model: Model, where: str) -> Matrix:
    """Return E of a model that meets Assumptions 1 and 2; raise UserError for the first one that it violates."""
    if model.discrete:
        raise UserError(f"{where}: got a discrete model, expected x' = A x + B u + E f; use another observer.")
    if model.E is None or model.E.shape[1] == 0:
        raise UserError(
            f"{where}: the plant has no unknown input, expected a model with E [n, r], r > 0; use another observer."
        )
    A, C, E = model.A, model.C, model.E
    (n, m), p, r = model.B.shape, len(C), E.shape[1]
    ranks = (
        ("2, rank C = p", rank(C), p, "leave a repeated output out"),
        ("1, rank E = r", rank(E), r, "leave a repeated unknown input out"),
        ("1, rank(C E) = r", rank(product(C, E)), r, "measure what the unknown input moves at once"),
    )
    for condition, value, expected, advice in ranks:
        if value < expected:
            raise UserError(
                f"{where}: Assumption {condition}, is not met: got rank {value}, expected {expected}; {advice}."
            )
    counts = (
        (n > p, "n > p", f"{n} states and {p} outputs", "leave an output out"),
        (p >= m, "p >= m", f"{p} outputs and {m} inputs", "measure another output"),
        (p > r, "p > r", f"{p} outputs and {r} unknown inputs", "measure another output"),
    )
    for holds, condition, counts_text, advice in counts:
        if not holds:
            raise UserError(
                f"{where}: Assumption 2, {condition}, is not met: got {counts_text}, expected {condition}; {advice}."
            )
    for mode in unobservable(A, C):
        value = min(rank(np.vstack([mode.real * np.eye(n) - A, C])), n - 1) if mode.imag == 0 else n - 1
        raise UserError(
            f"{where}: Assumption 2, (C, A) observable, is not met: got rank {value} of [lam I - A; C] at the mode "
            f"lam = {format_mode(mode)}, expected {n}; measure another output."
        )
    return E


def _unit(rows: Matrix) -> Matrix:
    """Return rows scaled to length 1, so that no rank depends on units; a row of zeros stays zero."""
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)


def _basis(projection: Matrix, k: int) -> Matrix:
    """Return an orthonormal basis, as rows [k, n], of the k-dimensional space with the orthogonal `projection`.

    The unit vector closest to the space is projected onto it, and so on in the remaining space; of equally close ones, the
    first is used. So a space spanned by axes has those axes as its basis, in their order.
    """
    rows = np.zeros((k, len(projection)))
    for row in rows:
        size = np.linalg.norm(projection, axis=0)
        first = int(np.argmax(size > (1 - TIE) * size.max()))
        row[:] = projection[:, first] / size[first]
        projection = projection - np.outer(row, row @ projection)
    return rows
