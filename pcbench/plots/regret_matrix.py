"""Regret matrix: the error of each observer in each situation, divided by that of the situation's best.

A situation is a scenario at a grid point. Its best has the fewest diverged runs and then the least error, as in tables, so a
ratio is below 1 if an observer that diverges more often has less error in its other runs. Situations in which the error of the
best is 0 are left out. The errors of the best are the last row: how much a wrong assumption costs shows only there.
"""

from collections.abc import Mapping
from itertools import pairwise
from math import ceil, floor, inf, isfinite, log10
from typing import NamedTuple, cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import offset_copy

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, layout
from pcbench.plots.labels import describe_metric, describe_runs, unit_of, with_unit
from pcbench.plots.layout import PAPER, Paper, sheet
from pcbench.plots.maps import LOST
from pcbench.plots.palette import GRID, SOFT, ink_on
from pcbench.statistics.aggregate import Row
from pcbench.statistics.number_format import ROUNDING
from pcbench.statistics.ranking import diverges_more
from pcbench.study import title_of_scenario

COLUMNS = 16  # situations side by side
HUGE = 99_500.0  # a ratio from here on is written as a power of ten
MOST = 48  # situations; of more there is no matrix
ROW, CELL, BESIDE = 0.21, 0.36, 0.3  # inches: of a row, of a column, of the margin
SECOND = 0.11  # inches that a row with shares of diverged runs is higher
LINE, SEPARATOR = 1.45, " | "  # between lines of labels [heights of letters]; between words of one
DARKEST = 10.0  # at least the ratio with the darkest colour
SMALL = 0.01  # an error below it is written with a power of ten
HATCH = "#C4C4C499"  # of cells that are not significant
DIVERGED = " diverged"
KEYS = (1.0, 2.0, 5.0, 10.0, 100.0)
COLOURS = LinearSegmentedColormap.from_list("regrets", ["#FFFFFF", "#A9C1DA", "#5A88B8", "#1B4674"])
DIVERGING = to_hex(LOST(1.0))  # of cells whose observer diverges significantly more often than the best


class Level(NamedTuple):
    """What varies between the columns: an axis, or the scenario."""

    name: str  # with its unit; empty: the words say it
    words: list[str]  # one per situation

    def spans(self, outer: "list[Level]", columns: range) -> list[tuple[str, int, int]]:
        """Return each word with its first and its last column, those of equal words as one."""
        keys = [(*(level.words[i] for level in outer), self.words[i]) for i in columns]
        starts = [i for i in range(len(keys)) if not i or keys[i] != keys[i - 1]]
        return [(keys[a][-1], a, b - 1) for a, b in pairwise([*starts, len(keys)])]


