"""Figures of a replay: states with their bands, innovations, their autocorrelation, and the log-likelihood over time.

Bands contain 95 % of the values if the observer's covariance is true and errors are Gaussian: 1.96 standard deviations.
"""

from collections.abc import Mapping, Sequence
from math import floor, log10

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pcbench.plots import replay_frames
from pcbench.plots.layout import PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.lines import lines
from pcbench.plots.palette import GRID, PLANT, SOFT, LineLook, pale, styles
from pcbench.plots.replay_frames import Innovations, Replay
from pcbench.statistics import Z95

WIDE = 1.45  # columns of the paper
SHADE = 0.18  # of a band
FEW = 3  # observers at most, whose bands can be distinguished
EXCERPT = 40  # measurements in it
DOT = 6.0  # points^2
BAND = Patch(color=GRID, label="95 % band")


def states(r: Replay, signal: str, paper: Paper = PAPER) -> Figure:
    """Return one signal over time, tick by tick over a short time, and its error, with the bands of the observers."""
    look, name = lines(r.observers), f"{signal.replace('_', ' ')}"
    unit, minuend = f"[{r.units[signal]}]", "true" if signal in r.truth else "smoothed"
    by_observer = {observer: replay_frames.states(r, observer, signal) for observer in r.observers}
    has_errors = any(frame.error.notna().any() for frame in by_observer.values())
    low, high = excerpt_of(r)
    with sheet(paper, "", panels=2 + has_errors, width=WIDE * paper.width) as (figure, axes):
        overview, excerpt, *error_axes = axes
        for ax in axes:
            set_limits(ax, "x", *((low, high) if ax is excerpt else (0.0, r.end)))
        axes[-1].set_xlabel("t [s]")
        overview.set_title(f"{name} {unit}")
        excerpt.set_title(f"{name} from {span(low, high)} {unit}")
        values = [_steady(r, by_observer[observer]).estimate for observer in r.scale]
        for kind in ("truth", "smoothed"):
            if signal in getattr(r, kind):
                reference = replay_frames.reference(r, signal, kind)
                _draw_reference(overview, reference, kind)
                values.append(reference.value)
        for observer, frame in by_observer.items():
            overview.plot(frame.t, frame.estimate, **look[observer])
        set_range(overview, "y", pd.concat(values), log=False)
        _draw_excerpt(excerpt, r, signal, look, low, high)
        for ax in error_axes:
            ax.set_title(f"{minuend} minus estimated {name} {unit}")
            _draw_errors(ax, r, by_observer, look)
    return figure


def excerpt_of(r: Replay) -> tuple[float, float]:
    """Return the short time [s] in the middle of a recording that is drawn tick by tick."""
    duration = min(max(EXCERPT * r.end / max(r.summary["rows"], 1), 20 * r.summary["dt"]), r.end)
    return 0.5 * (r.end - duration), 0.5 * (r.end + duration)


def span(low: float, high: float) -> str:
    """Return a short time [s] in words, with the digits that its length needs."""
    digits = max(1 - floor(log10(high - low)), 0)
    return f"{low:.{digits}f} s to {high:.{digits}f} s"


def _steady(r: Replay, rows: pd.DataFrame, time: str = "t") -> pd.DataFrame:
    """Return the rows after the initial transient. They set the scale, so larger earlier values leave the picture."""
    return rows[rows[time] >= min(r.summary["steady_start"], 0.5 * r.end)]


def _draw_reference(ax: Axes, frame: pd.DataFrame, kind: str) -> None:
    """Draw the true or the smoothed states below everything else."""
    rows = frame[frame.value.notna()]
    if kind == "truth":
        ax.plot(rows.t, rows.value, color=pale(PLANT, 0.68), linewidth=3.0, zorder=1.6, label="truth")
    else:
        ax.plot(rows.t, rows.value, color=SOFT, linewidth=1.0, linestyle=(0, (1, 1.2)), zorder=1.7, label="smoothed")


def _draw_excerpt(ax: Axes, r: Replay, signal: str, look: Mapping[str, LineLook], low: float, high: float) -> None:
    """Draw some ticks of all observers with their bands, and what was measured."""
    by_observer = {observer: replay_frames.excerpt(r, observer, signal, low, high) for observer in look}
    first, values = next(iter(by_observer.values())), []
    for kind in ("truth", "smoothed"):
        if signal in getattr(r, kind):
            _draw_reference(ax, pd.DataFrame({"t": first.t, "value": first[kind]}), kind)
    for observer, frame in by_observer.items():
        ax.plot(frame.t, frame.estimate, **look[observer])
        values += [frame.estimate] if observer in r.scale else []
        if len(look) <= FEW and frame.sigma.notna().any():
            below, above = frame.estimate - Z95 * frame.sigma, frame.estimate + Z95 * frame.sigma
            _fill(ax, frame.t, below, above, look[observer])
            values += [below, above]
    for channel in (frame["channel"] for frame in r.summary["outputs"] if frame["state"] == signal):
        dots = replay_frames.measured(r, channel, low, high)
        ax.scatter(dots.sampled, dots.value, s=DOT, color=SOFT, linewidths=0, zorder=3, label="measured")
        values.append(dots.value)
    set_range(ax, "y", pd.concat(values), log=False)


