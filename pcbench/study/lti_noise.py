"""The process noise of a plant of one's own, over one tick: `process_std`, or `G` with `QN`.

A continuous plant x' = A x + B u + G w has white noise w of intensity QN, whose covariance over a tick is exact (Van Loan);
a discrete one adds G w with w ~ N(0, QN) at every tick.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcbench.dynamics.linear import noise_over_tick
from pcbench.errors import UserError, shown
from pcbench.study.lti_shapes import Number, Size, vector

Intensity = Size | list[Size] | list[list[Number]]
ROUNDING = 1e-12  # part of the largest entry by which a covariance may fall short of one


class Noisy(Protocol):
    """What says how process noise enters a plant, and how much of it."""

    dt: float | None
    process_std: Any
    G: Any
    QN: Any


def process_noise(lti: Noisy, A: Any, tick: float, where: str) -> tuple[Any, ...]:
    """Return the noise of a tick of a plant A [n, n] as `Truth.process_std` has it: [n], [n, n], or nothing.

    Raises UserError where G and QN do not fit, or QN is no covariance.
    """
    n = len(A)
    if lti.process_std is not None:
        other = next((name for name in ("G", "QN") if getattr(lti, name) is not None), None)
        if other:
            raise UserError(f"{where}: got process_std and {other}, expected one of the two ways; leave one out.")
        std = vector(lti.process_std, 0.0, n, f"{where}.process_std")
        return tuple(std) if any(std) else ()
    if lti.QN is None:
        if lti.G is not None:
            raise UserError(f"{where}.QN is missing beside G; write QN = ..., the intensity of the noise.")
        return ()
    G = np.eye(n) if lti.G is None else _entering(lti.G, n, f"{where}.G")
    QN = covariance(lti.QN, G.shape[1], f"{where}.QN")
    Q = G @ QN @ G.T if lti.dt else noise_over_tick(np.array(A, float), G @ QN @ G.T, tick)
    return root(Q) if np.any(Q) else ()


def root(Q: NDArray[np.float64]) -> tuple[Any, ...]:
    """Return a covariance's symmetric square root as tuples; its diagonal alone where the covariance is diagonal."""
    if not np.any(Q - np.diag(np.diag(Q))):
        return tuple(np.sqrt(np.diag(Q)).tolist())
    size, V = np.linalg.eigh(Q)
    return tuple(tuple(row) for row in ((V * np.sqrt(np.maximum(size, 0.0))) @ V.T).tolist())


def covariance(given: Any, many: int, where: str) -> NDArray[np.float64]:
    """Return a number, one for each of `many`, or rows as a matrix; raise UserError where it is no covariance of so many."""
    if not isinstance(given, list):
        return float(given) * np.eye(many)
    flat = not any(isinstance(row, list) for row in given)
    if len(given) != many or not (flat or all(len(row) == many for row in given)):
        raise UserError(
            f"{where}: got {shown(given)}, expected a number, {many} numbers, or {many} x {many}: one noise for each column "
            "of G."
        )
    Q: NDArray[np.float64] = np.diag(np.array(given, float)) if flat else np.array(given, float)
    size = max(float(np.abs(Q).max()), 1e-300)
    if np.abs(Q - Q.T).max() > ROUNDING * size or np.linalg.eigvalsh(Q)[0] < -ROUNDING * size:
        raise UserError(
            f"{where}: got {shown(given)}, expected a covariance: symmetric, with no eigenvalue below 0; mend its entries."
        )
    return Q


def _entering(rows: list[list[float]], n: int, where: str) -> NDArray[np.float64]:
    widths = {len(row) for row in rows}
    if len(rows) != n or len(widths) != 1 or 0 in widths:
        raise UserError(f"{where}: got {shown(rows)}, expected {n} rows of the same length, one row for each state.")
    return np.array(rows, float)
