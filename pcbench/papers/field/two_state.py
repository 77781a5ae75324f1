"""The two-state plant of networked control under held state feedback: its loop, and its largest constant period."""

import numpy as np
from scipy.optimize import brentq

from pcbench.papers.claim import Claim, all_digits
from pcbench.plants import ncs_two_state
from pcbench.scenarios import SCENARIOS
from pcbench.study import controller_table

COMPUTED = "Zhang, Branicky, Phillips 2001 [V]"
HELD = SCENARIOS["ncs-two-state/held"]


def rows() -> list[Claim]:
    """Return every claim on the two-state plant."""
    model = ncs_two_state.nominal(ncs_two_state.Numbers())
    poles = sorted(np.linalg.eigvals(model.A - model.B @ np.array(HELD.loop.control["K"])), reverse=True)
    return [
        all_digits("eigenvalues of the continuous loop [1/s]", "-0.5, -0.75", poles, COMPUTED),
        all_digits("largest constant period [s]", "1.72941", brentq(_margin, 1.5, 2.0, xtol=1e-9), COMPUTED),
    ]


def _margin(period: float) -> float:
    """The size of the loop's slowest eigenvalue over a period, minus 1."""
    tick = period / 150
    times = {"sampling_period": (period, period), "dt": tick, "control": {**HELD.loop.control, "period": period}}
    slowest = controller_table.slowest(HELD.having(**times), "loop")
    return np.nan if slowest is None else abs(slowest.mode) - 1
