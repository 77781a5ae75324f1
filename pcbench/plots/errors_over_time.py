"""Size of the error over time, one panel per observer: median and bands over runs, assumed standard deviation, arrivals."""

from math import ceil

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.plots import frames, one_run
from pcbench.plots.labels import with_unit
from pcbench.plots.layout import PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.lines import lines
from pcbench.plots.palette import INK, SOFT
from pcbench.statistics.number_format import ROUNDING
from pcbench.study import scenarios_of, title_of_scenario

BESIDE, TALL = 2, 0.85  # panels in a row; inches of a panel
POINTS = 60  # of a line, at most
ARRIVALS = 80  # ticks of arrivals, at most: more of them are a bar
FAR = 1e2  # times the largest error of the best observer: larger ones leave the picture, as of runs that diverge
DEPTH = 1e-4  # of the largest error of the best observer: what is smaller lies at the lower edge
DASHED = (0, (3.0, 1.6))


def error_bands(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    cell: int = 0,
    seed: int | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return the size of the error over time on a logarithmic axis, one panel per observer.

    Each panel has the median and the bands of 50 and 90 % of |e| over 32 runs, from `seed` on (None: the study's first), the
    standard deviation that the observer assumes (dashed), and the arrivals of measurements in the first run (ticks at the
    lower edge, unless they would be a bar). `cell` is the number of the grid point. Raises UserError for an unknown name, grid
    point or seed, and if runs do not differ or have their own schedules.
    """
    scenario = frames.scenario_of(result, scenario)
    signal = frames.signal_of(result, scenario, signal)
    run = one_run.frame_of(result.study, scenario, result.out, cell, seed)
    if run is None or not has_bands(run, signal):
        raise UserError(
            f"plots.error_bands: got no runs of {scenario} with noise on one schedule, expected some; use another scenario."
        )
    seed = result.study.first_seed if seed is None else seed
    return draw_bands(result, run, scenario, signal, cell, seed, paper)


def has_bands(run: pd.DataFrame, signal: str) -> bool:
    """Return whether a frame of `one_run.frame_of` has the quantiles of |e| of a signal."""
    return bool(((run.kind == one_run.MEDIAN) & (run.signal == signal)).any())


def draw_bands(
    result: Result, run: pd.DataFrame, scenario: str, signal: str, cell: int, seed: int, paper: Paper
) -> Figure:
    """Draw the bands of a frame of `one_run.frame_of`."""
    part, stats = run[run.signal == signal], frames.rows(result, scenario, signal, "mae")
    arrivals = run.t[run.kind == "arrival"].to_numpy()
    arrivals = arrivals if len(arrivals) <= ARRIVALS else arrivals[:0]
    unit = dict(signals_of(scenarios_of(result.study)[scenario]))[signal]
    look = {o: line for o, line in lines(stats.observer).items() if o in set(part.series[part.kind == one_run.MEDIAN])}
    values = frames.describe_values(result, stats, cell)
    title = ", ".join([title_of_scenario(result.study, scenario), *values, one_run.describe_seeds(run, seed)])
    title = f"{with_unit('|error| of ' + signal.replace('_', ' '), unit)}: {title}"
    sizes = sizes_in_picture(part[part.series.isin([*look])])
    keys = [
        Line2D([], [], color=SOFT, linewidth=1.6, label="median"),
        Patch(color=SOFT, alpha=0.45, linewidth=0, label="50 %"),
        Patch(color=SOFT, alpha=0.2, linewidth=0, label="90 %"),
    ]
    if (part.kind == "sigma").any():
        keys.append(Line2D([], [], color=INK, linestyle=DASHED, linewidth=0.9, label="assumed std"))
    if len(arrivals):
        keys.append(Line2D([], [], color=SOFT, marker="|", linestyle="none", markersize=5, label="arrival"))
    columns = min(BESIDE, len(look))
    with sheet(paper, title, len(look), columns, height=TALL, keys=keys) as (figure, axes):
        for i, (ax, (observer, line)) in enumerate(zip(axes, look.items(), strict=True)):
            kinds = {str(kind): rows for kind, rows in part[part.series == observer].groupby("kind")}
            _draw_panel(ax, kinds, str(line["color"]), sizes, arrivals)
            ax.set(title=observer, xlabel="t [s]" if i + columns >= len(look) else "")
    return figure


def sizes_in_picture(part: pd.DataFrame) -> pd.Series:
    """Return the finite quantiles of |e| of all observers, between DEPTH and FAR times the largest of the best one.

    An observer without errors is not the best one, unless no other has errors: all others would leave the picture.
    """
    sizes = part[part.kind.isin(one_run.SIZES) & np.isfinite(part.value)]
    largest = sizes.groupby("series").value.max()
    best = float(largest[largest > ROUNDING].min() if (largest > ROUNDING).any() else largest.min())
    return sizes.value.clip(DEPTH * best, FAR * best)


def _draw_panel(ax: Axes, kinds: dict[str, pd.DataFrame], colour: str, sizes: pd.Series, arrivals: np.ndarray) -> None:
    floor = float(sizes.min())
    t = kinds[one_run.MEDIAN].t.to_numpy()
    step = ceil(len(t) / POINTS)
    set_limits(ax, "x", 0.0, float(t.max()))
    set_range(ax, "y", sizes, log=True)
    quantiles, t = {kind: np.maximum(kinds[kind].value.to_numpy()[::step], floor) for kind in one_run.SIZES}, t[::step]
    for low, high, alpha in (("abs_p05", "abs_p95", 0.2), ("abs_p25", "abs_p75", 0.35)):
        ax.fill_between(t, quantiles[low], quantiles[high], color=colour, alpha=alpha, linewidth=0)
    ax.plot(t, quantiles[one_run.MEDIAN], color=colour, linewidth=1.4)
    if "sigma" in kinds:
        sigma = kinds["sigma"].iloc[::step]
        ax.plot(sigma.t, np.maximum(sigma.value, floor), color=INK, linestyle=DASHED, linewidth=0.9)
    ticks = np.tile([0.0, 0.06, np.nan], len(arrivals))  # as one line, of which a page is smaller
    ax.plot(np.repeat(arrivals, 3), ticks, transform=ax.get_xaxis_transform(), color=SOFT, linewidth=0.6)
