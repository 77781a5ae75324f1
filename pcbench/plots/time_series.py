"""Figures over time: one run with its estimates and errors, NEES, and the delays of a recording."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.playback.delay_search import ChannelDelay
from pcbench.plots import frames, layout, one_run
from pcbench.plots.labels import with_unit
from pcbench.plots.layout import PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.lines import lines
from pcbench.plots.palette import GRID, LOOKS, MEASURED, PLANT, SOFT, LineLook, pale
from pcbench.recordings.survey import Survey
from pcbench.study import scenarios_of, title_of_scenario
from pcbench.toml_text import TomlTable

ROOM = 0.35  # of the plant's range, above and below it: an estimate that goes farther leaves the picture
BANDS = 5  # largest number of observers with bands
STEADY = 0.5  # of the run: how large errors are in its second half says whether they need a logarithmic axis
DEPTH = 1e-6  # of the largest error: what is smaller lies at the lower edge
RUNAWAY = 30.0  # times the plant's range: errors beyond leave the picture
Z90 = 1.6448536269514722  # 90 % of a normal distribution are within so many standard deviations
TRUTH_WIDTH, TRUTH_PALE = 3.2, 0.68
LOOP_WIDTH, LOOP_PALE = 2.6, 0.35  # of the plants of a closed loop, one per observer
FAR = 10.0  # times the plant's range: an estimate of which even the best goes farther leaves the picture
BINS = 40
DIGITS = 9  # of a second: what is less is rounding
SIGMA = "_sigma"  # label of lines that are assumed standard deviations; the legend leaves it out
LOOPED = "plant (thick)"  # label of the plants of a closed loop
INTERVAL = "_interval"  # label of the ends of an interval; likewise
DROP = 12.0  # of a log-likelihood below its maximum that is shown


def time(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    cell: int = 0,
    seed: int | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return one run over time. Upper panel: plant, estimates and held measurements. Lower panel: errors.

    `cell` is the number of the grid point, `seed` the run (None: the study's first). The lower panel shows the errors with the
    band of 90 % of the errors of several runs. If the errors span decades, it shows their root mean square over these runs, or
    their size if runs do not differ, on a logarithmic axis. In a closed loop each observer has its own plant, and the target
    is drawn. Raises UserError for an unknown name, grid point or seed.
    """
    scenario = frames.scenario_of(result, scenario)
    signal = frames.signal_of(result, scenario, signal)
    seed = result.study.first_seed if seed is None else seed
    run = one_run.frame_of(result.study, scenario, result.out, cell, seed)
    if run is None:
        raise UserError(
            f"plots.time: got no stored run of {scenario} and observers without their code, expected one of the two; "
            "run the study again from its own file."
        )
    return draw_run(result, run, scenario, signal, cell, seed, paper)


def draw_run(
    result: Result, run: pd.DataFrame, scenario: str, signal: str, cell: int, seed: int, paper: Paper
) -> Figure:
    """Draw one signal of a run, a frame of `one_run.frame_of`."""
    part = _with_exact(run[run.signal == signal], result, scenario, cell)
    stats = frames.rows(result, scenario, signal, "mae")
    unit = dict(signals_of(scenarios_of(result.study)[scenario]))[signal]
    look = {observer: line for observer, line in lines(stats.observer).items() if observer in set(part.series)}
    values = frames.describe_values(result, stats, cell)
    title = ", ".join([title_of_scenario(result.study, scenario), *values, f"seed {seed}"])
    is_loop = bool(part.series.str.startswith(one_run.UNDER).any())
    plant_label = LOOPED if is_loop else "plant"
    width, share = (LOOP_WIDTH, LOOP_PALE) if is_loop else (TRUTH_WIDTH, TRUTH_PALE)
    plant = Line2D([], [], color=pale(PLANT, share), linewidth=width, label=plant_label)
    has_truth = bool((part.kind == "truth").any())  # an error of a user's own is of no signal
    with sheet(paper, title, 1 + has_truth, sharex=True, keys=[plant] * has_truth) as (figure, axes):
        error_ax = axes[-1]
        set_limits(error_ax, "x", 0.0, float(part.t.max()))
        log = _set_errors_range(error_ax, part)
        exact = exactly(result, scenario, cell)
        error = "error (true minus estimated)" if has_truth else signal.replace("_", " ")
        error_ax.set(title=_size(part, unit, exact) if log else with_unit(error, unit), xlabel="t [s]")
        if has_truth:
            set_limits(axes[0], "y", *_range(part))
            axes[0].set_title(with_unit(signal.replace("_", " "), unit))
            _draw_states(axes[0], part, look)
        _draw_errors(error_ax, part, look, log)
    return figure


