"""Pole placement: the gain K [n, q] for given poles of A^d - K C, the map of the error over d samples.

    all poles are p                       if C is invertible: A^d - K C = p I
    distinct poles p (1, 0.9, 0.8, ...)   otherwise, by `scipy.signal.place_poles`

The observers `chain`, `equal-delay` and `no-delay` use it.
"""

import warnings

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError, UserError, first_sentence
from pcbench.synthesis.sampled_model import SampledPlant, invertible, power, require_visible


def by_poles(plant: SampledPlant, d: int, pole: float, where: str) -> Matrix:
    """Return K [n, q] with A^d - K C = pole I if C is invertible; otherwise the poles are pole (1, 0.9, 0.8, ...).

    With n > 9 states they are closer together. Linearly dependent outputs share a gain.
    """
    Ad, n = power(plant.A, d), len(plant.A)
    if invertible(plant.C):
        return np.asarray((Ad - pole * np.eye(n)) @ np.linalg.inv(plant.C))
    A, C = Ad / plant.scale[:, None] * plant.scale, plant.C / plant.sizes[:, None] * plant.scale
    _, s, V = np.linalg.svd(C, full_matrices=False)
    M = V[s > 1e-9 * max(s[0], 1e-300)]  # independent outputs: C = C pinv(M) M
    if len(M) == n:
        G = (A - pole * np.eye(n)) @ np.linalg.inv(M)
    else:
        require_visible(plant, d, where, least=0.0, purpose="placing poles")
        if pole == 0:
            raise UserError(
                f"{where}: got a pole of 0 with {len(M)} independent outputs for {n} states, expected another: distinct poles "
                "are placed there; write a small one, such as 1e-4."
            )
        from scipy.signal import place_poles  # takes a second to import

        target_poles: Matrix = np.asarray(pole * (1 - min(0.1, 1 / (n + 1)) * np.arange(n)), float)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # slow convergence; the certificate checks the result
                G = np.asarray(place_poles(A.T, M.T, target_poles).gain_matrix.T, float)
        except ValueError as error:
            raise DesignError(
                f"{where}: the poles were not placed (SciPy reported '{first_sentence(error)}'); use another pole."
            ) from error
    return np.asarray(G @ np.linalg.pinv(C @ M.T) * plant.scale[:, None] / plant.sizes, float)
