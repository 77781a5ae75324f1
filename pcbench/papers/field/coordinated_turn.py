"""The coordinated turn: errors of the cubature filter, and errors of the extended filter without the runs it loses.

The reference numbers are from 250 runs of 100 steps of an independent program, with one seed or two. `reproduced` means within
three standard errors of the difference of two such numbers. The standard error is that of 250 runs of pcbench. The program
draws xhat(0) about x(0); pcbench draws x(0) about xhat(0).
"""

import numpy as np
import pandas as pd

from pcbench import api
from pcbench.papers.claim import FALSE, REPRODUCED, Claim

COMPUTED = "Arasaratnam, Haykin 2009 [V]"
LOST_ERROR = 500.0  # m: a run of the extended filter that passes it counts as lost


def rows() -> list[Claim]:
    """Return every claim on the coordinated turn."""
    runs = api.run("coordinated-turn", axes={"delay": [0.0]}).runs
    ukf = runs[runs.observer == "ukf"].set_index("signal").steady_mse
    ekf = runs[(runs.observer == "ekf") & (runs.signal == "position")]
    ekf_within = ekf[ekf.steady_max_abs_error <= LOST_ERROR]
    ekf_lost = f"lost: {len(ekf) - len(ekf_within)} of {len(ekf)}"
    return [
        _root(ukf["position"], (19.3, 20.4), "ukf, cubature: position [m]"),
        _root(ukf["velocity"], (11.2,), "ukf, cubature: velocity [m/s]"),
        _root(ukf["turn_rate"] * np.degrees(1.0) ** 2, (1.33,), "ukf, cubature: turn rate [degrees/s]"),
        _root(ekf_within.steady_mse, (30.0,), f"ekf: position in the runs within {LOST_ERROR:g} m [m]", ekf_lost),
    ]


def _root(square: "pd.Series[float]", printed: tuple[float, ...], claim: str, more: str = "") -> Claim:
    """Compare the root of the mean square over runs and steps with the printed ones; `square` is of each run."""
    root = np.sqrt(square.mean())
    error = square.sem() / (2 * root)  # of the root
    z_score = max(abs(root - value) for value in printed) / (np.sqrt(2) * error)
    summary = "; ".join(filter(None, (f"{root:.3g} +- {error:.2g}, {z_score:.1f} standard errors off at most", more)))
    steady = f"within {3 if z_score < 3 else z_score:.0f} standard errors"
    text = ", ".join(f"{value:g}" for value in printed)
    return Claim(claim, text, summary, REPRODUCED if z_score < 3 else FALSE, steady, COMPUTED)
