"""Closing tables of a study: ranked observers with differences and significance, filter consistency, and run times.

The heads are the column names of the tables.
"""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.cli.render.tables import Column, Screen, format_number, omission_note
from pcbench.dataset.columns import unit_of
from pcbench.dataset.result import Result
from pcbench.limits.search import settles_sentence
from pcbench.scenarios import Scenario
from pcbench.statistics import OF_RUN
from pcbench.statistics.consistency import BANDS, Band, exact_band, verdict
from pcbench.statistics.number_format import as_good, difference, fraction, interval, mark_uncertified
from pcbench.statistics.ranking import by_cell, most_often, standing, standing_of
from pcbench.study import scenarios_of, title_of_scenario

LONGEST = 48  # largest number of rows of a closing table; for more, wins are counted
LONGEST_CONSISTENCY = 24  # largest number of rows; for more, verdicts are counted
# columns in this order, if they exist
EXTRA_METRICS = (
    *("rmse", "recovery_time", "steady_tracking_rmse", "settling_time", "lq_cost", "rms_efficiency"),
    *("interval_coverage", "interval_width", "sent_fraction"),
)
COST = ("sample", "tick", "memory")  # operation counts of observers
LESS = "diff. to best"
PAIRED = f"'{LESS}' compares runs with the same noise; = is not significant (paired t-test, Holm, 5 %)."
EXACT = "Numbers without ± are exact: expected values over all noise. Metrics that need runs are left out."
COSTS = "sample, tick: multiplications per sample and per tick of one run; memory: bytes stored from tick to tick."
HALF = "± is half the width of a 95 % interval. An asymmetric interval is written as (lower .. upper)."
SQUARE = "signal_nees"  # in the closing table
SQUARES = ("nees", "nis")  # in the consistency table
MEANS = (
    "nees is the squared error divided by its covariance, nis the squared innovation divided by its covariance, both per "
    "degree of freedom. In brackets: the 95 % band if the covariance is correct."
)


class View(NamedTuple):
    """One signal of a scenario in a closing table."""

    scenario: Scenario
    stats: pd.DataFrame  # of this signal
    pairs: pd.DataFrame  # of this signal and metric
    metric: str
    costs: pd.DataFrame | None = None  # of its observers, a frame of `pcbench.operation_counts`

    @property
    def title(self) -> str:
        """Return scenario, signal with its unit, and number of runs; for exact numbers the number of averaged schedules."""
        rows = self.stats[self.stats.metric == self.metric]
        runs = rows[rows.method == "runs"]
        n_runs, n_schedules = int((runs.n + runs.diverged).max() if len(runs) else 0), int(rows.n.max())
        seeds = f"{n_runs:,} seeds" if n_runs else f"exact, {n_schedules:,} schedules" if n_schedules else "exact"
        return f"{self.scenario.name}: error of {self.stats.signal.iloc[0]} [{self.unit}], {seeds}"

    @property
    def unit(self) -> str:
        """Return the signal's unit."""
        return str(self.stats[self.stats.metric == "mae"].unit.iloc[0])


def closing(
    result: Result, screen: Screen, metric: str, signals: list[str] | None = None, costs: pd.DataFrame | None = None
) -> None:
    """Print the ranking of observers with its significance, the smallest mean `metric` first; with `costs`, operation counts.

    For each scenario the `signals` that it has; None: its main signals; an empty list: all.
    """
    stats, pairs, scenarios = result.stats, result.pairs, scenarios_of(result.study)
    metric = result.ranks(metric)
    notes: dict[str, None] = {}
    for name, rows in ((str(name), rows) for name, rows in stats.groupby("scenario", sort=False)):
        available = list(dict.fromkeys(rows.signal))
        headline = available[:1] if metric in OF_RUN else scenarios[name].scoring.headline or available[:1]
        selection = headline if signals is None else signals or available
        for signal in [s for s in selection if s in available]:
            mask = rows.signal == signal
            part = pd.concat([rows[mask], rows[~mask & rows.metric.isin(OF_RUN)]])  # metrics with one number per run
            signal_pairs = pairs[(pairs.scenario == name) & (pairs.signal == signal) & (pairs.metric == metric)]
            scenario = scenarios[name]._replace(name=title_of_scenario(result.study, name))
            view = View(scenario, part, signal_pairs, metric, None if costs is None else costs[costs.scenario == name])
            if metric not in set(part.metric):
                screen.print(f"{title_of_scenario(result.study, name)}: {signal} has no {metric}.")
            else:
                is_large = part.cell.nunique() * part.observer.nunique() > LONGEST
                notes |= dict.fromkeys((_count_wins if is_large else _print_cells)(view, screen))
        predictions = rows[["observer", "predicts_unknown_input"]].dropna().drop_duplicates()
        for value, text in ((True, "includes"), (False, "does not include")):
            if names := ", ".join(dict.fromkeys(predictions.observer[predictions.predicts_unknown_input == value])):
                screen.print(f"The prediction to the present {text} the estimated unknown input: {names}.")
        notes |= dict.fromkeys(print_consistency(name, rows, screen))
        screen.say(*filter(None, [result.unproven(name)]))
        if sentence := settles_sentence(scenarios[name], result.study.axes):
            screen.print(sentence)
    for note in [*notes, *([COSTS] if costs is not None else [])]:
        screen.print(note)
    screen.explain_acronyms(stats.observer.unique())