def exactly(result: Result, scenario: str, cell: int) -> frozenset[str]:
    """Return the observers whose errors over time are known exactly in a cell."""
    moments = result.moments_of(scenario, cell) if result.exact else pd.DataFrame()
    return frozenset() if moments.empty else frozenset(moments.observer)


def over(observers: frozenset[str], exact: frozenset[str]) -> str:
    """Return in words over what the errors of these observers are taken; those of `exact` ones are over all noise."""
    several = f"{one_run.RUNS} runs"
    return "all noise" if observers <= exact else several if not observers & exact else f"all noise, or {several}"


def _with_exact(part: pd.DataFrame, result: Result, scenario: str, cell: int) -> pd.DataFrame:
    """Return a run with the exact bands and sizes of the errors of observers whose exact moments are known."""
    moments = result.moments_of(scenario, cell) if result.exact else pd.DataFrame()
    if moments.empty:
        return part
    signal = part.signal.iloc[0]
    moments = moments[(moments.signal == signal) & moments.observer.isin(set(part.series))]
    bands = {
        "low": moments["mean"] - Z90 * moments["std"],
        "high": moments["mean"] + Z90 * moments["std"],
        "rms": np.hypot(moments["mean"], moments["std"]),
    }
    rows = [
        pd.DataFrame({"t": moments.t, "series": moments.observer, "kind": kind, "value": value, "signal": signal})
        for kind, value in bands.items()
        if kind in set(part.kind)
    ]
    is_replaced = part.series.isin(set(moments.observer)) & part.kind.isin([*bands])
    return pd.concat([part[~is_replaced], *rows], ignore_index=True)


def _draw_states(ax: Axes, part: pd.DataFrame, look: Mapping[str, LineLook]) -> None:
    low, high = ax.get_ylim()
    for (series, kind), rows in part.groupby(["series", "kind"], sort=False):
        observer = str(series).removeprefix(one_run.UNDER)
        if kind == "truth":
            is_loop = observer in look
            width, share = (LOOP_WIDTH, LOOP_PALE) if is_loop else (TRUTH_WIDTH, TRUTH_PALE)
            colour, label = look[observer]["color"] if is_loop else PLANT, f"_{series}" if is_loop else "plant"
            dashes = look[observer]["linestyle"] if is_loop else "solid"  # the paler shade is that of a variant
            thick: TomlTable = {"color": pale(colour, share), "linestyle": dashes, "linewidth": width, "label": label}
            ax.plot(rows.t, rows.value, zorder=1.6, **thick)
        elif kind == "measured":
            ax.step(rows.t, rows.value, where="post", color=MEASURED, linewidth=1.0, zorder=1.5, label="measured, held")
        elif kind == "target":
            dash = (0, (1.0, 1.6))
            ax.plot(rows.t, rows.value, color=SOFT, linestyle=dash, linewidth=1.2, zorder=1.5, label="set point")
        elif kind == "estimate":
            near = rows.value.where(rows.value.between(low - (high - low), high + (high - low)))
            ax.plot(rows.t, near, **look[observer])
        elif kind in one_run.ENDS:
            line = look[observer]
            ax.plot(rows.t, rows.value, color=line["color"], linewidth=0.8, alpha=0.8, zorder=1.4, label=INTERVAL)


def _draw_errors(ax: Axes, part: pd.DataFrame, look: Mapping[str, LineLook], log: bool) -> None:
    """Draw errors of every observer: with their band, or on a logarithmic axis as their size."""
    floor = ax.get_ylim()[0] if log else -np.inf
    for observer, line in look.items():
        kinds = dict(iter(part[part.series == observer].groupby("kind")))
        for k in ((1,) if log else (-3, 3)) if "sigma" in kinds else ():  # of the assumed standard deviations
            ax.plot(kinds["sigma"].t, np.maximum(k * kinds["sigma"].value, floor), color=line["color"], linewidth=0.6,
                    alpha=0.8, zorder=1.4, label=SIGMA)  # fmt: skip
        if "low" in kinds and len(look) <= BANDS and not log:
            ax.fill_between(kinds["low"].t, kinds["low"].value, kinds["high"].value, color=line["color"], alpha=0.14,
                            linewidth=0)  # fmt: skip
        rows = kinds.get("rms", kinds["error"]) if log else kinds["error"]
        ax.plot(rows.t, np.maximum(np.abs(rows.value), floor) if log else rows.value, **line)
    if not log:
        ax.axhline(0, color=SOFT, linewidth=0.6, zorder=1)


def _size(part: pd.DataFrame, unit: str, exact: frozenset[str]) -> str:
    """Return what a logarithmic axis of errors shows."""
    observers = frozenset(part.series[part.kind == "rms"])
    return with_unit(f"rms error over {over(observers, exact)}" if observers else "|error|", unit)


