"""A study's results in the terminal: who is better, by how much, and how surely. Heads are the names that the tables use."""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console

from pcbench.cli.render import consistency, folder
from pcbench.cli.render.tables import Column, fits, printed
from pcbench.dataset.columns import unit_of
from pcbench.dataset.result import Result
from pcbench.scenarios import Scenario
from pcbench.statistics.number_format import as_good, difference, fraction, interval, marked
from pcbench.statistics.ranking import by_cell, most_often, standing, stood
from pcbench.study import scenarios_of

LONGEST = 48  # rows of a closing table; beyond, who wins is counted instead
# least first, where there are such
BESIDE = ("rmse", "recovery_time", "steady_tracking_rmse", "settling_time", "lq_cost", "rms_efficiency")
COST = ("sample", "tick", "memory")  # what observers cost
LESS = "less the best"
PAIRED = f"'{LESS}' is paired over the same draws; = is not distinguishable (Holm, 5 %)."
EXACT = "What has no ± is exact: the expected value over all noise. Numbers that only runs have are left out."
COSTS = "sample, tick: multiplications of one run for a sample and for a tick; memory: bytes that are kept from tick to tick."
HALF = "± is half a 95 % interval; one that leans to one side is written by its ends."


class View(NamedTuple):
    """What a closing table shows of a scenario: one signal of it."""

    scenario: Scenario
    stats: pd.DataFrame  # of this signal
    pairs: pd.DataFrame  # of this signal and metric
    metric: str
    costs: pd.DataFrame | None = None  # of its observers, a frame of `pcbench.operation_counts`

    @property
    def title(self) -> str:
        """Return scenario, signal with its unit, and runs, or the schedules that exact numbers are averaged over."""
        ranked = self.stats[self.stats.metric == self.metric]
        runs = ranked[ranked.method == "runs"]
        many, drawn = int((runs.n + runs.diverged).max() if len(runs) else 0), int(ranked.n.max())
        seeds = f"{many:,} seeds" if many else f"exact, {drawn:,} schedules" if drawn else "exact"
        return f"{self.scenario.name}: error of {self.stats.signal.iloc[0]} [{self.unit}], {seeds}"

    @property
    def unit(self) -> str:
        """Return the signal's unit."""
        return str(self.stats[self.stats.metric == "mae"].unit.iloc[0])


def closing(
    result: Result,
    console: Console,
    metric: str,
    signals: list[str] | None = None,
    costs: pd.DataFrame | None = None,
) -> None:
    """Print who was better and how surely, the least mean `metric` first; with `costs`, what observers cost.

    Of every scenario the `signals` that it has; None: those it is known by; an empty list: all.
    """
    stats, pairs, known = result.stats, result.pairs, scenarios_of(result.study)
    metric = result.ranks(metric)
    notes: dict[str, None] = {}
    for name, whole in ((str(name), rows) for name, rows in stats.groupby("scenario", sort=False)):
        there = list(dict.fromkeys(whole.signal))
        chosen = (known[name].scoring.headline or there[:1]) if signals is None else signals or there
        for signal in [s for s in chosen if s in there]:
            part = whole[whole.signal == signal]
            met = pairs[(pairs.scenario == name) & (pairs.signal == signal) & (pairs.metric == metric)]
            shown = View(known[name], part, met, metric, None if costs is None else costs[costs.scenario == name])
            if metric not in set(part.metric):
                console.print(f"{name}: has no {metric} of {signal}.", highlight=False)
            elif part.cell.nunique() * part.observer.nunique() > LONGEST:
                notes |= dict.fromkeys(_counted(shown, console))
            else:
                notes |= dict.fromkeys(_tables(shown, console))
        folder.carried(whole, console)
        notes |= dict.fromkeys(consistency.said(name, whole, console))
        if said := result.unproven(name):
            console.print(said, highlight=False, markup=False, soft_wrap=True)
        folder.settles(known[name], list(result.study.axes), console)
    for note in [*notes, *([COSTS] if costs is not None else [])]:
        console.print(note, highlight=False, markup=False)


def _varying(part: pd.DataFrame) -> list[str]:
    first = list(part.columns).index("cell") + 1
    axes = list(part.columns)[first : list(part.columns).index("signal")]
    return [a for a in axes if part[a].astype(str).nunique() > 1]


def _tables(shown: View, console: Console) -> list[str]:
    """Print the cells in one table, or where that is too wide each in its own; return what a reader has to know of them."""
    axes = _varying(shown.stats)
    cells = [cell for _, cell in shown.stats.groupby("cell", sort=True)]
    columns = _columns(shown, cells, axes)
    groups = [(shown.title, cells, columns)]
    if axes and not fits(columns, console):
        at = [", ".join(f"{a} = {_axis(cell[a].iloc[0])}" for a in axes) for cell in cells]
        groups = [
            (f"{shown.title}, {where}", [cell], _columns(shown, [cell], []))
            for where, cell in zip(at, cells, strict=True)
        ]
    left_out: dict[str, None] = {}
    for title, mine, each in groups:
        left_out |= dict.fromkeys(printed(title, each, console, [cell.observer.nunique() for cell in mine]))
    paired = [PAIRED] if any(cell.observer.nunique() > 1 for cell in cells) else []
    exact = shown.stats.method.eq("exact").any()
    half = [EXACT] if exact else []
    if not exact or shown.stats.method.eq("runs").any():
        half.append(HALF)
    return [
        *half,
        *(paired if not exact else []),
        *([f"Left out for want of room: {', '.join(left_out)}."] if left_out else []),
    ]