def _print_cells(view: View, screen: Screen) -> list[str]:
    """Print the grid points in one table, or separately if that is too wide; return notes for the reader."""
    names = list(view.stats.columns)
    axis_columns = names[names.index("cell") + 1 : names.index("signal")]
    axes = [a for a in axis_columns if view.stats[a].astype(str).nunique() > 1]
    cells = [cell for _, cell in view.stats.groupby("cell", sort=True)]
    groups = [(view.title, cells, _columns(view, cells, axes))]
    if axes and not screen.fits(groups[0][2]):
        places = [", ".join(f"{a} = {_axis_value(cell[a].iloc[0])}" for a in axes) for cell in cells]
        groups = [
            (f"{view.title}, {place}", [cell], _columns(view, [cell], []))
            for place, cell in zip(places, cells, strict=True)
        ]
    missing: dict[str, None] = {}
    for title, group, columns in groups:
        sections = [cell.observer.nunique() for cell in group]
        missing |= dict.fromkeys(screen.fit(title, columns, sections, named=False))
    methods = set(view.stats.method)
    notes = [EXACT] if "exact" in methods else []
    notes += [HALF] if "exact" not in methods or "runs" in methods else []
    if "exact" not in methods and any(cell.observer.nunique() > 1 for cell in cells):
        notes.append(PAIRED)
    return notes + ([omission_note(list(missing))] if missing else [])


def _columns(view: View, cells: list[pd.DataFrame], axes: list[str]) -> list[Column]:
    """Return the columns for some grid points, best observers first: the metric, the difference to the best, and others."""
    metric, costs = view.metric, view.costs
    metrics = set(view.stats.metric[view.stats["mean"].notna()])
    pooled = ["pooled_rmse"] if "rmse" in set(view.stats.metric) - metrics else []
    extra = [m for m in (*pooled, *EXTRA_METRICS, SQUARE) if m in metrics and m != metric]
    cost_names = COST if costs is not None else ()
    values: dict[str, list[str]] = {
        name: [] for name in (*axes, "observer", metric, LESS, *extra, "divergence_rate", *cost_names)
    }
    bold: set[int] = set()
    for cell in cells:
        number, by_metric = cell.cell.iloc[0], cell.set_index(["observer", "metric"])
        cell_pairs = view.pairs[view.pairs.cell == number]
        ranking = standing(cell[cell.metric == metric], cell_pairs)
        for observer in ranking.order:
            best = observer == ranking.order[0]
            if observer in ranking.leaders:
                bold.add(len(values["observer"]))
            row = {axis: _axis_value(cell[axis].iloc[0]) if best else "" for axis in axes}
            row["observer"] = mark_uncertified(observer, [by_metric.loc[(observer, metric), "certified"]])
            row[metric] = interval(by_metric.loc[observer, metric])
            row[LESS] = "" if best else difference(cell_pairs, observer, ranking.order[0])
            row |= {name: _format_metric(by_metric, observer, name, view.scenario.duration) for name in extra}
            row["divergence_rate"] = fraction(by_metric.loc[observer, "divergence_rate"])
            if costs is not None:
                counts = costs[(costs.cell == number) & (costs.observer == observer)]
                row |= {name: f"{counts[name].iloc[0]:,}" if len(counts) else "" for name in cost_names}
            for name, text in row.items():
                values[name].append(text)

    def head(name: str) -> str:
        """Return a metric's name, with its unit if it differs from the signal's, and its statistic if that is not the mean."""
        metric_unit = unit_of(name, view.unit)
        unit = f" [{metric_unit}]" if metric_unit not in (view.unit, "1") else ""
        return f"median\n{name}{unit}" if name == "settling_time" and name != metric else name + unit

    columns = [Column(axis, values[axis]) for axis in axes]
    columns.append(Column("observer", values["observer"], is_text=True, bold=frozenset(bold)))
    columns.append(Column(head(metric), values[metric]))
    columns += [Column(LESS, values[LESS])] if len(set(values["observer"])) > 1 else []
    columns += [Column("diverged", values["divergence_rate"])] if view.stats.diverged.any() else []
    columns += [Column(name, values[name]) for name in cost_names]
    return columns + [
        Column(head(name), values[name], spare=1 + len(extra) - extra.index(name)) for name in extra[::-1]
    ]


