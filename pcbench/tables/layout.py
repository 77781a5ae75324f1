"""The rows and columns of the tables of a result, before they are written in any form.

Every row is an observer. If no axis varies, each column is a signal. Otherwise each signal has a table whose columns are the
values of the longest axis, with rows grouped by the values of the other axes. Axes that vary one at a time have a table each.
The best observer of a grid point is marked, and those that are not significantly worse.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import pandas as pd

from pcbench.dataset.result import Result
from pcbench.observers import acronyms
from pcbench.plots import frames
from pcbench.statistics.aggregate import Row
from pcbench.statistics.limit_verdicts import COUNTS
from pcbench.statistics.metric_matrix import INTERVALS, OF_RUN
from pcbench.statistics.number_format import MARK, estimate, mark_uncertified
from pcbench.statistics.ranking import standing
from pcbench.study import title_of_scenario


class Head(NamedTuple):
    """The head of a column, with its unit; empty: none."""

    text: str
    unit: str = ""


class Entry(NamedTuple):
    """An estimate of a table."""

    row: Row  # of stats
    best: bool  # no other observer is significantly better

    @property
    def text(self) -> str:
        """Return it with its interval, to the same digit."""
        return estimate(self.row["mean"], self.row["ci_low"], self.row["ci_high"])

    @property
    def has_diverged(self) -> bool:
        """Whether runs diverged, which the mean leaves out."""
        return bool(self.row["diverged"]) and self.row["metric"] not in COUNTS

    @property
    def runs(self) -> int:
        """Return the number of its runs; 0: it is exact."""
        return int(self.row["n"] + self.row["diverged"] * self.has_diverged)


class Table(NamedTuple):
    """One table; every row begins with as many words as `stub` has heads: the values of axes, and an observer."""

    title: str  # of the scenario
    signal: str  # empty: each column is a signal
    about: str  # the caption: what the numbers are
    stub: list[Head]
    heads: list[Head]
    rows: list[tuple[list[str], list[Entry | None]]]
    over: Head | None = None  # the axis whose values the heads are

    @property
    def entries(self) -> list[Entry]:
        """Return all entries, those that are empty left out."""
        return [e for _, entries in self.rows for e in entries if e]

    @property
    def notes(self) -> list[str]:
        """Return the notes of the table, a sentence each."""
        runs = {e.runs for e in self.entries} or {0}
        count = f"{min(runs):,}" if len(runs) == 1 else f"{min(runs):,} to {max(runs):,}"
        leans = "; skewed intervals by their ends" if any(" .. " in e.text for e in self.entries) else ""
        half = ", ± half a 95 % interval" if any("±" in e.text for e in self.entries) else ""
        notes = [f"Means over {count} runs{half}{leans}." if max(runs) else "Exact expected values."]
        if any(e.best for e in self.entries):
            test = "not significantly worse (paired t-test, Holm, 5 %)" if max(runs) else "equal to it"
            notes += [f"Bold: the best, and each that is {test}."]
        if any(e.has_diverged for e in self.entries):
            notes += ["Dagger: some runs diverged; the mean is over the others."]
            if any(e.best for e in self.entries):
                notes += ["An observer that diverges significantly more often than the best is not bold."]
        if any(words[-1].endswith(MARK) for words, _ in self.rows):
            notes += ["Asterisk: no certificate for its gains."]
        names = acronyms(words[-1].removesuffix(MARK).strip() for words, _ in self.rows)
        notes += [f"{name}: {text}." for name, text in names.items()]
        return notes


def tables(result: Result, metric: str, signals: list[str] | None = None) -> list[Table]:
    """Return the tables of every scenario; `signals` None: its main signals, empty list: all.

    Raises UserError for a metric or a signal that the study does not have.
    """
    out: list[Table] = []
    for scenario in dict.fromkeys(result.stats.scenario):
        parts = {
            signal: part
            for signal in frames.select_signals(result, scenario, signals, metric)
            if len(part := frames.rows(result, scenario, signal, metric))
        }
        if not parts:
            continue
        if not frames.varying_axes(next(iter(parts.values()))):
            out.append(_by_signal(result, scenario, metric, parts))
        else:
            for signal, part in parts.items():
                out += _by_axis(result, scenario, metric, signal, part)
    return out


def _by_signal(result: Result, scenario: str, metric: str, parts: dict[str, pd.DataFrame]) -> Table:
    heads = [Head(_words(signal), part.unit.iloc[0]) for signal, part in parts.items()]
    columns = [{str(e.row["observer"]): e for e in _entries(result, part, metric)} for part in parts.values()]
    observers = list(dict.fromkeys(o for column in columns for o in column))
    rows = [_row([o], [column.get(o) for column in columns]) for o in observers]
    title = title_of_scenario(result.study, scenario)
    return Table(title, "", f"{title}: {_subject(metric)}", [Head("observer")], heads, rows)


def _subject(metric: str) -> str:
    """Return a metric with "of the error", unless it is one of the signal itself or of the run."""
    return metric if metric in (*INTERVALS, *OF_RUN) else f"{metric} of the error"


def _by_axis(result: Result, scenario: str, metric: str, signal: str, part: pd.DataFrame) -> Iterator[Table]:
    """Yield the tables of a signal: one, or one per axis if axes vary one at a time."""
    axes = frames.varying_axes(part)
    if result.study.vary == "one-at-a-time":
        for axis in axes:
            yield _over_axis(result, scenario, metric, signal, frames.fix_axes(part, [axis]), axis)
    else:
        longest = max(axes, key=lambda axis: part[axis].nunique(dropna=False))
        yield _over_axis(result, scenario, metric, signal, part, longest)


def _over_axis(result: Result, scenario: str, metric: str, signal: str, part: pd.DataFrame, axis: str) -> Table:
    """Return the table of a signal with the values of one axis as columns."""
    titles, row_axes = frames.axis_titles(result, part), [a for a in frames.varying_axes(part) if a != axis]
    entries = [e for _, cell in part.groupby("cell", sort=False) for e in _entries(result, cell, metric)]
    by_values = {tuple(_value(e.row[a]) for a in (*row_axes, "observer", axis)): e for e in entries}
    values = list(dict.fromkeys(at[-1] for at in by_values))
    groups = list(dict.fromkeys(at[:-2] for at in by_values))
    places = sorted(dict.fromkeys(at[:-1] for at in by_values), key=lambda place: groups.index(place[:-1]))
    unit = part.unit.iloc[0]
    title = title_of_scenario(result.study, scenario)
    about = f"{title}: {_subject(metric)} of {_words(signal)}" + (f" [{unit}]" if unit not in ("", "1") else "")
    return Table(
        title=title,
        signal=signal,
        about=about,
        stub=[*(_axis(a, titles[a]) for a in row_axes), Head("observer")],
        heads=[Head(value) for value in values],
        rows=[_row(place, [by_values.get((*place, value)) for value in values]) for place in places],
        over=_axis(axis, titles[axis]),
    )


def _row(words: Iterable[str], entries: list[Entry | None]) -> tuple[list[str], list[Entry | None]]:
    """Return a row with a mark behind the name of an observer whose gains have no certificate."""
    *values, observer = words
    return [*values, mark_uncertified(observer, [e.row.get("certified") for e in entries if e])], entries


def _axis(name: str, title: frames.AxisTitle) -> Head:
    """Return the head of an axis; a unit in words is left out."""
    return Head(frames.name_of(name, title), "" if " " in title.unit or title.unit == "1" else title.unit)


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _entries(result: Result, cell: pd.DataFrame, metric: str) -> list[Entry]:
    """Return the entries of one cell and signal, in the study's order."""
    first, pairs = cell.iloc[0], result.pairs
    comparisons = pairs[
        (pairs.scenario == first.scenario)
        & (pairs.signal == first.signal)
        & (pairs.metric == metric)
        & (pairs.cell == first.cell)
    ]
    leaders = standing(cell, comparisons).leaders if len(cell) > 1 else ()
    rows: list[Row] = cell.to_dict("records")  # type: ignore[assignment]
    return [Entry(row, row["observer"] in leaders) for row in rows]


def _words(name: str) -> str:
    return name.replace("_", " ")
