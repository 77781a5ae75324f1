"""What a picture shows, as frames: taken from a result's tables, before anything is drawn.

Every frame is of one signal of one scenario. Axes that vary are those with more than one value among the scenario's cells.
"""

from typing import Any

import numpy as np
import pandas as pd

from pcbench.dataset.columns import AXIS_UNITS, axes_of
from pcbench.dataset.result import Result
from pcbench.errors import UserError, unknown
from pcbench.statistics import winning
from pcbench.statistics.wording import ROUNDING
from pcbench.study import scenarios_of

METRIC = "tail_rmse"  # by which observers are ranked, unless said otherwise
POINTS = 100  # of a distribution
WIDE = 30.0  # values whose largest is so many times the least are drawn on a logarithmic axis
ROOM = 0.35  # of the plant's range, above and below it


def scenario_of(result: Result, scenario: str | None) -> str:
    """Return the scenario that is meant (None: the first); raise UserError for another word."""
    names = list(dict.fromkeys(result.stats.scenario))
    if scenario is not None and scenario not in names:
        raise unknown(f"study {result.study.name}", "scenario", scenario, names)
    return scenario or names[0]


def signals_by_default(result: Result, scenario: str) -> list[str]:
    """Return the signals that a scenario's pictures show by default."""
    there = list(dict.fromkeys(result.stats.signal[result.stats.scenario == scenario]))
    chosen = [s for s in scenarios_of(result.study)[scenario].scoring.headline if s in there]
    return chosen or there[:1]


def chosen(result: Result, scenario: str, signals: list[str] | None) -> list[str]:
    """Return the `signals` that a scenario has; of None those it is known by, of an empty list all.

    Raises UserError for one that no scenario of the study has.
    """
    if signals is None:
        return signals_by_default(result, scenario)
    every, there = set(result.stats.signal), list(dict.fromkeys(result.stats.signal[result.stats.scenario == scenario]))
    for name in signals:
        if name not in every:
            raise unknown("--signal", "signal of the study", name, every)
    return [s for s in there if s in signals] if signals else there


def signal_of(result: Result, scenario: str, signal: str | None) -> str:
    """Return the signal that is meant (None: the first that is shown); raise UserError for another word."""
    names = list(dict.fromkeys(result.stats.signal[result.stats.scenario == scenario]))
    if signal is not None and signal not in names:
        raise unknown(f"scenario {scenario}", "signal", signal, names)
    return signal or signals_by_default(result, scenario)[0]


def rows(result: Result, scenario: str | None, signal: str | None, metric: str) -> pd.DataFrame:
    """Return the rows of stats of one metric, with each varying axis as plain numbers or words."""
    scenario = scenario_of(result, scenario)
    signal, stats = signal_of(result, scenario, signal), result.stats
    if metric not in set(stats.metric):
        raise unknown(f"study {result.study.name}", "metric", metric, sorted(set(stats.metric)))
    part = stats[(stats.scenario == scenario) & (stats.signal == signal) & (stats.metric == metric)].copy()
    for name in axes_of(dict.fromkeys(part.columns)):
        part[name] = [plain(value) for value in part[name]]
    for name in ("mean", "ci_low", "ci_high", "p50"):
        part[name] = np.where(np.abs(part[name]) < ROUNDING, 0.0, part[name])
    return part.reset_index(drop=True)


def plain(value: Any) -> Any:
    """Return an axis' value as a number or a word: of channels that differ with commas."""
    if isinstance(value, np.ndarray | list | tuple):
        return ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
    return value.item() if isinstance(value, np.generic) else value


def varying(part: pd.DataFrame) -> list[str]:
    """Return the axes with more than one value."""
    return [name for name in axes_of(dict.fromkeys(part.columns)) if part[name].nunique(dropna=False) > 1]


def label(axis: str) -> str:
    """Return an axis' title with its unit."""
    unit = "s" if axis == "profile" else AXIS_UNITS.get(axis, "")
    text = axis.removeprefix("plant.").replace("_", " ")
    return f"{text} [{unit}]" if unit not in ("", "1") and axis != "profile" else text


def fixed(part: pd.DataFrame, free: list[str], at: dict[str, Any] | None = None) -> pd.DataFrame:
    """Return the rows in which every varying axis but the `free` has one value: as `at` says, or else its first.

    Raises UserError where `at` names no axis or no value of one.
    """
    for name in at or {}:
        if name not in varying(part):
            raise unknown("at", "axis that varies", name, varying(part))
    for name in [name for name in varying(part) if name not in free]:
        value = (at or {}).get(name, part[name].iloc[0])
        if value not in set(part[name]):
            raise UserError(
                f"at: got {name} = {value!r}, expected one of {sorted(set(part[name]), key=str)}; take one."
            )
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
    signal, runs = signal_of(result, scenario, signal), result.runs_of(scenario, [metric], cell)
    part, out = runs[runs.signal == signal], []
    part = part.assign(**{metric: part[metric].where(~part.diverged)})
    for observer, values in part.groupby("observer", sort=False)[metric]:
        ordered = np.sort(values.to_numpy()[np.isfinite(values.to_numpy())])
        if len(ordered):
            indices = np.unique(np.linspace(0, len(ordered) - 1, min(POINTS, len(ordered))).round().astype(int))
            share = (indices + 1) / len(values)
            ordered = np.where(ordered < ROUNDING, 0.0, ordered)
            out.append(pd.DataFrame({"observer": observer, "value": ordered[indices], "share": share}))
    return pd.concat(out, ignore_index=True) if out else pd.DataFrame({"observer": [], "value": [], "share": []})


def winners(
    result: Result, scenario: str | None = None, signal: str | None = None, metric: str = METRIC
) -> pd.DataFrame:
    """Return for each cell its axes, the `winner` (see `statistics.winning`), its `mean`, and `text`."""
    part = rows(result, scenario, signal, metric)
    scenario, signal = part.scenario.iloc[0], part.signal.iloc[0]
    pairs = result.pairs
    pairs = pairs[(pairs.scenario == scenario) & (pairs.signal == signal) & (pairs.metric == metric)]
    out = []
    for cell, mine in part.groupby("cell", sort=False):
        found = winning.winner(mine, pairs[pairs.cell == cell])
        best = mine.sort_values(["diverged", "mean"], kind="stable").iloc[0]
        known = {name: best[name] for name in varying(part)}
        text = found or ("tie" if np.isfinite(best["mean"]) else "all diverge")
        out.append(known | {"cell": cell, "winner": found, "mean": best["mean"], "text": text})
    return pd.DataFrame(out)


def wide(values: pd.Series) -> bool:
    """Say whether values are drawn on a logarithmic axis: all positive, over more than a decade and a half."""
    found = values[np.isfinite(values)]
    return bool(len(found) and found.min() > 0 and found.max() > WIDE * found.min())


def room(run: pd.DataFrame) -> tuple[float, float]:
    """Return the ends of the axis of one run in time: plant and target, with room; what runs away leaves the picture."""
    mine = run.value[run.kind.isin(["truth", "target"]) & np.isfinite(run.value)]
    low, high = float(mine.min()), float(mine.max())
    beyond = ROOM * (high - low) if high > low else 1.0
    return low - beyond, high + beyond


def with_ends(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table `fair` with the ends `low` and `high` of the 95 % intervals of what is held out."""
    half = 1.96 * table.held_out_se
    return table.assign(low=table.held_out - half, high=table.held_out + half)
