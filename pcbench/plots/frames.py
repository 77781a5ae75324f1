"""What a picture shows, as frames: taken from a result's tables, before anything is drawn.

Every frame is of one signal of one scenario. Axes that vary are those with more than one value among the scenario's cells.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pandas as pd

from pcbench import statistics
from pcbench.dataset.columns import AXIS_UNITS, axes_of
from pcbench.dataset.result import Result
from pcbench.errors import UserError, unknown
from pcbench.fields import FIELDS
from pcbench.fields import names as names_of_fields
from pcbench.plants import output_units, states_of
from pcbench.plots import layout
from pcbench.statistics import ranking
from pcbench.statistics.limit_verdicts import COUNTS
from pcbench.statistics.metric_matrix import OF_RUN, SIGNED
from pcbench.statistics.number_format import ROUNDING
from pcbench.study import scenarios_of

METRIC = "steady_rmse"  # default metric that ranks observers
WORDY = 24  # letters of an axis' values, from which on it goes upwards
FIRST = 4  # runs of the first interval
POINTS = 100  # of a distribution
INFINITE = {f.name: f.infinite for f in FIELDS if f.infinite}  # what infinity means, by axis
ALIKE = 1e-9  # runs whose quantiles differ by a smaller part are the same


def scenario_of(result: Result, scenario: str | None) -> str:
    """Return the scenario of this name (None: the first); raise UserError for an unknown one."""
    names = result.scenarios
    if scenario is not None and scenario not in names:
        raise unknown(f"study {result.study.name}", "scenario", scenario, names)
    return scenario or names[0]


def signals_by_default(result: Result, scenario: str, metric: str = "") -> list[str]:
    """Return the signals that pictures of a metric show by default: the first, of a metric with one number per run."""
    names = result.signals(scenario)
    if metric in OF_RUN:
        return names[:1]
    headline = [s for s in scenarios_of(result.study)[scenario].scoring.headline if s in names]
    return headline or names[:1]


def select_signals(result: Result, scenario: str, signals: list[str] | None, metric: str = "") -> list[str]:
    """Return those of the `signals` that a scenario has; None: its default signals, empty list: all.

    Raises UserError for one that no scenario of the study has.
    """
    if signals is None:
        return signals_by_default(result, scenario, metric)
    all_signals, available = {s for name in result.scenarios for s in result.signals(name)}, result.signals(scenario)
    for name in signals:
        if name not in all_signals:
            raise unknown("--signal", "signal of the study", name, all_signals)
    available = [s for s in available if s in signals] if signals else available
    return signals_by_default(result, scenario, metric) if available and metric in OF_RUN else available


def signals_with_metric(result: Result, scenario: str, signals: list[str] | None, metric: str) -> list[str]:
    """Return those of the `signals` of a scenario that have a metric."""
    return [
        s
        for s in select_signals(result, scenario, signals, metric)
        if (result.stats_of(scenario, s).metric == metric).any()
    ]


def signal_of(result: Result, scenario: str, signal: str | None, metric: str = "") -> str:
    """Return the signal of this name (None: the first default signal); raise UserError for an unknown one."""
    names = result.signals(scenario)
    if signal is not None and signal not in names:
        raise unknown(f"scenario {scenario}", "signal", signal, names)
    if signal is not None and metric not in OF_RUN:
        return signal
    return signals_by_default(result, scenario, metric)[0]


def rows(result: Result, scenario: str | None, signal: str | None, metric: str) -> pd.DataFrame:
    """Return the rows of stats of one metric, with each varying axis as plain numbers or words."""
    scenario, metric = scenario_of(result, scenario), result.ranks(metric)
    stats = result.stats_of(scenario, signal_of(result, scenario, signal, metric))
    part = stats[stats.metric == metric].copy()
    if not len(part):
        metrics = set(result.stats.metric) if metric not in set(result.stats.metric) else set(stats.metric)
        raise unknown(f"study {result.study.name}", "metric", metric, sorted(metrics))
    part = simplify_axes(result, part)
    for name in ("mean", "ci_low", "ci_high", "p50"):
        part[name] = np.where(np.abs(part[name]) < ROUNDING, 0.0, part[name])
    return part.reset_index(drop=True)


def simplify_axes(result: Result, part: pd.DataFrame) -> pd.DataFrame:
    """Return rows of one scenario with each value of an axis as a number or a word.

    If an axis has one value per channel, and the channels that change have equal values, its value is their number, and its
    title names them. Otherwise the value is a word that names each channel that changes: "y1: 20, y2: 40".
    """
    cells = _cells(result, part)
    values_by_axis = {name: _split(result, cells, name)[0] for name in axes_of(dict.fromkeys(part.columns))}
    by_cell = {name: dict(zip(cells.cell, values, strict=True)) for name, values in values_by_axis.items()}
    return part.assign(**{name: [values[cell] for cell in part.cell] for name, values in by_cell.items()})


def _cells(result: Result, part: pd.DataFrame) -> pd.DataFrame:
    """Return one row per grid point of the scenario of some rows."""
    return result.stats[result.stats.scenario == part.scenario.iloc[0]].drop_duplicates("cell")


def _split(result: Result, cells: pd.DataFrame, axis: str) -> tuple[list[Any], list[int]]:
    """Return the values of an axis as numbers or words, and the channels of which they are (none: all)."""
    column = [value.tolist() if isinstance(value, np.ndarray | np.generic) else value for value in cells[axis]]
    n_channels = next((len(value) for value in column if isinstance(value, list)), 0)
    if not n_channels:
        return column, []
    by_cell = [value if isinstance(value, list) else [value] * n_channels for value in column]
    channels = [i for i, values in enumerate(zip(*by_cell, strict=True)) if len(set(values)) > 1]
    channel_values = [[value[i] for i in channels] for value in by_cell]
    if channels and all(len(set(values)) == 1 for values in channel_values):
        return [values[0] for values in channel_values], channels if len(channels) < n_channels else []
    names = _channel_names(result, cells, axis)
    subset = channels or range(n_channels)
    return [name_values([names[i] for i in subset], [layout.word(value[i]) for i in subset]) for value in by_cell], []


def name_values(names: Sequence[str], values: Sequence[str]) -> str:
    """Return the values of channels with their names, successive equal ones as one: "y1 to y3: 0, y4: 7"."""
    ends = [i for i in range(1, len(values)) if values[i] != values[i - 1]]
    parts = pairwise([0, *ends, len(values)])
    return ", ".join(f"{_join_names(names[a:b])}: {values[a]}" for a, b in parts)


def _join_names(names: Sequence[str]) -> str:
    """Return the names of successive channels: "y4 to y6"."""
    return f"{names[0]} to {names[-1]}" if len(names) > 2 else " and ".join(names)


def _channel_names(result: Result, cells: pd.DataFrame, axis: str) -> list[str]:
    """Return the names of what an axis has one value for: states, or outputs as in a trace."""
    scenario = scenarios_of(result.study)[cells.scenario.iloc[0]]
    if axis in names_of_fields(per="state"):
        return [name.replace("_", " ") for name, _ in states_of(scenario)]
    return [f"y{i + 1}" for i in range(len(scenario.sampling.noise_std))]


def varying_axes(part: pd.DataFrame) -> list[str]:
    """Return the axes with more than one value."""
    return [name for name in axes_of(dict.fromkeys(part.columns)) if part[name].nunique(dropna=False) > 1]


class AxisTitle(NamedTuple):
    """The unit of an axis of a scenario, and the channels that it changes."""

    unit: str = ""
    channels: str = ""  # empty: all, or its values name them
    units: tuple[tuple[str, str], ...] = ()  # each channel's name and unit, if units differ


def label(axis: str, titles: Mapping[str, AxisTitle] | None = None) -> str:
    """Return an axis' name with its channels and its unit: "delay of y2 [s]"; `titles` are those of its scenario."""
    title = (titles or {}).get(axis) or AxisTitle(AXIS_UNITS.get(axis, ""))
    text = name_of(axis, title)
    return f"{text} [{title.unit}]" if title.unit not in ("", "1") else text