class Regrets(NamedTuple):
    """The regrets of observers in situations."""

    # situation, scenario, signal, cell, observer, ratio (inf: every run diverged), best, worse (significantly),
    # diverged (share), more (diverges significantly more often than the best)
    rows: pd.DataFrame
    observers: list[str]  # those that run in most situations first, then in order of their worst case
    situations: list[str]
    runs: int  # 0: exact
    signals: list[str]
    levels: list[Level]  # of the labels of the columns, the outermost first
    least: dict[str, float]  # the error of the best of each situation
    unit: str  # of the errors of the best; empty: their units differ

    @property
    def ties(self) -> pd.Series:
        """Return which rows are hatched: neither the best nor significantly worse."""
        return ~(self.rows.best | self.rows.worse)

    @property
    def tie(self) -> str:
        """Return what hatched cells are, in words."""
        return "not significant" if self.runs else "equal"

    @property
    def largest(self) -> dict[str, float]:
        """Return the largest ratio of each observer."""
        return {o: float(self.rows.ratio[self.rows.observer == o].max()) for o in self.observers}

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of situations in which each observer runs."""
        return {o: int((self.rows.observer == o).sum()) for o in self.observers}

    @property
    def penalised(self) -> pd.Series:
        """Return the ratios at least 1, and infinite where an observer diverges significantly more often than the best."""
        return self.rows.ratio.clip(lower=1.0).where(~self.rows.more.astype(bool), inf)

    @property
    def worst(self) -> dict[str, float]:
        """Return the largest penalised ratio of each observer."""
        return {o: float(self.penalised[self.rows.observer == o].max()) for o in self.observers}


def regrets_of(
    result: Result, metric: str = frames.METRIC, signals: list[str] | None = None, most: int | None = MOST
) -> Regrets | None:
    """Return the regrets over all scenarios and grid points; None if they are fewer than two, or more than `most`.

    Of each scenario, the first main signal is taken, or the first of `signals` that it has.
    """
    metric = result.ranks(metric)
    parts, signal_names, runs = list[pd.DataFrame](), dict[str, None](), 0
    signal_parts, points, lowest = list[pd.DataFrame](), dict[str, tuple[str, int]](), dict[str, float]()
    for scenario in result.scenarios:
        for signal in frames.signals_with_metric(result, scenario, signals, metric)[:1]:
            part, standings = (f(result, scenario, signal, metric) for f in (frames.rows, frames.standings))
            equal = zip(standings.cell, standings.leaders, standings.alike, strict=True)
            leaders = {cell: {*leader_names, *alike} for cell, leader_names, alike in equal}
            best = dict(zip(standings.cell, standings.best, strict=True))
            errors = standings.set_index("cell")["mean"]  # of the best
            least = part.cell.map(errors.fillna(part.groupby("cell")["mean"].min()))
            titles = frames.axis_titles(result, part)
            names = {cell: _situation(result, part, cell, titles) for cell in best}
            points |= {name: (scenario, cell) for cell, name in names.items()}
            lowest |= {name: float(least[part.cell == cell].iloc[0]) for cell, name in names.items()}
            signal_parts.append(part)
            rows = pd.DataFrame({"situation": part.cell.map(names), "observer": part.observer.astype(str)})
            rows = rows.assign(scenario=scenario, signal=signal, cell=part.cell)
            rows["ratio"] = np.where(np.isfinite(part["mean"]), part["mean"] / least.where(least > ROUNDING), inf)
            rows["best"] = [o == best[c] for o, c in zip(part.observer, part.cell, strict=True)]
            rows["worse"] = [
                o not in leaders[c] and o != best[c] for o, c in zip(part.observer, part.cell, strict=True)
            ]
            rows["diverged"] = (part.diverged / (part.n + part.diverged).clip(lower=1)).to_numpy()
            records = cast(list[Row], part.to_dict("records"))
            first = {row["cell"]: row for row in records if row["observer"] == best[row["cell"]]}
            rows["more"] = [row["cell"] in first and diverges_more(first[row["cell"]], row) for row in records]
            parts.append(rows[(least > ROUNDING).to_numpy()])
            signal_names[signal] = None
            runs = max(runs, frames.count_runs(part))
    all_rows = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"situation": [], "observer": []})
    situations, observers = (list(dict.fromkeys(all_rows[name])) for name in ("situation", "observer"))
    if len(observers) < 2 or not 2 <= len(situations) <= (most or len(situations)):
        return None
    levels = _levels(result, signal_parts, {name: points[name] for name in situations})
    units = {unit_of(part) for part in signal_parts}
    matrix = Regrets(
        rows=all_rows,
        observers=observers,
        situations=situations,
        runs=runs,
        signals=list(signal_names),
        levels=levels,
        least={name: lowest[name] for name in situations},
        unit=units.pop() if len(units) == 1 else "",
    )
    worst, counts = matrix.worst, matrix.counts
    return matrix._replace(observers=sorted(observers, key=lambda o: (-counts[o], worst[o])))


def _situation(result: Result, part: pd.DataFrame, cell: int, titles: Mapping[str, frames.AxisTitle]) -> str:
    """Return the name of a scenario at a grid point: what differs from others of the study."""
    words = [frames.format_axis(axis, value, titles) for axis, value in frames.named_values(result, part, cell).items()]
    several = len(result.scenarios) > 1
    return ", ".join([title_of_scenario(result.study, part.scenario.iloc[0])] * (several or not words) + words)


def _levels(result: Result, parts: list[pd.DataFrame], situations: dict[str, tuple[str, int]]) -> list[Level]:
    """Return what varies between situations, of which each is a scenario and a grid point; `parts` are rows of the scenarios.

    The begin of the names that all scenarios have in common is left out.
    """
    if result.study.vary != "all":
        return [Level("", list(situations))]
    by = {part.scenario.iloc[0]: part for part in parts}
    titles = [title_of_scenario(result.study, scenario) for scenario, _ in situations.values()]
    levels = [Level("", [title.removeprefix(_common_prefix(titles)) for title in titles])]
    values = [frames.values_at(by[scenario], cell) for scenario, cell in situations.values()]
    for axis in result.study.axes:
        names = {frames.label(axis, frames.axis_titles(result, part)) for part in parts}
        name = names.pop() if len(names) == 1 else frames.label(axis).partition(" [")[0]
        levels.append(Level(name, [frames.word(axis, point[axis]) if axis in point else "" for point in values]))
    return [level for level in levels if len(set(level.words)) > 1]


def _common_prefix(names: list[str]) -> str:
    """Return the part up to the first / with which all names begin."""
    begins = {name.partition("/")[0] + "/" if "/" in name else "" for name in names}
    return begins.pop() if len(begins) == 1 else ""


def regrets(
    result: Result, *, metric: str = frames.METRIC, signals: list[str] | None = None, paper: Paper = PAPER
) -> Figure:
    """Return a matrix of observers and situations: the error divided by that of the situation's best.

    A situation is a scenario at a grid point; `signals` selects their signals (None: the first main signal of each). The best
    has the fewest diverged runs and then the least error. Rows: observers that run in most situations are first, and of these
    the one with the smallest worst case, in which an observer that diverges significantly more often than the best is worse
    than any that does not. Hatched: not significantly worse than the best (paired t-test, Holm, 5 %). Below a ratio: the share
    of runs that diverged, if any did. Raises UserError for an unknown name, and if the study has fewer than two situations or
    observers.
    """
    matrix = regrets_of(result, metric, signals, None)
    if matrix is None:
        raise UserError(
            f"plots.regrets: got fewer than two observers or situations with an error above 0 in {result.study.name}, "
            "expected two; give the study an axis with several values or several scenarios."
        )
    finite = matrix.rows.ratio[np.isfinite(matrix.rows.ratio)]
    darkest = max(DARKEST, float(finite.max()))
    norm = LogNorm(1.0, darkest)
    n_situations = len(matrix.situations)
    panels = ceil(n_situations / COLUMNS)
    columns = ceil(n_situations / panels)
    parts = [range(i, min(i + columns, n_situations)) for i in range(0, n_situations, columns)]
    power, least = _scale_errors(list(matrix.least.values()))
    unit = f"{layout.number(10.0**power)} {matrix.unit}".strip() if power else matrix.unit
    rows = [*matrix.observers, *([with_unit("best", unit)] if matrix.unit else [])]
    observers = max(paper.width_of(name, 1) for name in rows)
    names = max(observers, *(paper.width_of(level.name, 1) for level in matrix.levels))
    narrow = max([CELL, *(paper.width_of(word, 2) + 0.6 * paper.em for word in least if matrix.unit)])
    cell = max(narrow, _cell_width(matrix.levels, parts, paper))
    shares = matrix.rows.diverged[np.isfinite(matrix.rows.ratio)]
    has_shares = bool((shares > 0).any())
    if has_shares:
        words = max(paper.width_of(format_share(share), 3) for share in shares) + 0.6 * paper.em
        cell = max(cell, words if names + words * columns + BESIDE <= paper.full else 0.0)
    row_height = ROW + SECOND * has_shares
    upright = names + cell * columns + BESIDE > paper.full
    if upright:
        names, cell = observers, narrow
        below = max(paper.width_of(label, 1) for label in _labels(matrix.levels)) + paper.em
    else:
        below = len(matrix.levels) * LINE * paper.em + 0.5 * paper.em
    test = " (paired t-test, Holm, 5 %)" if matrix.runs > 1 else ""
    subject = describe_metric(result.ranks(metric), " or ".join(matrix.signals))
    titles = [level.name for level in matrix.levels if level.name and upright]
    parts_of_title = [
        f"{subject} / that of the column's best [-]",
        _common_title(result, matrix),
        describe_runs(matrix.runs),
    ]
    parts_of_title += [f"hatched: {matrix.tie}{test}"] * bool(matrix.ties.any())
    parts_of_title += ["below a ratio: diverged runs"] * has_shares
    parts_of_title += [f"columns: {SEPARATOR.join(titles)}"] if titles else []
    keys = [Patch(facecolor=COLOURS(norm(v)), edgecolor=SOFT, linewidth=0.4, label=f"{layout.number(v)}")
            for v in KEYS if v <= darkest]  # fmt: skip
    if matrix.ties.any():
        keys.append(Patch(facecolor="white", edgecolor=SOFT, hatch="/////", linewidth=0.0, label=matrix.tie))
    if matrix.rows.more.any():
        keys.append(
            Patch(facecolor=DIVERGING, edgecolor=SOFT, linewidth=0.4, label="diverges significantly more often")
        )
    with sheet(
        paper,
        ", ".join(parts_of_title),
        panels,
        height=row_height * len(rows) + below,
        width=max(paper.width, min(paper.full, names + cell * columns + BESIDE)),
        keys=keys,
    ) as (figure, axes):
        for ax, part in zip(axes, parts, strict=True):
            _draw_panel(ax, matrix, part, norm, paper, cell)
            ax.set(ylim=(len(rows) - 0.5, -0.5))
            ax.set_yticks(range(len(rows)), rows)
            for x, i in enumerate(part if matrix.unit else ()):
                ax.text(x, len(matrix.observers), least[i], ha="center", va="center", fontsize=paper.size - 2, color=SOFT,
                        in_layout=False)  # fmt: skip
            if upright:
                ax.set_xticks(range(len(part)), [_labels(matrix.levels)[i] for i in part], rotation=90)
            else:
                _draw_levels(ax, matrix.levels, part, paper)
    return figure


def _common_title(result: Result, matrix: Regrets) -> str:
    """Return the study's name, with the scenario or the begin of the names of all scenarios."""
    scenarios = [title_of_scenario(result.study, name) for name in dict.fromkeys(matrix.rows.scenario)]
    prefix = scenarios[0] if len(scenarios) == 1 else _common_prefix(scenarios).rstrip("/")
    return ", ".join(dict.fromkeys(filter(None, [result.study.name, prefix])))


