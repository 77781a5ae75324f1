"""What pictures show, in words: for those who do not see them, and as captions.

A sentence for each curve: up to which value of its axis each observer's error is significantly below a limit.

From the values that were run; `pcbench find-limit` finds values between them.
"""

from math import isfinite

import numpy as np
import pandas as pd

from pcbench.plots import frames, layout, one_run
from pcbench.plots.layout import number as exact
from pcbench.plots.time_series import BANDS, over
from pcbench.statistics import limit_verdicts
from pcbench.statistics.limit_verdicts import Answer
from pcbench.statistics.ranking import most_often

WINNERS = (
    "A cell is won where the best is significantly better than every other (5 %, Holm); the number says how many times "
    "larger the second's error is. Pale: the difference is not significant."
)
CONVERGENCE = "Half the 95 % interval, over the mean. Four times the seeds halve it."
COSTS = (
    "Left and low is better. Counted from the observers' own functions; an observer that takes no sample has no place."
)
BEARING = "Above 1 the model alone is better. One fault at a time, the others at their first value."
HONESTY = (
    f"The squared error over the observer's own covariance, a mean over runs ({one_run.RUNS} where they differ). Above "
    "the band it is optimistic, below it pessimistic."
)
WORDS = {"published": "as printed", "design": "by design", "tuned": "tuned"}


def number(value: float) -> str:
    """Return a number with three digits."""
    return exact(float(f"{value:.3g}")) if np.isfinite(value) else "-"


def medians(part: pd.DataFrame, unit: str) -> str:
    """Return the medians of a cell's rows."""
    said = [f"{row['observer']} {_format_value(row['p50'], unit)}" for row in part.to_dict("records")]
    return f"Medians: {', '.join(said)}."


def curve(part: pd.DataFrame, axis: str, unit: str) -> str:
    """Return where each observer's curve begins and ends."""
    words = any(isinstance(v, str) or v is None or v != v for v in part[axis])
    first = part if words else part.sort_values(axis, kind="stable")
    said = []
    for observer, mine in first.groupby("observer", sort=False):
        a, b = mine.iloc[0], mine.iloc[-1]
        ends = [f"{_format_value(row['mean'], unit)} at {layout.word(row[axis])}" for row in (a, b)]
        said.append(f"{observer}: {' to '.join(ends)}")
    return "; ".join(said) + "."


def ranges(part: pd.DataFrame, unit: str) -> str:
    """Return the least and the largest value of each observer's map."""
    said = []
    for observer, means in part.groupby("observer", sort=False)["mean"]:
        found = means[np.isfinite(means)]
        known = f"{number(found.min())} to {number(found.max())}" if len(found) else "diverged in every run"
        said.append(f"{observer} {known}")
    return f"Ranges [{unit}]: {', '.join(said)}."


def winners(found: pd.DataFrame) -> str:
    """Return how many cells each observer wins; if none wins any, which are as good as the best."""
    counted = found.text.value_counts()
    names, most = ([], 0) if (found.winner != "").any() else most_often(found.leaders)
    shared = f" None is better than {' and '.join(names)} in {most} of them." if most else ""
    return f"Of {len(found)} cells: {', '.join(f'{name} {n}' for name, n in counted.items())}.{shared}"


def convergence(part: pd.DataFrame) -> str:
    """Return how wide the interval of each observer is in the end."""
    last = part.groupby("observer", sort=False).last()
    said = [f"{o} ± {number(100 * row.half)} % after {int(row.seeds):,} runs" for o, row in last.iterrows()]
    return f"{', '.join(said)}." if said else "No mean has an interval."