def _format_metric(by_metric: pd.DataFrame, observer: str, metric: str, horizon: float) -> str:
    if (observer, metric) not in by_metric.index:
        return ""
    if metric == SQUARE:
        return _judgement(by_metric, observer, metric)
    row = by_metric.loc[observer, metric]
    return format_settling_time(row, horizon) if metric == "settling_time" else interval(row)


def format_settling_time(row: Any, horizon: float) -> str:
    """Return the median settling time; 'never' if most runs were outside their band at the end."""
    return "never" if row["p50"] >= horizon else format_number(row["p50"], ".3g")


def _axis_value(value: object) -> str:
    """Return a value of an axis as text; one per channel with commas."""
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, np.ndarray) else str(value)


def _count_wins(view: View, screen: Screen) -> list[str]:
    """Print how many grid points each observer wins; return notes for the reader."""
    part, metric, name = view.stats[view.stats.metric == view.metric], view.metric, view.scenario.name
    pairs = by_cell(view.pairs)
    leaders = [standing_of(rows, pairs.get(cell, [])).leaders for cell, rows in by_cell(part).items()]
    wins = Counter(group[0] for group in leaders if len(group) == 1)
    shared_wins = Counter(observer for group in leaders for observer in group)
    rows = [(str(observer), g, g["mean"].median()) for observer, g in part.groupby("observer", sort=False)]
    rows.sort(key=lambda row: (-wins[row[0]], np.nan_to_num(row[2], nan=np.inf)))
    unit = unit_of(metric, part.unit.iloc[0])
    columns = [
        Column("observer", [mark_uncertified(o, g.certified) for o, g, _ in rows], is_text=True),
        Column("grid points\nwon", [str(wins[o]) for o, _, _ in rows]),
        Column("as good as\nthe best", [str(shared_wins[o]) for o, _, _ in rows]),
        Column(f"median {metric} [{unit}]", [format_number(median) for _, _, median in rows]),
    ]
    has_diverged = part.diverged.any()
    if has_diverged:
        shares = [100 * g.diverged.sum() / (g.n + g.diverged).sum() for _, g, _ in rows]
        columns.append(Column("runs diverged", [f"{share:.3g} %" for share in shares]))
    cells, fewest = part.cell.nunique(), " among those with the fewest diverged runs" if has_diverged else ""
    screen.fit(f"{name}: least {metric} of {part.signal.iloc[0]}{fewest}, over {cells:,} grid points", columns)
    names, most = most_often(leaders)
    return [
        f"An observer wins a grid point if it is significantly better than every other (paired t-test, Holm, 5 %); "
        f"{cells - wins.total():,} of {cells:,} grid points have no winner.",
        *([f"{name}: {as_good(names, most, cells)}."] if most and not wins else []),
    ]