def name_of(axis: str, title: AxisTitle) -> str:
    """Return an axis' name with its channels: "delay of y2"."""
    text = axis.removeprefix("plant.").replace("_", " ")
    return f"{text} of {title.channels}" if title.channels else text


def axis_titles(result: Result, part: pd.DataFrame) -> dict[str, AxisTitle]:
    """Return the titles of a scenario's axes: their channels, and units that depend on its plant, such as of noise."""
    cells = _cells(result, part)
    scenario = scenarios_of(result.study)[part.scenario.iloc[0]]
    channel_units = output_units(scenario)
    units_by_axis = dict.fromkeys(("noise_std", "quantization_step", "send_threshold"), channel_units)
    units_by_axis["process_std"] = [u for _, u in states_of(scenario)]
    out = {}
    for axis in axes_of(dict.fromkeys(cells.columns)):
        channels, units = _split(result, cells, axis)[1], units_by_axis.get(axis, [])
        names, pairs = _channel_names(result, cells, axis), tuple[tuple[str, str], ...]()
        if units and all(units) and len(set(units)) > 1:
            pairs = tuple(zip(names, units, strict=True))
        units = [units[i] for i in channels] if units and channels else units
        unit = ", ".join(dict.fromkeys(units)) if units and all(units) else AXIS_UNITS.get(axis, "")
        out[axis] = AxisTitle(unit, _join_names([names[i] for i in channels]) if channels else "", pairs)
    return out


