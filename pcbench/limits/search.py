"""The search: which values of an axis, and how many seeds at which, decide what suffices. It knows runs only by their points.

For each observer the largest value that suffices and the smallest above it that surely does not close in on each other: seeds
are added next to the two where an interval holds the limit, up to a budget; then the gap is halved, until it is as small as
asked for. Below the largest only the values are looked at that the search began with, or that another observer needed: a
failure there is found by chance, and said.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from math import ceil, isfinite

from pcbench.dataset.adaptive_seeds import GROWTH, enough
from pcbench.limits.scale import Scale
from pcbench.statistics.limit_search import UNDECIDED, Point, answer

LEAST = 1.1  # times as many seeds a round at least
Look = Callable[
    [list[float], Mapping[float, int]], dict[str, list[Point]]
]  # values, seeds of some -> points by observer


def search(look: Look, scale: Scale, limit: float, most: int) -> dict[str, list[Point]]:
    """Return by observer all that was looked at, in order; a value gets `most` seeds at most."""
    values, seeds = scale.start(), dict[float, int]()
    while True:
        found = look(values, seeds)
        new, more = set(values), dict(seeds)
        for each in found.values():
            asked = doubts(each, scale, limit, most)
            for value, many in asked.items():
                more[value] = max(more.get(value, 0), many)
            new |= set() if asked else set(gaps(each, scale))
        if more == seeds and new == set(values):
            return found
        values, seeds = sorted(new), more


def brackets(found: list[Point], scale: Scale) -> list[tuple[Point, Point]]:
    """Return the neighbours between which an observer's answer lies; none where it is as sharp as was asked."""
    a = answer(found)
    if a.largest and a.exceeds and scale.near(a.largest.value, a.exceeds.value):
        return []
    return [(p, q) for p, q in pairwise(found) if p is a.largest or q is a.exceeds]


def gaps(found: list[Point], scale: Scale) -> list[float]:
    """Return the values that would sharpen an observer's answer."""
    wide = [(p.value, q.value) for p, q in brackets(found, scale) if not scale.near(p.value, q.value)]
    return [middle for p, q in wide if (middle := scale.between(p, q)) is not None]


def doubts(found: list[Point], scale: Scale, limit: float, most: int) -> dict[float, int]:
    """Return the seeds that values should have next, where more seeds would decide about an observer."""
    beside = [p for pair in brackets(found, scale) for p in pair]
    if answer(found).largest is None:
        beside.append(found[0])
    wanted = {p.value: min(_enough(p, limit), most) for p in beside if p.verdict == UNDECIDED}
    runs = {p.value: p.runs for p in beside}
    return {value: many for value, many in wanted.items() if many > runs[value]}


def _enough(p: Point, limit: float) -> int:
    """The seeds at which the end of a point's interval that lies beyond the limit should come to it."""
    side, gap = (p.high - p.mean, limit - p.mean) if p.mean < limit else (p.mean - p.low, p.mean - limit)
    if not isfinite(side):  # of one run
        return GROWTH * p.runs
    if side == 0:  # the runs do not vary, and are at the limit
        return p.runs
    return max(enough(p.runs, side, max(gap, side / GROWTH)), ceil(LEAST * p.runs))