def _range(part: pd.DataFrame) -> tuple[float, float]:
    """Return the range of the axis of the plant and its target, with room; estimates that diverge leave the picture."""
    values = part.value[part.kind.isin(["truth", "target"]) & np.isfinite(part.value)]
    low, high = float(values.min()), float(values.max())
    near = part.value[part.kind.isin(["estimate", *one_run.ENDS]) & np.isfinite(part.value)]
    room = ROOM * (high - low) or 0.5 * abs(high) or 1.0
    best = _best_estimate(part)
    ends = best[best.between(low - FAR * room / ROOM, high + FAR * room / ROOM)]
    if len(near):
        low, high = (
            min([max(low - room, min(low, near.min())), *ends]),
            max([min(high + room, max(high, near.max())), *ends]),
        )
    room = 0.05 * (high - low) or room
    return low - room, high + room


def _best_estimate(part: pd.DataFrame) -> pd.Series:
    """Return the finite values of the estimate with the least rms error."""
    errors = part[part.kind == "error"].groupby("series", sort=False).value
    with np.errstate(over="ignore"):  # of one that runs away
        size = errors.apply(lambda values: float(np.sqrt(np.mean(np.square(values.to_numpy())))))
    rows = part[(part.kind == "estimate") & (part.series == size.idxmin())] if size.notna().any() else part[:0]
    return rows.value[np.isfinite(rows.value)]


def _set_errors_range(ax: Axes, part: pd.DataFrame) -> bool:
    """Set the range of the axis of errors; return whether it is logarithmic, as for sizes that span decades."""
    errors = part[part.kind == "error"]
    size = part[part.kind == "rms"] if (part.kind == "rms").any() else errors
    true = part.value[part.kind.isin(["truth", "target"]) & np.isfinite(part.value)]
    start = errors[errors.t == 0].value.abs().max()
    span = true.max() - true.min() if len(true) else 0.0
    most = RUNAWAY * max(span, start if np.isfinite(start) else 0.0) or np.inf
    values = size.value.abs()
    values = values[np.isfinite(values) & (values <= most)]
    if not len(values) or not values.max():
        set_limits(ax, "y", -1.0, 1.0)
        return False
    later = size[(size.t >= STEADY * size.t.max()) & np.isfinite(size.value)]
    steady = np.sqrt(later.value.pow(2).groupby(later.series).mean()).min()
    if values.max() > layout.WIDE * steady:
        inside = values[values > 0]
        set_range(ax, "y", inside.clip(lower=DEPTH * inside.max()), log=True)
        return True
    visible = part[part.kind.isin(["error", "low", "high"])].value
    sigma_band = 3 * part.value[(part.kind == "sigma") & (part.t >= STEADY * part.t.max())]
    visible = pd.concat([visible, sigma_band, -sigma_band])
    set_range(ax, "y", [*visible[np.isfinite(visible) & (visible.abs() <= most)], 0.0], log=False)
    return False


def nees(
    result: Result, *, scenario: str | None = None, cell: int = 0, seed: int | None = None, paper: Paper = PAPER
) -> Figure:
    """Return the NEES over time: the mean of e' P^-1 e / n over runs, for each observer with a covariance P of its error e.

    The shaded 95 % band holds for a true P (chi-square). The runs are those of `time`. Raises UserError if the study does not
    have `consistency = true`, or if none of its observers has a covariance.
    """
    scenario = frames.scenario_of(result, scenario)
    run = one_run.frame_of(result.study, scenario, result.out, cell, seed)
    if run is None or not one_run.has_nees(run):
        raise UserError(
            f"plots.nees: got runs of {scenario} without NEES, expected consistency = true in [options.scenario] and an "
            "observer with a covariance, such as kf; run the study with both."
        )
    seed = result.study.first_seed if seed is None else seed
    return draw_nees(result, run, scenario, cell, seed, paper)


def draw_nees(result: Result, run: pd.DataFrame, scenario: str, cell: int, seed: int, paper: Paper) -> Figure:
    """Draw the NEES of a frame of `one_run.frame_of`."""
    stats, part = frames.rows(result, scenario, None, "mae"), run[run.kind.str.startswith("nees")]
    values = frames.describe_values(result, stats, cell)
    title = ", ".join([title_of_scenario(result.study, scenario), *values, one_run.describe_seeds(run, seed)])
    with sheet(paper, title, keys=[Patch(color=GRID, label="95 % band")]) as (figure, (ax,)):
        set_limits(ax, "x", 0.0, float(part.t.max()))
        set_range(ax, "y", part.value[part.value > 0])
        ax.set(title="NEES: squared error / assumed covariance, per state", xlabel="t [s]")
        ends = part[part.kind != "nees"].groupby(["kind", "t"]).value
        low, high = ends.min()["nees_low"], ends.max()["nees_high"]
        ax.fill_between(low.index, low, high, color=GRID, linewidth=0, zorder=1)
        ax.axhline(1.0, color=SOFT, linewidth=0.6, zorder=1.2)
        for observer, line in lines(stats.observer).items():
            rows = part[(part.series == observer) & (part.kind == "nees")]
            if len(rows):
                ax.plot(rows.t, rows.value.where(rows.value > 0), **line)
    return figure


