"""Calibration of filters: how often the true state is inside the regions that a filter's covariance predicts.

The probability integral transform (PIT) of a run is u = F(e' P^-1 e), with F the chi-square distribution of n degrees of
freedom, at the last tick. It is uniform on [0, 1] if P is true. The region of nominal coverage c contains the state if u <= c.
Source: Gneiting, Balabdaoui, Raftery, J. R. Stat. Soc. B 69 (2007), 243-268.
"""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.special import gammainc
from scipy.stats import binom

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.labels import about
from pcbench.plots.layout import PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.lines import lines
from pcbench.plots.palette import GRID, SOFT
from pcbench.statistics.consistency import LEVEL

BINS = 10
NOMINAL = np.linspace(0.0, 1.0, 101)

Floats = NDArray[np.float64]


def transforms_of(result: Result, scenario: str | None = None, cell: int = 0) -> dict[str, Floats]:
    """Return the PIT of each run in ascending order, by observer; empty if no observer has a covariance, or without runs."""
    scenario = frames.scenario_of(result, scenario)
    first = result.signals(scenario)[0]
    stats = result.stats_of(scenario, first)
    rows = stats[
        (stats.metric == "nees") & (stats.cell == cell) & (stats.method == "runs") & np.isfinite(stats["mean"])
    ]
    if rows.empty:
        return {}
    runs = result.runs_of(scenario, ["nees", "nees_dof"], cell)
    runs = runs[(runs.signal == first) & ~runs.diverged & runs.observer.isin(set(rows.observer))]
    out: dict[str, Floats] = {}
    for observer, group in runs.groupby(runs.observer.astype(str), sort=False):
        nees, dof = group.nees.to_numpy(float), group.nees_dof.to_numpy(float)
        is_valid = np.isfinite(nees) & (dof > 0)
        if is_valid.any():
            out[str(observer)] = np.sort(gammainc(dof[is_valid] / 2, nees[is_valid] * dof[is_valid] / 2))
    return out


def coverage(transforms: Floats) -> Floats:
    """Return the fraction of runs whose PIT is at most each of NOMINAL."""
    return np.searchsorted(transforms, NOMINAL, side="right") / len(transforms)


def calibration(result: Result, *, scenario: str | None = None, cell: int = 0, paper: Paper = PAPER) -> Figure:
    """Return the actual over the nominal coverage of each filter's regions, and the histogram of its PIT.

    `cell` is the number of the grid point. The gray bands contain 95 % of the results of a filter whose covariance is true
    (binomial distribution, each point alone). A curve below the diagonal, and a histogram with a peak at 1, belong to an
    optimistic filter. Raises UserError unless the study has `consistency = true`, runs and an observer with a covariance.
    """
    scenario = frames.scenario_of(result, scenario)
    transforms = transforms_of(result, scenario, cell)
    if not transforms:
        raise UserError(
            f"plots.calibration: got no runs of {scenario} with NEES, expected consistency = true in [options.scenario] and an "
            "observer with a covariance, such as kf; run the study with both."
        )
    stats = frames.rows(result, scenario, None, "mae")
    many = min(map(len, transforms.values()))
    lower, upper = (np.asarray(binom.ppf(share, many, NOMINAL)) / many for share in (LEVEL / 2, 1 - LEVEL / 2))
    low, high = (float(binom.ppf(share, many, 1 / BINS)) * BINS / many for share in (LEVEL / 2, 1 - LEVEL / 2))
    title = f"calibration at the last tick [-]: {about(result, stats, frames.named_values(result, stats, cell))}"
    with sheet(paper, title, 2, 2, keys=[Patch(color=GRID, label="95 % band, covariance true")]) as (
        figure,
        (left, right),
    ):
        left.set(title="actual coverage", xlabel="nominal coverage")
        right.set(title="density of PIT", xlabel="PIT of NEES")
        for ax in (left, right):
            set_limits(ax, "x", 0.0, 1.0)
        set_limits(left, "y", 0.0, 1.0)
        left.fill_between(NOMINAL, lower, upper, color=GRID, linewidth=0)
        left.plot([0, 1], [0, 1], color=SOFT, linewidth=0.7)
        right.axhspan(low, high, color=GRID, linewidth=0)
        right.axhline(1.0, color=SOFT, linewidth=0.7)
        tops = [high]
        for observer, line in lines(o for o in stats.observer if o in transforms).items():
            left.plot(NOMINAL, coverage(transforms[observer]), **line)
            density = np.histogram(transforms[observer], BINS, (0.0, 1.0))[0] * BINS / len(transforms[observer])
            right.stairs(density, np.linspace(0.0, 1.0, BINS + 1), baseline=None, color=line["color"], linewidth=1.1,
                         linestyle=line["linestyle"])  # fmt: skip
            tops.append(float(density.max()))
        set_range(right, "y", [0.0, *tops], log=False)
    return figure
