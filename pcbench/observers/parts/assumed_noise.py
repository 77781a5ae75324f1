"""Assumed noise of a filter: one variance for all signals, one for each, or a full covariance.

Correlated measurement noise is decorrelated before a filter uses the outputs one after the other. With R = L diag(r) L', L
unit lower triangular, L^-1 y = L^-1 C x + L^-1 v has the variances r.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError, brief_repr
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.synthesis.certificate import DesignContext

Variance = Annotated[float, Field(gt=0)]
Size = Annotated[float, Field(ge=0)]
Variances = Variance | list[Variance] | list[list[float]]  # one for all outputs, one for each, or in full
Sizes = list[Size] | list[list[float]]  # one for each state, or in full
ROUNDING = 1e-12  # tolerance of symmetry and semidefiniteness, relative to the largest entry


class Options(StrictOptions):
    """Assumed noise, if it differs from the scenario's."""

    R: Variances | None = tunable(
        None,
        description="assumed variance of a measurement: one number, q numbers, or [q, q]; default: that of the scenario",
    )
    q: Size | list[Size] | None = tunable(
        None, description="assumed intensity of the process noise through the input: one number, or m numbers"
    )
    Q: Sizes | None = tunable(
        None,
        description="assumed covariance of the process noise of a tick: n numbers, or [n, n]; default: that of the scenario",
    )


def covariance(noise: Variances | Sizes | None, n: int, where: str, signal: str) -> Matrix:
    """Return a number, n numbers or rows as a matrix [n, n]; raise UserError if it is not a covariance."""
    entries = np.asarray(noise, float) if _is_rectangular(noise) else np.zeros(0)
    if entries.shape not in ((), (n,), (n, n)):
        raise UserError(
            f"{where}: got {brief_repr(noise)}, expected {n} number{'s' if n > 1 else ''}, one for each {signal}, or a matrix "
            f"of {n} x {n}."
        )
    if entries.ndim < 2:
        return np.asarray(entries * np.eye(n))
    require_covariance(entries, noise, where)
    return entries


def require_covariance(Q: Matrix, entries: object, where: str) -> None:
    """Raise UserError for a matrix, given by `entries`, that is not symmetric or has an eigenvalue below 0."""
    size = max(float(np.abs(Q).max()), 1e-300)
    if np.abs(Q - Q.T).max() > ROUNDING * size or np.linalg.eigvalsh(Q)[0] < -ROUNDING * size:
        raise UserError(
            f"{where}: got {brief_repr(entries)}, expected a covariance: symmetric, with no eigenvalue below 0; "
            "correct its entries."
        )


def _is_rectangular(noise: Variances | Sizes | None) -> bool:
    """Return whether all rows have the same length."""
    rows = [len(row) if isinstance(row, list) else 0 for row in noise] if isinstance(noise, list) else []
    return len(set(rows)) < 2


def decorrelate_outputs(
    context: DesignContext, noise: Variances | Sizes | None, C: Matrix, where: str
) -> tuple[Matrix | None, Matrix, Matrix]:
    """Return outputs with independent noise, for the assumed `noise` (None: the scenario's).

    The results are the matrix [q, q] from outputs to such outputs (None: identity), their C [q, n], and their variances [q].

    Raises UserError if `noise` does not fit, is singular, or correlates outputs that are not sampled together.
    """
    if noise is None and context.noise_correlation:
        noise = context.noise_covariance.tolist()
    if noise is None:
        return None, C, context.noise_variance
    R = covariance(noise, len(C), f"{where}: R", "output")
    if not np.any(R - np.diag(np.diag(R))) and np.all(np.diag(R) > 0):
        return None, C, np.diag(R).copy()
    try:
        L = np.linalg.cholesky(R)
    except np.linalg.LinAlgError:
        raise UserError(
            f"{where}: R: got {brief_repr(noise)}, expected every eigenvalue above 0: an output without noise "
            "would be divided by 0."
        ) from None
    if context.sensors > 1 or len(set(context.period)) > 1 or len(set(context.delay)) > 1:
        raise UserError(
            f"{where}: R: got noise that is correlated between outputs, expected outputs with one period, delay and network, "
            "which are sampled together; give a number for each."
        )
    mix: Matrix = np.asarray(np.linalg.inv(L / np.diag(L)), np.float64)
    return mix, mix @ C, np.square(np.diag(L))


def process_covariance(context: DesignContext, noise: Variances | Sizes | None, where: str) -> Matrix:
    """Return the covariance [n, n] of the process noise of a tick: `noise`, or the scenario's if None."""
    n = len(context.model.A)
    return context.process_noise if noise is None else covariance(noise, n, f"{where}: Q", "state")


def input_intensity(intensity: Variances | Sizes | None, inputs: int, default: float, where: str) -> Any:
    """Return the intensity of process noise through the input, a number or one for each input [m]."""
    if not isinstance(intensity, list):
        return default if intensity is None else intensity
    if len(intensity) != inputs:
        raise UserError(f"{where}: q: got {brief_repr(intensity)}, expected a number, or {inputs}, one for each input.")
    return np.array(intensity, float)


def covariance_option(name: str, Q: Matrix) -> dict[str, Any]:
    """Return a dict of a covariance as an option has it: its diagonal if it is diagonal, {} if it is 0."""
    if not np.any(Q):
        return {}
    return {name: Q if np.any(Q - np.diag(np.diag(Q))) else np.diag(Q)}
