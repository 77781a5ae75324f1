"""Can the state be found from the output at all? The test of Popov, Belevitch and Hautus, mode by mode.

A mode (eigenvalue lam of A) is unobservable where [lam I - A; C] has not full rank. A plant is detectable where every such
mode decays: Re lam < 0, or |lam| < 1 for a discrete plant.
"""

from functools import lru_cache

import numpy as np

from pcbench.dynamics.linear import Matrix, Model
from pcbench.errors import UserError

RANK = 1e-9  # a singular value below this part of the largest is zero


def unobservable(A: Matrix, C: Matrix) -> list[complex]:
    """Return the modes of A [n, n] that C [q, n] does not see; remembered, as cells of a study have few plants."""
    A, C = (np.ascontiguousarray(M, float) for M in (A, C))
    return list(_unobservable(A.tobytes(), C.tobytes(), len(A)))


@lru_cache(256)
def _unobservable(of_A: bytes, of_C: bytes, n: int) -> tuple[complex, ...]:
    A, C, out = np.frombuffer(of_A).reshape(n, n), np.frombuffer(of_C).reshape(-1, n), []
    for mode in np.linalg.eigvals(A):
        sizes = np.linalg.svd(np.vstack([mode * np.eye(len(A)) - A, C]), compute_uv=False)
        if sizes[-1] < RANK * max(sizes[0], 1e-300):
            out.append(complex(mode))
    return tuple(out)


def decays(mode: complex, discrete: bool) -> bool:
    """Say whether a mode dies out by itself."""
    return abs(mode) < 1 if discrete else mode.real < 0


def require_observable(model: Model, where: str) -> None:
    """Raise UserError naming a mode that no output shows."""
    for mode in unobservable(model.A, model.C):
        raise UserError(
            f"{where}: got a plant whose mode {shown(mode)} is unobservable, expected an observable one; measure "
            "another output, or take dkf, which needs a detectable plant only."
        )


def require_detectable(model: Model, where: str) -> None:
    """Raise UserError naming a mode that no output shows and that does not decay by itself."""
    for mode in unobservable(model.A, model.C):
        if not decays(mode, model.discrete):
            raise UserError(
                f"{where}: got a plant whose mode {shown(mode)} is undetectable (no output shows it and it does not decay), "
                "expected a detectable one; measure another output or leave that state out."
            )


def shown(mode: complex) -> str:
    """A mode as a person writes it."""
    return f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 else f"{mode.real:.4g}{mode.imag:+.4g}j"
