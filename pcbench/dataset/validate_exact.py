"""Comparison of simulated means of an affine cell with their exact values, in standard errors.

z = (mean - exact) / standard error has Student's t distribution with n - 1 degrees of freedom. The means of one cell
use the same runs and are not independent. The verdict therefore uses Bonferroni's correction at `LEVEL`. Runs that do
not vary must equal the exact value to `ROUNDING`, or to the rounding that steps of `LOST` of the signal's largest error
leave: an error that decays from 30,000 to 0 ends in the rounding of 30,000. Only plain means of normal errors and of
their squares are compared. With fewer than `FEW` runs a mean square is too skewed for Student's distribution.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtr

from pcbench.dataset import block_files, manifest, storage
from pcbench.dataset.moments_frames import Exact
from pcbench.dataset.result import open_result
from pcbench.dataset.table_diff import ROUNDING, ZERO
from pcbench.errors import UserError
from pcbench.study.grid import Grid

KEY = ["scenario", "cell", "observer", "signal", "metric"]
METRICS = ("mae", "mse", "final_error", "steady_mae", "steady_mse", "lq_cost", "steady_lq_cost", "nees", "signal_nees")
LEVEL = 1e-3
FEW = 64
LOST = 1e-14  # of the peak


class ExactValidation(NamedTuple):
    """The result of the comparison."""

    rows: pd.DataFrame  # KEY, n, mean, se, exact, z (normal), deviation (relative, if the runs do not vary)
    refusals: list[str]  # why an observer has no exact value, a sentence each
    limit: float  # the largest |z| that so many comparisons allow

    @property
    def z(self) -> pd.Series:
        """Return the z of means that vary."""
        return self.rows.z[np.isfinite(self.rows.z)]

    @property
    def wrong(self) -> pd.DataFrame:
        """Return the rows that differ more than chance allows."""
        return self.rows[(self.rows.z.abs() > self.limit) | (self.rows.deviation > ROUNDING)]

    @property
    def verdict(self) -> str:
        """Return the verdict as a sentence."""
        if self.rows.empty:
            return "No mean has an exact value to be compared with."
        fraction, cells = float((self.z.abs() > 2).mean()), self.rows.groupby(["scenario", "cell"]).ngroups
        text = f"{len(self.rows):,} means of {'one cell' if cells == 1 else f'{cells:,} cells'} against their exact values: "
        if len(self.z):
            text += f"{100 * fraction:.3g} % of |z| above 2 (4.6 % by chance), the largest {self.z.abs().max():.2f}; "
        if self.wrong.empty:
            return text + f"none differs more than chance allows (|z| < {self.limit:.2f})."
        return text + f"{len(self.wrong):,} differ more than chance allows (|z| < {self.limit:.2f})."


def check(out: str | Path) -> ExactValidation:
    """Compare the simulated means of a dataset with exact values; raise UserError if it has too few runs."""
    target = storage.target(out)
    claim = manifest.load_manifest(target, run=True)
    if not block_files.present(target):
        raise UserError(
            f"{target.name}: has no runs to be compared with exact values; run the study with evaluation = 'runs'."
        )
    stats = open_result(out).stats
    runs = stats[(stats.method == "runs") & stats.metric.isin(METRICS) & (stats.diverged == 0)]
    if not (runs.n >= FEW).any():
        raise UserError(f"{target.name}: has fewer than {FEW} runs a cell, expected more; add some with --seeds.")
    exact = Exact(Grid(claim.study, claim.cells), claim.study.schedules).stats
    reasons = exact[exact.metric == "mse"].reason.dropna().drop_duplicates().tolist()
    expected = exact[exact.method == "exact"][[*KEY, "mean", "se"]].rename(columns={"mean": "exact", "se": "exact_se"})
    peaks = stats[stats.metric == "max_abs_error"][[*KEY[:-1], "mean"]].rename(columns={"mean": "max_abs_error"})
    joint = runs[runs.n >= FEW][[*KEY, "n", "mean", "se"]].merge(expected, on=KEY).merge(peaks, on=KEY[:-1], how="left")
    return ExactValidation(compare_means(joint), reasons, float(-ndtri(LEVEL / 2 / max(len(joint), 1))))


def compare_means(joint: pd.DataFrame) -> pd.DataFrame:
    """Return matched means with their z, or with their difference if the runs do not vary."""
    diff, size = joint["mean"] - joint.exact, np.maximum(joint["mean"].abs(), joint.exact.abs())
    error = np.hypot(joint.se, joint.exact_se)
    squares, rounding = joint.metric.str.endswith("mse"), LOST * joint.max_abs_error.fillna(0.0)
    zero = np.where(squares, np.maximum(ZERO, rounding) ** 2, np.maximum(ZERO, rounding))  # below it all is rounding
    tolerance = np.where(squares, 2 * np.sqrt(size) * rounding + rounding**2, rounding)
    varies = (error > 1e-12 * size) & (size > zero)
    t: pd.Series = diff / np.where(varies, error, 1.0)
    p = stdtr(joint.n - 1, -t.abs())  # as the normal number that is as rare
    z = np.where(varies, np.where(p > 0, -ndtri(np.maximum(p, 1e-300)), np.inf) * np.sign(t), np.nan)
    relative = np.where(
        varies | (size <= zero), 0.0, np.maximum(diff.abs() - tolerance, 0.0) / np.where(size > 0, size, 1.0)
    )
    return joint.assign(z=z, deviation=relative)