def _fill(ax: Axes, t: pd.Series, low: pd.Series, high: pd.Series, look: LineLook) -> None:
    label = f"95 % band of {look['label']}"
    ax.fill_between(t, low, high, color=look["color"], alpha=SHADE, linewidth=0, zorder=1.2, label=label)


def _draw_errors(ax: Axes, r: Replay, by_observer: Mapping[str, pd.DataFrame], look: Mapping[str, LineLook]) -> None:
    """Draw the errors of all observers with their bands."""
    ax.axhline(0.0, color=SOFT, linewidth=0.6, zorder=1)
    values = []
    for observer, frame in by_observer.items():
        ax.plot(frame.t[frame.error.notna()], frame.error.dropna(), **look[observer])
        steady = _steady(r, frame)
        values += [steady.error] if observer in r.scale else []
        if len(look) <= FEW and frame.sigma.notna().any():
            _fill(ax, frame.t, -Z95 * frame.sigma, Z95 * frame.sigma, look[observer])
            values.append(pd.Series([-1.0, 1.0]) * Z95 * steady.sigma.max())
    set_range(ax, "y", pd.concat(values), log=False)


def innovations(r: Replay, channel: str, by_observer: Mapping[str, Innovations], paper: Paper = PAPER) -> Figure:
    """Return the innovations of a channel over the time of arrival, one panel per observer, with their 95 % bands."""
    unit = unit_of(r, channel)
    with sheet(paper, "", panels=len(by_observer), width=WIDE * paper.width, keys=[BAND]) as (figure, axes):
        for ax, (observer, stats) in zip(axes, by_observer.items(), strict=True):
            rows, colour = stats.samples, styles(r.observers)[observer].colour
            set_limits(ax, "x", 0.0, r.end)
            band, steady = Z95 * rows.sigma, _steady(r, rows, "arrived")
            ends = pd.Series([-1.0, 1.0]) * Z95 * steady.sigma.max()
            set_range(ax, "y", pd.concat([steady.innovation, ends]), log=False)
            ax.set_title(f"{observer}: innovations of {channel} {unit}")
            ax.fill_between(rows.arrived, -band, band, color=GRID, linewidth=0, zorder=1)
            ax.scatter(rows.arrived, rows.innovation, s=DOT, color=colour, linewidths=0, zorder=2)
        axes[-1].set_xlabel("time of arrival [s]")
    return figure


def unit_of(r: Replay, channel: str) -> str:
    """Return the unit of a channel in brackets."""
    unit = next(row["unit"] for row in r.summary["outputs"] if row["channel"] == channel)
    return f"[{unit or 'unit of the channel'}]"


def autocorrelation(r: Replay, by_observer: Mapping[str, Innovations], paper: Paper = PAPER) -> Figure:
    """Return the autocorrelation of the normalised innovations of a channel, with the 95 % band of white ones."""
    band = Z95 / np.sqrt(min(stats.many for stats in by_observer.values()))
    lags = max(len(stats.autocorrelation) for stats in by_observer.values())
    with sheet(paper, "", keys=[BAND], width=WIDE * paper.width) as (figure, (ax,)):
        set_limits(ax, "x", 0.0, lags + 1.0)
        set_range(
            ax, "y", [2 * band, -2 * band, *(v for s in by_observer.values() for v in s.autocorrelation)], log=False
        )
        ax.set(title="autocorrelation of the normalised innovations [-]", xlabel="lag [measurements]")
        ax.axhspan(-band, band, color=GRID, linewidth=0, zorder=1)
        ax.axhline(0.0, color=SOFT, linewidth=0.6, zorder=1.1)
        for observer, line in lines(r.observers).items():
            if observer in by_observer:
                r_h = by_observer[observer].autocorrelation
                marker = styles(r.observers)[observer].marker
                ax.plot(1 + np.arange(len(r_h)), r_h, marker=marker, markersize=4, **line)
    return figure


def log_likelihood(r: Replay, observers: Sequence[str], paper: Paper = PAPER) -> Figure:
    """Return the mean log-likelihood of a measured value over time; a line marks where the held-out part begins."""
    by_observer = {observer: replay_frames.log_likelihood(r, observer) for observer in observers}
    with sheet(paper, "", width=WIDE * paper.width) as (figure, (ax,)):
        set_limits(ax, "x", 0.0, r.end)
        set_range(ax, "y", pd.concat([_steady(r, rows).value for rows in by_observer.values()]), log=False)
        ax.set(title="mean log-likelihood per measured value [-]", xlabel="time of arrival [s]")
        start = r.summary["held_out_from"]
        ax.axvline(start, color=SOFT, linewidth=0.8, linestyle=(0, (4, 2)), label="start of the held-out part")
        for observer, line in lines(r.observers).items():
            if observer in by_observer:
                rows = by_observer[observer].dropna()
                ax.plot(rows.t, rows.value, marker=".", markersize=3, **line)
    return figure