def word(axis: str, value: object) -> str:
    """Return a value of an axis without its unit, and infinity as what it means there."""
    return layout.word(value, INFINITE.get(axis, "∞"))


def format_axis(axis: str, value: object, titles: Mapping[str, AxisTitle] | None = None) -> str:
    """Return an axis' name with a value and its unit: "delay of y2: 0.2 s"; `titles` are those of its scenario."""
    title = (titles or {}).get(axis) or AxisTitle(AXIS_UNITS.get(axis, ""))
    text, name = word(axis, value), f"{name_of(axis, title)}{':' if title.channels else ''}"
    wordless = title.unit == "1" or " " in title.unit or value is None or text == INFINITE.get(axis)
    unit = "" if wordless else f" {title.unit}".rstrip()
    if isinstance(value, str):  # a word has no unit, but the numbers of channels have
        parts = text.split(", ") if ": " in value else [text]
        return f"{name} {', '.join(f'{part}{_unit_of_channels(part, title, unit)}' for part in parts)}"
    return f"{name} {text}{unit}"


def _unit_of_channels(part: str, title: AxisTitle, unit: str) -> str:
    """Return the unit after the value of channels, such as "y2 and y3: 0.1", or else `unit`; empty if theirs differ."""
    if ": " not in part:
        return ""
    if not title.units:
        return unit
    channels, names = part.rpartition(": ")[0], [name for name, _ in title.units]
    sizes = dict(enumerate(map(len, names)))  # of several names, the longest: "x" is the begin of "x dot"
    first = max((i for i in sizes if f"{channels} ".startswith(f"{names[i]} ")), key=sizes.__getitem__, default=0)
    last = max((i for i in sizes if f" {channels}".endswith(f" {names[i]}")), key=sizes.__getitem__, default=first)
    units = {own for _, own in title.units[first : last + 1]}
    return f" {units.pop()}" if len(units) == 1 and "1" not in units else ""


def fix_axes(part: pd.DataFrame, free: list[str], at: dict[str, object] | None = None) -> pd.DataFrame:
    """Return the rows in which every varying axis except the `free` ones has its value in `at`, or else its first value.

    Raises UserError if `at` has an unknown axis or value.
    """
    for name in at or {}:
        if name not in varying_axes(part):
            raise unknown("at", "axis that varies", name, varying_axes(part))
    for name in [name for name in varying_axes(part) if name not in free]:
        value = (at or {}).get(name, part[name].iloc[0])
        if value not in set(part[name]):
            raise UserError(f"at: got {name} = {value!r}, expected one of {sorted(set(part[name]), key=str)}; use one.")
        part = part[part[name] == value]
    return part


def distribution(
    result: Result, scenario: str | None = None, signal: str | None = None, metric: str = METRIC, cell: int = 0
) -> pd.DataFrame:
    """Return observer, value, share: the fraction of all runs [0, 1] at or below a value of a metric.

    Runs that diverged have none, so the share of an observer that diverges ends below 1. At most POINTS points for each
    observer, the least and the largest among them.
    """
    scenario = scenario_of(result, scenario)
    signal, runs = signal_of(result, scenario, signal, metric), result.runs_of(scenario, [metric], cell)
    part, out = runs[runs.signal == signal], []
    for observer, values in part[metric].where(~part.diverged).groupby(part.observer, sort=False):
        finite = np.sort(values.to_numpy()[np.isfinite(values.to_numpy())])
        if len(finite):
            indices = np.unique(np.linspace(0, len(finite) - 1, min(POINTS, len(finite))).round().astype(int))
            share = (indices + 1) / len(values)
            finite = np.where(finite < ROUNDING, 0.0, finite)
            out.append(pd.DataFrame({"observer": observer, "value": finite[indices], "share": share}))
    return pd.concat(out, ignore_index=True) if out else pd.DataFrame({"observer": [], "value": [], "share": []})


def convergence(
    result: Result, scenario: str | None = None, signal: str | None = None, metric: str = METRIC, cell: int = 0
) -> pd.DataFrame:
    """Return observer, seeds, half: half the 95 % interval of the mean over the first so many runs, as a part of the mean.

    The last row of an observer is of all its runs that did not diverge. A mean of 0, and runs that do not vary, have none.
    """
    scenario = scenario_of(result, scenario)
    signal, runs = signal_of(result, scenario, signal, metric), result.runs_of(scenario, [metric], cell)
    runs, out = runs[(runs.signal == signal) & ~runs.diverged], []
    estimate = statistics.mean if metric in SIGNED else statistics.size
    for observer, values in runs.groupby("observer", sort=False)[metric]:
        finite = values.to_numpy(float)
        finite = finite[np.isfinite(finite)]
        counts = [FIRST * 2**i for i in range(40) if FIRST * 2**i < len(finite)]
        for count in [*counts, *([len(finite)] if len(finite) >= FIRST else [])]:
            e = estimate(finite[:count])
            if abs(e["mean"]) > ROUNDING and e["se"] > ALIKE * abs(e["mean"]):
                out.append((observer, count, (e["ci_high"] - e["ci_low"]) / 2 / abs(e["mean"])))
    return pd.DataFrame(out, columns=["observer", "seeds", "half"])


