"""The quadruple tank at both operating points: time constants, equilibria, zeros and gains.

The printed numbers were seen in public programs that name the paper, not in the paper. The transmission zeros are the
generalised eigenvalues of [A B; C 0] and diag(I, 0). The relative gain is that of pump 1 and level 1.
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import eigvals

from pcbench.dynamics.linear import Model
from pcbench.papers.claim import MISPRINT, Claim, all_digits, report_finding, rounds_to
from pcbench.plants.quadruple_tank import POINTS, Numbers, linearize, time_constants

SOURCE = "Johansson 2000, in CPSEC/probabilistic-recovery [S]"
COMPUTED = "Johansson 2000 [V]"
LEVELS = {"P-": (12.4, 12.7, 1.8, 1.4), "P+": (12.6, 13.0, 4.8, 4.9)}  # cm, printed
CONSTANTS = {"P-": Numbers(), "P+": Numbers(k1=3.14, k2=3.29, gamma1=0.43, gamma2=0.34)}
TIMES = {"P-": ("62", "90", "23", "30"), "P+": ("63", "91", "39", "56")}  # s, printed
EQUILIBRIA = {"P-": "12.263, 12.783, 1.634, 1.409", "P+": "12.442, 13.167, 4.730, 4.986"}
ZEROS = {"P-": "-0.0580, -0.0172", "P+": "-0.0562, 0.0128"}
RELATIVE = {"P-": "1.40", "P+": "-0.636"}
GAINS = {"P-": "2.61, 1.50, 1.41, 2.84", "P+": "1.52, 2.45, 2.56, 1.60"}


def rows() -> list[Claim]:
    """Return every claim on the quadruple tank."""
    explanation = "The printed levels give the printed T2 and T4, the equilibrium gives T1, T3 and T4."
    finding = report_finding("quadruple tank, P-: no one reading gives all four printed time constants", explanation)
    return [*(row for point in LEVELS for row in _rows(point)), finding]


def _rows(point: str) -> Iterator[Claim]:
    n, printed = CONSTANTS[point], np.array(LEVELS[point])
    exact = POINTS[point].level
    T_printed, T_equilibrium = time_constants(n, printed), time_constants(n, exact)
    for i, text in enumerate(TIMES[point]):
        claim = f"{point}: T{i + 1} at the printed levels [s]"
        row = all_digits(claim, text, T_printed[i], SOURCE)
        if not rounds_to(text, T_printed[i]) and rounds_to(text, T_equilibrium[i]):
            row = row._replace(
                reproduced=f"{row.reproduced}; {T_equilibrium[i]:.1f} at the equilibrium", verdict=MISPRINT
            )
        yield row
    yield all_digits(f"{point}: equilibrium of the printed constants [cm]", EQUILIBRIA[point], exact, COMPUTED)
    model = linearize(n, printed)
    G = -model.C @ np.linalg.solve(model.A, model.B)
    relative = G[0, 0] * G[1, 1] / np.linalg.det(G)
    yield all_digits(f"{point}: transmission zeros [1/s]", ZEROS[point], zeros(model), COMPUTED)
    yield all_digits(f"{point}: relative gain of pump 1 and level 1", RELATIVE[point], relative, COMPUTED)
    yield all_digits(f"{point}: gains of (y1, y2) to (v1, v2)", GAINS[point], G, COMPUTED)
    text = ", ".join(f"{a:g} and {b:.3f}" for a, b in zip(printed, exact, strict=True))
    claim_levels = f"quadruple tank, {point}: the printed levels are no equilibrium of the printed constants"
    yield report_finding(claim_levels, f"printed and exact levels in cm: {text}")


def zeros(model: Model) -> np.ndarray:
    """Return the finite transmission zeros of a model without D, the least first."""
    n, m = model.B.shape
    pencil = np.block([[model.A, model.B], [model.C, np.zeros((len(model.C), m))]])
    eigenvalues = eigvals(pencil, np.diag([1.0] * n + [0.0] * m))
    return np.sort(eigenvalues[np.isfinite(eigenvalues) & (np.abs(eigenvalues) < 1e6)].real)
