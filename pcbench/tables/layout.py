"""What stands where in a table of a result, before it is written in any form.

Of a scenario without axes that vary: a row an observer, a column a signal. Along one axis of few values: a table a signal, a
row an observer, a column a value. Else: a row a cell, a column an observer. Among the observers of one cell the best is marked,
with those that are as good.
"""

from typing import NamedTuple

import pandas as pd

from pcbench.dataset.columns import AXIS_UNITS
from pcbench.dataset.result import Result
from pcbench.plots import frames
from pcbench.statistics.aggregate import Row
from pcbench.statistics.number_format import estimate
from pcbench.statistics.ranking import standing

WIDE = 4  # values of an axis that stand beside one another


class Head(NamedTuple):
    """The head of a column: what, in which unit; empty: none."""

    text: str
    unit: str = ""


class Entry(NamedTuple):
    """An estimate in its place."""

    row: Row  # of stats
    best: bool  # no other observer is significantly better

    @property
    def text(self) -> str:
        """Return it with its interval, to the same digit."""
        return estimate(self.row["mean"], self.row["ci_low"], self.row["ci_high"])

    @property
    def lost(self) -> bool:
        """Whether runs diverged, which the mean leaves out."""
        return bool(self.row["diverged"])


class Table(NamedTuple):
    """One table; every row begins with as many words as `stub` has heads."""

    scenario: str
    signal: str  # empty: all that are shown
    about: str  # what the numbers are
    stub: list[Head]
    heads: list[Head]
    rows: list[tuple[list[str], list[Entry | None]]]
    over: Head | None = None  # the axis whose values the heads are

    @property
    def entries(self) -> list[Entry]:
        """Return all entries, those that are empty left out."""
        return [e for _, each in self.rows for e in each if e]

    @property
    def notes(self) -> list[str]:
        """Return what a reader has to know of it, a sentence each."""
        runs = {e.row["n"] + e.row["diverged"] for e in self.entries}
        each = f"{min(runs):,}" if len(runs) == 1 else f"{min(runs):,} to {max(runs):,}"
        leans = "; skewed intervals by their ends" if any(" .. " in e.text for e in self.entries) else ""
        notes = [f"Means over {each} runs, ± half a 95 % interval{leans}."]
        if any(e.best for e in self.entries):
            notes += ["Bold: the best, and each that is not significantly worse (paired t-test, Holm, 5 %)."]
        if any(e.lost for e in self.entries):
            notes += ["Dagger: some runs diverged; the mean is over the others."]
        return notes


def tables(result: Result, metric: str, signals: list[str] | None = None) -> list[Table]:
    """Return the tables of every scenario; of None signals those it is known by, of an empty list all.

    Raises UserError for a metric or a signal that the study does not have.
    """
    out: list[Table] = []
    for scenario in dict.fromkeys(result.stats.scenario):
        parts = {
            signal: part
            for signal in frames.chosen(result, scenario, signals)
            if len(part := frames.rows(result, scenario, signal, metric))
        }
        if not parts:
            continue
        if not frames.varying(next(iter(parts.values()))):
            out.append(_by_signal(result, scenario, metric, parts))
        else:
            out += [_by_axis(result, scenario, metric, signal, part) for signal, part in parts.items()]
    return out


def _by_signal(result: Result, scenario: str, metric: str, parts: dict[str, pd.DataFrame]) -> Table:
    heads = [Head(_words(signal), part.unit.iloc[0]) for signal, part in parts.items()]
    columns = [{str(e.row["observer"]): e for e in _entries(result, part, metric)} for part in parts.values()]
    observers = list(dict.fromkeys(o for column in columns for o in column))
    rows = [([o], [column.get(o) for column in columns]) for o in observers]
    return Table(scenario, "", f"{scenario}: {metric} of the error", [Head("observer")], heads, rows)


def _by_axis(result: Result, scenario: str, metric: str, signal: str, part: pd.DataFrame) -> Table:
    axes = frames.varying(part)
    entries = [e for _, cell in part.groupby("cell", sort=False) for e in _entries(result, cell, metric)]
    observers = list(dict.fromkeys(str(e.row["observer"]) for e in entries))
    by = {(str(e.row["observer"]), tuple(_value(e.row[a]) for a in axes)): e for e in entries}
    points = list(dict.fromkeys(point for _, point in by))
    unit = part.unit.iloc[0]
    about = f"{scenario}: {metric} of the error of {_words(signal)}" + (f" [{unit}]" if unit not in ("", "1") else "")
    if len(axes) == 1 and len(points) <= WIDE:
        rows = [([o], [by.get((o, point)) for point in points]) for o in observers]
        heads = [Head(p) for (p,) in points]
        return Table(scenario, signal, about, [Head("observer")], heads, rows, over=_axis(axes[0]))
    rows = [(list(point), [by.get((o, point)) for o in observers]) for point in points]
    return Table(scenario, signal, about, [_axis(a) for a in axes], [Head(o) for o in observers], rows)


def _axis(name: str) -> Head:
    """The head of an axis; a unit in words is left out."""
    unit = AXIS_UNITS.get(name, "")
    return Head(_words(name.removeprefix("plant.")), "" if " " in unit or unit == "1" else unit)


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _entries(result: Result, cell: pd.DataFrame, metric: str) -> list[Entry]:
    """The entries of one cell and signal, in the study's order."""
    first, pairs = cell.iloc[0], result.pairs
    met = pairs[
        (pairs.scenario == first.scenario)
        & (pairs.signal == first.signal)
        & (pairs.metric == metric)
        & (pairs.cell == first.cell)
    ]
    leaders = standing(cell, met).leaders if len(cell) > 1 else ()
    rows: list[Row] = cell.to_dict("records")  # type: ignore[assignment]
    return [Entry(row, row["observer"] in leaders) for row in rows]


def _words(name: str) -> str:
    return name.replace("_", " ")