def time(run: pd.DataFrame, unit: str, exact: frozenset[str] = frozenset()) -> tuple[str, str]:
    """Return where one run ends, and how to read its picture, where errors of some observers over time are `exact`."""
    kinds = (
        ["truth", "estimate", "target"] if (run.kind == "truth").any() else ["error"]
    )  # of a user's own there is no more
    ends = run[run.kind.isin(kinds)].groupby("series", sort=False).value.last()
    text = "At the end: " + ", ".join(f"{o} {_format_value(v, unit)}" for o, v in ends.items()) + "."
    of = frozenset(run.series[run.kind == "rms"])
    runs = "" if of <= exact else ", this one and the seeds after it"
    band = f" Bands: nine in ten errors over {over(of, exact)}{runs}." if 0 < len(of) <= BANDS else ""
    thin = " Thin lines: three standard deviations by the observer's own covariance; one if the axis is logarithmic."
    return text, f"What leaves the range is cut off.{band}{thin if (run.kind == 'sigma').any() else ''}"


def honesty(run: pd.DataFrame) -> str:
    """Return what each observer's squared error is of what it believes, over the second half of a run in time."""
    late = run[(run.kind == "nees") & (run.t >= run.t.max() / 2)]
    said = [f"{o} {number(mean)}" for o, mean in late.groupby("series", sort=False).value.mean().items()]
    return f"Mean over the second half: {', '.join(said)}."


def costs(found: pd.DataFrame) -> str:
    """Return what each observer costs."""
    text = "{observer} {sample:,} a sample, {tick:,} a tick, {memory:,} bytes"
    each = "; ".join(text.format_map(row) for row in found.to_dict("records"))
    return f"Multiplications of one run, and memory: {each}."


def borne(found: pd.DataFrame) -> str:
    """Return how much of each fault observers bear before the model alone is better."""

    def most(value: float) -> str:
        return "never" if np.isnan(value) else "everywhere" if np.isinf(value) else f"to {number(value)}"

    said = []
    for axis, mine in found.groupby("axis", sort=False):
        each = [f"{row['observer']} {most(row['most'])}" for row in mine.to_dict("records")]
        said.append(f"{frames.label(str(axis))}: {', '.join(each)}")
    return f"Better than the model alone: {'; '.join(said)}."


def fair(table: pd.DataFrame) -> str:
    """Return what each observer's gains are worth on held-out runs."""
    first = table[table.cell == table.cell.iloc[0]]
    unit = first.unit.iloc[0]
    said = [f"{r['observer']} {WORDS[r['tuning']]} {number(r['held_out'])} {unit}" for r in first.to_dict("records")]
    return ", ".join(said) + "."


def where(part: pd.DataFrame, cell: int) -> str:
    """Return at which values of the axes a cell stands; empty where none varies."""
    return ", ".join(frames.format_axis(axis, value) for axis, value in frames.values_at(part, cell).items())


def _format_value(value: float, unit: str) -> str:
    return f"{number(value)} {unit}" if np.isfinite(value) else "(diverged in every run)"


TIMES = 2.0  # the least error of the axis, that is the limit where none is given


def describe_limit(part: pd.DataFrame, axis: str, unit: str, threshold: float | None) -> str:
    """Return what suffices, from the rows of stats along an axis; empty where the axis is no numbers, or no error is finite.

    `below` is the limit, in the unit of the rows; None: TIMES their least mean.
    """
    if not all(isinstance(v, int | float) and isfinite(v) for v in part[axis]):
        return ""
    least = part["mean"].min()
    limit = TIMES * least if threshold is None else threshold
    if not limit > 0:
        return ""
    found = limit_verdicts.points(part, axis, limit)
    each = "; ".join(f"{observer} {_words(limit_verdicts.answer(points))}" for observer, points in found.items())
    which = f"{number(limit)} {unit}".strip() + (", twice the least" if threshold is None else "")
    return f"Significantly below {which}: {each}."


def _words(a: Answer) -> str:
    """An answer in a few words."""
    if a.largest is None or a.kind != "up to":
        words = {"every value": "everywhere", "no value": "nowhere", "undecided": "not decided anywhere"}
        return words.get(a.kind, "has no number")
    end = f"up to {layout.word(a.largest.value)}"
    beyond = f", not at {layout.word(a.exceeds.value)}" if a.exceeds else ", beyond not decided"
    odd = f", but not at {layout.word(a.fails_below.value)}" if a.fails_below else ""
    return end + beyond + odd