def _cell_width(levels: list[Level], parts: list[range], paper: Paper) -> float:
    """Return how wide columns are in inches, so that horizontal labels fit."""
    widths = [
        (paper.width_of(word, 1) + 0.8 * paper.em) / (last - first + 1)
        for i, level in enumerate(levels)
        for part in parts
        for word, first, last in level.spans(levels[:i], part)
    ]
    return max(widths)


def _labels(levels: list[Level]) -> list[str]:
    """Return one label per column: what varies, without the names of axes."""
    return [SEPARATOR.join(words) for words in zip(*(level.words for level in levels), strict=True)]


def _draw_panel(ax: Axes, matrix: Regrets, columns: range, norm: LogNorm, paper: Paper, width: float) -> None:
    """Draw the cells of some columns, `width` inches each."""
    situations = [matrix.situations[i] for i in columns]
    ax.set(xlim=(-0.5, len(situations) - 0.5))
    ax.set_xticks([])
    ax.grid(False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    for row in cast(list[Row], matrix.rows[matrix.rows.situation.isin(situations)].to_dict("records")):
        x, y = situations.index(row["situation"]), matrix.observers.index(row["observer"])
        colour = DIVERGING if row["more"] else to_hex(COLOURS(norm(row["ratio"]) if isfinite(row["ratio"]) else 1.0))
        ties = not (row["best"] or row["worse"])
        patch = Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=colour, edgecolor=GRID, linewidth=0.6)
        text, share = format_ratio(row["ratio"]), format_share(row["diverged"]) if isfinite(row["ratio"]) else ""
        tip = ", ".join(filter(None, [text, share, matrix.tie if ties else ""]))
        patch.set_gid(f"tip:{row['observer']}, {row['situation']}: {tip}")
        ax.add_patch(patch)
        if ties:
            ax.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, edgecolor=HATCH, hatch="/////", linewidth=0.0))
        ax.text(x, y - 0.18 * bool(share), text, ha="center", va="center", fontsize=paper.size - 2, color=ink_on(colour),
                in_layout=False, fontweight="bold" if row["best"] else "normal")  # fmt: skip
        if share and paper.width_of(share, 3) > width:
            share = share.removesuffix(DIVERGED)
        if share:
            ax.text(x, y + 0.24, share, ha="center", va="center", fontsize=paper.size - 3, color=ink_on(colour),
                    in_layout=False)  # fmt: skip


