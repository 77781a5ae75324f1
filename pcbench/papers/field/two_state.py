"""The two-state plant of networked control under held state feedback: its loop, and its largest constant period."""

import numpy as np
from scipy.optimize import brentq

from pcbench.papers.claim import Claim, all_digits, digits
from pcbench.plants import ncs_two_state
from pcbench.scenarios import SCENARIOS
from pcbench.study import controller_table
from pcbench.synthesis import held_lmi
from pcbench.synthesis.held_lmi import HeldTask

COMPUTED = "Zhang, Branicky, Phillips 2001 [V]"
FUNCTIONAL = "functional of Fridman 2010 [V]"
LONGEST = 3.0  # s, of the search
HELD = SCENARIOS["ncs-two-state/held"]


def rows() -> list[Claim]:
    """Return every claim on the two-state plant."""
    model = ncs_two_state.nominal(ncs_two_state.Numbers())
    K = np.array(HELD.loop.control["K"])
    poles = sorted(np.linalg.eigvals(model.A - model.B @ K), reverse=True)
    certified, _ = held_lmi.largest_interval(HeldTask(model.A[None], K, (0,), (1.0,)), model.B, LONGEST, 1e-4)
    return [
        all_digits("eigenvalues of the continuous loop [1/s]", "-0.5, -0.75", poles, COMPUTED),
        all_digits("largest constant period [s]", "1.72941", brentq(_margin, 1.5, 2.0, xtol=1e-9), COMPUTED),
        digits("largest certified period, any intervals [s]", "1.614", certified)._replace(
            steady=f"{certified:.3f}", source=FUNCTIONAL
        ),
    ]


def _margin(period: float) -> float:
    """The size of the loop's slowest eigenvalue over a period, minus 1."""
    tick = period / 150
    times = {"sampling_period": (period, period), "dt": tick, "control": {**HELD.loop.control, "period": period}}
    slowest = controller_table.slowest_mode(HELD.with_fields(**times), "loop")
    return np.nan if slowest is None else abs(slowest.mode) - 1
