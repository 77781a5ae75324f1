"""The flexible joint: eigenvalues at three slopes of the sine, observability, and the sampling intervals of held innovations.

The intervals are certified for every slope of the sine and every sequence of intervals, by the LMI of `lmi-sampled`. The limits
of constant periods are over constant slopes: no larger interval can be certified.
"""

from functools import partial

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.papers.claim import MISPRINT, Claim, all_digits, digits, rounds_to
from pcbench.plants import flexible_joint
from pcbench.synthesis import constant_periods, held_lmi
from pcbench.synthesis.held_lmi import HeldTask

COMPUTED = "Raghavan, Hedrick 1994 [V]"
FUNCTIONAL = "functional of Fridman 2010 [V]"
SLOPE = 3.33  # 1/s^2, the largest of the sine
LONGEST = 0.6  # s, of the search
GAIN_LMI = np.array([[4.375], [0.179], [4.071], [3.463]])  # gains [1/s]
GAIN_PAPER = np.array([[4.019], [0.901], [3.689], [3.505]])
INTERVALS = (
    ("from the motor angle", 1, None, "0.290"),
    ("from motor angle and rate", 2, None, "0.293"),
    ("from the motor angle, a given gain", 1, GAIN_PAPER, "0.281"),
)
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
    slopes = np.stack([flexible_joint.nominal(flexible_joint.Numbers(gravity=g)).A for g in (-SLOPE, 0.0, SLOPE)])
    for description, outputs, L, printed in INTERVALS:
        task = HeldTask(slopes[[0, 2]], np.eye(4)[:outputs], (0,) * outputs, (1.0,))
        largest, _ = held_lmi.largest_interval(task, L, LONGEST)
        out.append(
            digits(f"largest certified interval, {description} [s]", printed, largest, mismatch=MISPRINT)._replace(
                steady=f"{largest:.3f}"
                + ("" if rounds_to(printed, largest) else ": the reference is cut off, not rounded"),
                source=FUNCTIONAL,
            )
        )
    periods = [
        constant_periods.largest_stable(partial(_radius, slopes, L), 2 * LONGEST) for L in (GAIN_LMI, GAIN_PAPER)
    ]
    claim = "largest constant periods of two gains, over constant slopes [s]"
    row = all_digits(claim, "0.470, 0.506", periods, COMPUTED, mismatch=MISPRINT)
    return [*out, row._replace(reproduced=f"{row.reproduced}: the reference is the next period of a grid of 2 ms")]


def _radius(slopes: Matrix, L: Matrix, period: float) -> float:
    """The largest spectral radius of the error over a period, of all slopes."""
    maps = [constant_periods.held_map(A, L, np.eye(4)[:1], period) for A in slopes]
    return max(map(spectral_radius, maps))