def _draw_levels(ax: Axes, levels: list[Level], columns: range, paper: Paper) -> None:
    """Write the labels below the columns: the innermost level first, equal neighbours once."""
    for line, i in enumerate(reversed(range(len(levels)))):
        down = -(line * LINE + 0.4) * paper.size
        below, rule = (
            offset_copy(ax.get_xaxis_transform(), ax.get_figure(root=True), 0, y, units="points")
            for y in (down, down + 0.2 * paper.size)
        )
        beside = offset_copy(ax.transAxes, ax.get_figure(root=True), -3, down, units="points")
        ax.text(0, 0, levels[i].name, transform=beside, ha="right", va="top", fontsize=paper.size - 1, color=SOFT)
        for word, first, last in levels[i].spans(levels[:i], columns):
            ax.text((first + last) / 2, 0, word, transform=below, ha="center", va="top", fontsize=paper.size - 1)
            if line:
                ends = [first - 0.4, last + 0.4]
                ax.plot(ends, [0.0, 0.0], color=SOFT, linewidth=0.6, clip_on=False, transform=rule, label="_")


def _scale_errors(least: list[float]) -> tuple[int, list[str]]:
    """Return a power of ten, a multiple of 3, and errors divided by it with two digits, so that most are short."""
    power = 3 * floor(log10(float(np.median([v for v in least if isfinite(v)] or 1.0))) / 3 + 1e-12)
    power = 0 if -3 <= power < 3 and min(least) >= SMALL else power
    return power, [layout.number(float(f"{v / 10.0**power:.2g}")) if isfinite(v) else "∞" for v in least]


def format_ratio(ratio: float) -> str:
    """Return a ratio in at most five letters, its power of ten if it is large."""
    if not isfinite(ratio):
        return "∞"
    if ratio >= HUGE:
        return layout.number(10.0 ** round(log10(ratio)))
    if ratio < 1.095:
        return f"{ratio:.2f}" if ratio >= 1.005 else "1" if ratio > 0.995 else layout.number(float(f"{ratio:.2g}"))
    return f"{ratio:.2g}" if ratio < 99.5 else layout.number(float(f"{ratio:.2g}"))


def format_share(share: float) -> str:
    """Return a share of diverged runs in words; empty if there are none."""
    return f"{100 * share:.2g} %{DIVERGED}" if share else ""