def standings(
    result: Result, scenario: str | None = None, signal: str | None = None, metric: str = METRIC
) -> pd.DataFrame:
    """Return for each cell its axes, the `winner` (empty if none is significant), `leaders`, `best`, `alike`, `p`, ...

    `best` has the fewest diverged runs and then the least `mean`, `alike` names those it is not significantly better than,
    `leaders` are both if a test compares them; see `statistics.ranking.standing`. `text` is a word for a cell.
    """
    scenario, metric = scenario_of(result, scenario), result.ranks(metric)
    key, cache = (scenario, signal_of(result, scenario, signal, metric), metric), _STANDINGS.setdefault(result, {})
    if key not in cache:
        part, pairs, out = rows(result, *key), result.pairs_of(*key[:2]), []
        axes, comparisons = varying_axes(part), ranking.by_cell(pairs[pairs.metric == metric])
        for cell, group in ranking.by_cell(part).items():
            rank = ranking.standing_of(group, comparisons.get(cell, []))
            first = next(row for row in group if row["observer"] == rank.order[0])
            best = rank.order[0] if np.isfinite(first["mean"]) else ""
            out.append(
                {name: first[name] for name in axes}
                | {"cell": cell, "winner": rank.winner, "best": best, "alike": rank.alike, "leaders": rank.leaders}
                | {"p": rank.p_value, "factor": rank.factor, "mean": first["mean"]}
                | {"text": rank.winner or ("tie" if best else "all diverge" if first["diverged"] else "no value")}
            )
        cache[key] = pd.DataFrame(out)
    return cache[key].copy()


_STANDINGS: WeakKeyDictionary[Result, dict[tuple[str, str, str], pd.DataFrame]] = WeakKeyDictionary()  # a cache


def key_cell(result: Result, scenario: str | None = None, signal: str | None = None, metric: str = METRIC) -> int:
    """Return the number of the most informative cell: the one with the largest lead of a significant winner.

    If no cell has a winner, it is that in which the most observers are significantly worse than the best. If observers are
    not compared, it is that with the largest error. Of several, it is the first.
    """
    table = standings(result, scenario, signal, metric)
    if table.factor.isna().all() and not table.alike.map(len).any():
        return int(table.cell.iloc[int(np.argmax(np.nan_to_num(table["mean"], nan=-np.inf)))])
    lead = np.where(table.winner != "", np.nan_to_num(table.factor, nan=1.0, posinf=1.0), 1.0)
    score = lead if (table.winner != "").any() else -table.alike.map(len)
    return int(table.cell.iloc[int(np.argmax(score))])


def map_axes(part: pd.DataFrame) -> tuple[str, str]:
    """Return the two axes of a map, across and up: the first two that vary, the one with the longer words upwards."""
    across, up = varying_axes(part)[:2]
    lengths = [sum(len(word(name, v)) for v in dict.fromkeys(part[name])) for name in (across, up)]
    return (up, across) if lengths[0] > max(lengths[1], WORDY) else (across, up)


def count_runs(part: pd.DataFrame) -> int:
    """Return the number of runs of a grid point, the largest of several; 0: its numbers are exact."""
    diverged = part.diverged.where(~part.metric.isin(COUNTS), 0)  # a rate of diverged runs counts them itself
    return int((part.n + diverged).max())


def values_at(part: pd.DataFrame, cell: int) -> dict[str, object]:
    """Return the values of the axes that vary, in one cell."""
    row = part[part.cell == cell].iloc[0]
    return {name: row[name] for name in varying_axes(part)}


def named_values(result: Result, part: pd.DataFrame, cell: int) -> dict[str, object]:
    """Return the values of the axes that name a grid point; if axes vary one at a time, only those that are not the first."""
    values, first = values_at(part, cell), values_at(part, int(part.cell.iloc[0]))
    one_at_a_time = result.study.vary == "one-at-a-time"
    return {axis: value for axis, value in values.items() if not one_at_a_time or value != first[axis]}


def describe_values(result: Result, part: pd.DataFrame, cell: int) -> list[str]:
    """Return `named_values` as texts, with the names and units of their axes."""
    titles = axis_titles(result, part)
    return [format_axis(axis, value, titles) for axis, value in named_values(result, part, cell).items()]


def has_spread(part: pd.DataFrame) -> bool:
    """Return whether the runs of a frame of stats differ from one another."""
    spread = (part.p95 - part.p05).abs() > ALIKE * part.p95.abs()
    return bool((spread & (part.n > 1)).any())
