"""The flexible joint: eigenvalues at three slopes of the sine, and observability from the motor angle."""

import numpy as np

from pcbench.papers.claim import Claim, all_digits
from pcbench.plants import flexible_joint

COMPUTED = "Raghavan, Hedrick 1994 [V]"
MODES = {  # by slope of the sine: 0, at rest, with the link upright
    "without gravity": (0.0, "-0.4452 +8.2208i, -0.3596, 0.0000"),
    "link at 0": (3.33, "-0.4322 +8.2798i, -0.1928 +1.5222i"),
    "link at pi": (-3.33, "-1.7322, -0.4574 +8.1654i, 1.3969"),
}


def rows() -> list[Claim]:
    """Return every claim on the flexible joint."""
    out = []
    for where, (gravity, printed) in MODES.items():
        model = flexible_joint.nominal(flexible_joint.Numbers(gravity=gravity))
        modes = np.sort_complex(np.linalg.eigvals(model.A))
        out.append(all_digits(f"eigenvalues, {where} [1/s]", printed, modes[modes.imag >= 0], COMPUTED))
        rank = np.linalg.matrix_rank(np.vstack([model.C @ np.linalg.matrix_power(model.A, i) for i in range(4)]))
        out.append(all_digits(f"observable states from the motor angle, {where}", "4", rank, COMPUTED))
    return out