def print_consistency(name: str, stats: pd.DataFrame, screen: Screen) -> list[str]:
    """Print NEES and NIS of observers with a covariance, with verdicts; return the notes below the table."""
    part = stats[stats.metric.isin([*SQUARES, *(BANDS[m] for m in SQUARES)])]
    keys = ["observer", "metric"]
    cells = [(str(c), r.drop_duplicates(keys).set_index(keys)) for c, r in part.groupby("cell", sort=False)]
    rows = [
        (cell, o, by_metric)
        for cell, by_metric in cells
        for o in dict.fromkeys(by_metric.index.get_level_values("observer"))
    ]
    verdicts = {metric: [_judgement(by_metric, o, metric) for _, o, by_metric in rows] for metric in SQUARES}
    if not any(text for texts in verdicts.values() for text in texts):
        return []
    names = [o for _, o, _ in rows]
    columns = [Column("grid point", [cell for cell, _, _ in rows])] if len(cells) > 1 else []
    columns.append(Column("observer", names, is_text=True))
    if len(rows) > LONGEST_CONSISTENCY:
        columns = [Column("observer", list(dict.fromkeys(names)), is_text=True)]
    for metric, texts in verdicts.items():
        if len(rows) > LONGEST_CONSISTENCY:
            words: dict[str, Counter[str]] = {o: Counter() for o in names}
            for o, text in zip(names, texts, strict=True):
                words[o].update(filter(None, [text.partition(" ")[2]]))
            counts = [", ".join(f"{word} {n}" for word, n in counter.most_common()) for counter in words.values()]
            columns.append(Column(f"{metric}: grid points", counts, is_text=True))
        else:
            bands = [_band(by_metric, o, metric) for _, o, by_metric in rows]
            suffixes = ["" if band == exact_band() else f" ({band.low:.3g} .. {band.high:.3g})" for band in bands]
            columns.append(Column(metric, [t and t + a for t, a in zip(texts, suffixes, strict=True)], is_text=True))
    screen.fit(f"{name}: consistency of the filters", [c for c in columns if any(c.cells)])
    return [MEANS]


def _judgement(by_metric: Any, observer: str, metric: str) -> str:
    """Return a mean normalized square with its verdict, from rows by observer and metric; empty if there is none."""
    if (observer, metric) not in by_metric.index or np.isnan(value := by_metric.loc[(observer, metric), "mean"]):
        return ""
    return f"{value:.3g} {verdict(value, _band(by_metric, observer, metric))}"


def _band(by_metric: Any, observer: str, metric: str) -> Band:
    """Return the interval of the mean for a correct covariance; 1 for an exact value."""
    if (observer, BANDS[metric]) not in by_metric.index:
        return exact_band()
    row = by_metric.loc[(observer, BANDS[metric])]
    return Band(row["ci_low"], row["ci_high"])


def closing_sentence(result: Result, folder: str) -> str:
    """Return what a run added and how long it took, in a sentence."""
    p = result.provenance
    if not result.cost.runs and result.exact and not p["blocks"]:
        cells = result.stats.groupby(["scenario", "cell"]).ngroups
        return f"Exact numbers of {'one grid point' if cells == 1 else f'{cells:,} grid points'} are in {folder}."
    if result.study.evaluation == "exact" and not result.exact:
        if p["blocks"] and result.stats.reason.isna().any():
            return (
                f"The tables in {folder} contain its runs, and exact moments are stored next to them: compare them with "
                f"pcbench verify {folder} --exact, or give another folder with --out for tables of exact numbers."
            )
        return f"No number in {folder} is exact: the column `reason` of stats.parquet explains why."
    if not result.cost.runs:
        return f"All runs were complete already: {p['blocks']} blocks in {folder}."
    parts = f"compiling {p['compile_seconds']:.1f} s, writing {p['writing_seconds']:.1f} s, summed over threads"
    runs = f"{p['runs_added']:,} run{'s' * (p['runs_added'] != 1)} added"
    return f"{runs}; results in {folder} after {p['wall_seconds']:.1f} s ({parts})."


def timings(result: Result, seconds: float) -> list[str]:
    """Return the times of the parts of a run, one line each; `seconds` since the command began."""
    p, cost = result.provenance, result.cost
    if not cost.runs and not cost.exact_seconds:
        return []
    before = max(seconds - p["wall_seconds"], 0.0)
    rows = [("from the command to the study", before, "imports, reading, tuning")]
    if cost.exact_seconds:
        rows.append(("exact numbers", cost.exact_seconds, "planning, solving and writing them"))
    if cost.runs:
        programs = f"on all threads, {p['compile_seconds']:.1f} s of it compiling"
        rows += [
            ("planning", p["planning_seconds"], "designs, schedules, bounds"),
            ("computing", p["computing_seconds"], programs),
            ("writing", p["writing_seconds"], "on all threads"),
            ("closing tables", p["closing_seconds"], "statistics of the runs"),
        ]
    rows.append(("the whole study", p["wall_seconds"], f"{p['runs_added']:,} runs" if cost.runs else ""))
    return [f"{part:<30}{t:9.2f} s   {note}".rstrip() for part, t, note in rows]