def delays(table: pd.DataFrame, *, paper: Paper = PAPER) -> Figure:
    """Return the delays of every channel of a recording over time, and their histogram; `table` is a frame of `pcbench.info`.

    For a long recording, an even selection of samples is drawn. Raises UserError if no sample arrived.
    """
    survey: Survey = table.attrs["survey"]
    selections = {
        name: channel.delays.selection.round(DIGITS)
        for name, channel in survey.channels.items()
        if len(channel.delays.selection)
    }
    if not selections:
        raise UserError(
            f"plots.delays: got a recording {table.attrs['name']} without arrivals, expected at least one; use another one."
        )
    all_delays = np.concatenate([selection[:, 1] for selection in selections.values()])
    edges = edges_of(all_delays)
    shares = {name: np.histogram(selection[:, 1], edges)[0] / len(selection) for name, selection in selections.items()}
    with sheet(paper, "", panels=2) as (figure, (over_time, histogram)):
        set_limits(over_time, "x", 0.0, max(survey.end - survey.start, 1e-9))
        for ax, side in ((over_time, "y"), (histogram, "x")):
            set_range(ax, side, [all_delays.min(), all_delays.max(), edges[0], edges[-1]], log=False)
        set_range(histogram, "y", [0.0, *np.concatenate(list(shares.values()))], log=False)
        over_time.set(title="delay [s]", xlabel="time since the start [s]")
        histogram.set(title="share of samples", xlabel="delay [s]")
        for name, line in lines(selections).items():
            t, delay = selections[name].T
            over_time.scatter(t - survey.start, delay, s=2, color=line["color"], linewidths=0, rasterized=True)
            label = name if len(selections) > 1 else None
            histogram.stairs(shares[name], edges, color=line["color"], linewidth=1.2, label=label)
    return figure


def delay_profiles(found: Sequence[ChannelDelay], *, paper: Paper = PAPER) -> Figure:
    """Return the profile likelihood of the delay of every channel, from `pcbench.tune` with `find_delay`.

    Each panel shows by how much the log-likelihood is below its maximum, and the 95 % interval. Raises UserError if there is no
    delay.
    """
    if not found:
        raise UserError(
            "plots.delay_profiles: got a tuning without delays, expected one with find_delay; tune with find_delay=True."
        )
    band = Patch(color=GRID, label="95 % interval")
    with sheet(paper, "Profile likelihood: log-likelihood below its maximum", len(found), keys=[band]) as (
        figure,
        axes,
    ):
        for ax, delay in zip(axes, found, strict=True):
            profile_delays, drops = np.array(delay.delays), np.array(delay.drops)
            mask = drops <= max(DROP, np.sort(drops)[min(4, len(drops) - 1)])
            set_range(ax, "x", [*profile_delays[mask], delay.low, delay.high])
            set_range(ax, "y", [0.0, *drops[mask]], log=False)
            ax.axvspan(delay.low, delay.high, color=GRID, linewidth=0, zorder=1)
            ax.axvline(delay.estimate, color=SOFT, linewidth=0.6, zorder=1.2)
            colour = LOOKS["kf"].colour
            if len(profile_delays) > 3:
                fine = np.linspace(profile_delays[mask][0], profile_delays[mask][-1], 200)
                ax.plot(fine, CubicSpline(profile_delays, drops)(fine), color=colour, linewidth=1.2)
            ax.plot(profile_delays[mask], drops[mask], color=colour, marker="o", markersize=3, linestyle="none")
            ax.invert_yaxis()
            low, best, high = (layout.number(v) for v in (delay.low, delay.estimate, delay.high))
            ax.set(title=f"{delay.channel}: {best} s, 95 % interval {low} to {high} s", xlabel="delay [s]")
    return figure


def edges_of(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of about BINS bars, each as wide as a whole number of the delays' smallest difference.

    So every bar contains the same number of ticks if delays are whole ticks.
    """
    values = np.unique(sizes)
    step = float(np.diff(values).min()) if len(values) > 1 else max(float(values[0]) / BINS, 1e-3)
    width = step * max(np.ceil((values[-1] - values[0]) / step / BINS), 1)
    first = values[0] - step / 2
    n_bins = int(np.floor((values[-1] - first) / width)) + 1
    return np.asarray(first + width * np.arange(n_bins + 1))
