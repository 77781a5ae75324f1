"""Limits of an axis: the largest value at which an error is significantly below a threshold, from rows of `stats`. No jax.

- A value suffices if no run diverged and the whole 95 % interval is below the threshold.
- It fails if the whole interval is above, or if runs diverged (no mean counts these).
- Otherwise it is undecided.

Each verdict alone is wrong in about 1 of 40 cases. There is no joint statement about many values.
"""

from collections.abc import Hashable, Iterable, Mapping
from math import isfinite, isnan, nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.statistics.aggregate import Row
from pcbench.statistics.number_format import estimate

SUFFICES, EXCEEDS, DIVERGES, UNDECIDED = "suffices", "exceeds", "diverges", "undecided"
REFUSED = "refused"  # an observer does not support this value, or has no gains there
NULL = "null"  # the metric has no value, although no run diverged
FAILS = (EXCEEDS, DIVERGES)
COUNTS = ("divergence_rate",)  # metrics that count diverged runs themselves


class Point(NamedTuple):
    """The result of one observer at one value of the axis."""

    value: float
    verdict: str
    mean: float = nan
    low: float = nan
    high: float = nan
    runs: int = 0
    why: str = ""  # reason of a refusal


class Answer(NamedTuple):
    """The limit of one observer."""

    kind: str  # up to, every value, no value, undecided, refused, no number
    largest: Point | None  # the largest value that suffices
    exceeds: Point | None  # the smallest value above it that significantly exceeds the threshold
    fails_below: Point | None  # the smallest value below a sufficient one that significantly exceeds the threshold
    points: tuple[Point, ...]  # all, by value


def point(row: Mapping[Hashable, Any], value: float, limit: float) -> Point:
    """Return the result of a row of stats at a value of the axis."""
    mean, low, high, n, diverged = (float(row[k]) for k in ("mean", "ci_low", "ci_high", "n", "diverged"))
    result = Point(value, UNDECIDED, mean, low, high, int(n + diverged))
    if diverged and row["metric"] not in COUNTS:
        return result._replace(verdict=DIVERGES)
    if isnan(mean):
        return result._replace(verdict=NULL)
    if high < limit:
        return result._replace(verdict=SUFFICES)
    return result._replace(verdict=EXCEEDS) if low > limit else result  # with one run the ends are null: undecided


def points(
    rows: pd.DataFrame, axis: str, limit: float, refusals: Iterable[tuple[str, Point]] = ()
) -> dict[str, list[Point]]:
    """Return the results at every value of an axis by observer, in order.

    `rows` are those of stats for one metric, signal and scenario, with the axis' column as numbers. No other axis varies.
    """
    out: dict[str, list[Point]] = {}
    for row in rows.to_dict("records"):
        out.setdefault(str(row["observer"]), []).append(point(row, float(row[axis]), limit))
    for observer, result in refusals:
        out.setdefault(observer, []).append(result)
    return {observer: sorted(results, key=lambda p: p.value) for observer, results in out.items()}


def answer(results: list[Point]) -> Answer:
    """Return the limit of an observer from its results in order, at least one."""
    sufficient = [p for p in results if p.verdict == SUFFICES]
    largest = sufficient[-1] if sufficient else None
    failures = [p for p in results if p.verdict in FAILS]
    exceeds = next((p for p in failures if largest is None or p.value > largest.value), None)
    below = failures[0] if largest and failures and failures[0].value < largest.value else None
    return Answer(_kind(results, largest, exceeds), largest, exceeds, below, tuple(results))


def _kind(results: list[Point], largest: Point | None, exceeds: Point | None) -> str:
    verdicts = {p.verdict for p in results}
    if largest is not None:
        return "every value" if verdicts == {SUFFICES} else "up to"
    if verdicts == {REFUSED}:
        return "refused"
    if verdicts <= {NULL, REFUSED}:
        return "no number"
    return "no value" if exceeds is not None and verdicts <= {*FAILS, REFUSED} else "undecided"


def table(answers: dict[str, Answer], axis: str) -> pd.DataFrame:
    """Return limits as a frame with one row per observer. Missing values are NaN.

    - `answer`: see `Answer.kind`
    - `largest`, `mean`, `ci_low`, `ci_high`: the largest value that suffices, and the metric there
    - `exceeds`, `exceeds_*`: the smallest value above it that significantly exceeds the threshold, and the metric there
    - `fails_below`: a smaller value that significantly exceeds the threshold, so that the error is not monotone
    - `values`, `runs`: number of values, and maximum runs per value
    - `sentence`: the answer as a sentence
    """
    return pd.DataFrame([_row(observer, a, axis) for observer, a in answers.items()])


def _row(observer: str, a: Answer, axis: str) -> Row:
    def ends(p: Point | None, name: str, prefix: str) -> dict[str, float]:
        value, mean, low, high = (p.value, p.mean, p.low, p.high) if p else (nan,) * 4
        return {name: value, f"{prefix}mean": mean, f"{prefix}ci_low": low, f"{prefix}ci_high": high}

    return {
        "observer": observer,
        "answer": a.kind,
        **ends(a.largest, "largest", ""),
        **ends(a.exceeds, "exceeds", "exceeds_"),
        "fails_below": a.fails_below.value if a.fails_below else np.nan,
        "values": len(a.points),
        "runs": max(p.runs for p in a.points),
        "sentence": sentence(a, axis),
    }


def sentence(a: Answer, axis: str) -> str:
    """Return an answer as a sentence."""
    first, last = a.points[0], a.points[-1]
    runs = max(p.runs for p in a.points)
    text = {
        "every value": f"every tested value of {axis} suffices, {first.value:g} to {last.value:g}",
        "no value": f"no value of {axis} suffices: at {first.value:g} it {_is(first)} already",
        "undecided": f"no value of {axis} significantly suffices, with {runs:,} runs each",
        "refused": f"no value of {axis} can be run: {last.why}",
        "no number": "the metric has no number here, so there is no answer",
    }.get(a.kind, "")
    parts = [text] if text else [f"{axis} up to {a.largest.value:g} suffices"] if a.largest else []
    if a.kind == "up to" and a.exceeds:
        parts.append(f"at {a.exceeds.value:g} it {_is(a.exceeds)}")
    elif a.kind == "up to":
        parts.append("beyond, no value is significantly above the limit")
    if undecided := [p for p in a.points if p.verdict == UNDECIDED and a.largest and p.value > a.largest.value]:
        parts.append(f"undecided at {', '.join(f'{p.value:g}' for p in undecided)} with {runs:,} runs")
    if a.fails_below and a.largest:
        parts.append(
            f"it is not monotone: at {a.fails_below.value:g} it {_is(a.fails_below)}, at {a.largest.value:g} it suffices"
        )
    refusals = [p for p in a.points if p.verdict == REFUSED and a.kind != "refused"]
    if refusals:
        parts.append(f"not run at {', '.join(f'{p.value:g}' for p in refusals)}: {refusals[0].why.rstrip('.')}")
    if a.kind != "no number" and any(p.verdict == NULL for p in a.points):
        missing = ", ".join(f"{p.value:g}" for p in a.points if p.verdict == NULL)
        parts.append(f"at {missing} the metric has no number")
    return "; ".join(parts) + "."


def _is(p: Point) -> str:
    if p.verdict == DIVERGES:
        return "diverges in some runs" if isfinite(p.mean) else "diverges"
    return f"is {estimate(p.mean, p.low, p.high)}"