def _columns(shown: View, cells: list[pd.DataFrame], axes: list[str]) -> list[Column]:
    """The columns of some cells, best observers first: what ranks them, by how much, and what else there is."""
    metric, there = shown.metric, set(shown.stats.metric)
    filled = set(shown.stats.metric[shown.stats["mean"].notna()])
    exact = ["pooled_rmse"] if "rmse" in there - filled else []
    beside = [m for m in (*exact, *BESIDE, consistency.HEAD) if m in filled and m != metric]
    values: dict[str, list[str]] = {name: [] for name in (*axes, "observer", metric, LESS, *beside, "divergence_rate")}
    bold: set[int] = set()
    for cell in cells:
        wide = cell.set_index(["observer", "metric"])
        met = shown.pairs[shown.pairs.cell == cell.cell.iloc[0]]
        found = standing(cell[cell.metric == metric], met)
        order = found.order
        for observer in order:
            best = observer == order[0]
            for axis in axes:
                values[axis].append(_axis(cell[axis].iloc[0]) if best else "")
            name = marked(observer, [wide.loc[(observer, metric), "certified"]])
            values["observer"].append(name)
            bold |= {len(values["observer"]) - 1} if observer in found.leaders else set()
            values[metric].append(interval(wide.loc[observer, metric]))
            values[LESS].append("" if best else difference(met, observer, order[0]))
            for name in beside:
                values[name].append(_beside(wide, observer, name, shown.scenario.duration))
            values["divergence_rate"].append(fraction(wide.loc[observer, "divergence_rate"]))
            for name in COST if shown.costs is not None else ():
                values.setdefault(name, []).append(_cost(shown.costs, cell.cell.iloc[0], observer, name))
    lost, several = bool(shown.stats.diverged.any()), len(set(values["observer"])) > 1
    columns = [Column(axis, values[axis]) for axis in axes]
    columns += [
        Column("observer", values["observer"], left=True, bold=frozenset(bold)),
        Column(_head(shown, metric), values[metric]),
    ]
    columns += [Column(LESS, values[LESS])] if several else []
    columns += [Column("diverged", values["divergence_rate"])] if lost else []
    columns += [Column(name, values[name]) for name in COST if name in values]
    return columns + [
        Column(_head(shown, name), values[name], spare=1 + len(beside) - beside.index(name)) for name in beside[::-1]
    ]


def _cost(costs: Any, cell: int, observer: str, name: str) -> str:
    mine = costs[(costs.cell == cell) & (costs.observer == observer)]
    return f"{mine[name].iloc[0]:,}" if len(mine) else ""


def _head(shown: View, metric: str) -> str:
    """A metric's name, with its unit where that is not the signal's, and what it is of its runs where that is no mean."""
    own = unit_of(metric, shown.unit)
    unit = f" [{own}]" if own not in (shown.unit, "1") else ""
    return f"median\n{metric}{unit}" if metric == "settling_time" and metric != shown.metric else metric + unit


def _beside(wide: Any, observer: str, metric: str, horizon: float) -> str:
    if (observer, metric) not in wide.index:
        return ""
    if metric == consistency.HEAD:
        return consistency.judged(wide, observer, metric)
    row = wide.loc[observer, metric]
    return settled(row, horizon) if metric == "settling_time" else interval(row)


def settled(row: Any, horizon: float) -> str:
    """The median settling time; 'never' where most runs were outside their band at the end."""
    return "-" if np.isnan(row["p50"]) else "never" if row["p50"] >= horizon else f"{row['p50']:.3g}"


def _axis(value: Any) -> str:
    """A value of an axis; one for each channel with commas."""
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, np.ndarray) else str(value)


def _counted(shown: View, console: Console) -> list[str]:
    """Print how many cells each observer wins; return what a reader has to know."""
    part, metric = shown.stats[shown.stats.metric == shown.metric], shown.metric
    met = by_cell(shown.pairs)
    leaders = [stood(rows, met.get(cell, [])).leaders for cell, rows in by_cell(part).items()]
    won = Counter(each[0] for each in leaders if len(each) == 1)
    led = Counter(name for each in leaders for name in each)
    each = part.groupby("observer", sort=False)
    order = sorted(each, key=lambda item: (-won[str(item[0])], np.nan_to_num(item[1]["mean"].median(), nan=np.inf)))
    unit = unit_of(metric, part.unit.iloc[0])
    columns = [
        Column("observer", [marked(str(name), mine.certified) for name, mine in order], left=True),
        Column("cells won", [str(won[str(name)]) for name, _ in order]),
        Column("as good as\nthe best", [str(led[str(name)]) for name, _ in order]),
        Column(
            f"median {metric} [{unit}]",
            ["-" if np.isnan(m := mine["mean"].median()) else f"{m:.4g}" for _, mine in order],
        ),
    ]
    if part.diverged.any():
        lost = [f"{100 * m.diverged.sum() / (m.n + m.diverged).sum():.3g} %" for _, m in order]
        columns.append(Column("runs diverged", lost))
    cells = part.cell.nunique()
    signal, fewest = part.signal.iloc[0], " among those with fewest diverged runs" if part.diverged.any() else ""
    title = f"{shown.scenario.name}: least {metric} of {signal}{fewest}, over {cells:,} cells"
    printed(title, columns, console)
    names, most = most_often(leaders)
    return [
        f"An observer wins a cell if it is significantly better than every other (paired t-test, Holm, 5 %); "
        f"{cells - won.total():,} of {cells:,} cells have no winner.",
        *([f"{shown.scenario.name}: {as_good(names, most, cells)}."] if most and not won else []),
    ]
