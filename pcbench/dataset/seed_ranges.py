"""Ranges of seeds. No jax."""

from collections.abc import Iterable
from typing import NamedTuple


class Seeds(NamedTuple):
    """The seeds first .. stop - 1."""

    first: int
    stop: int

    @property
    def many(self) -> int:
        """Return the number of seeds."""
        return max(self.stop - self.first, 0)

    def __str__(self) -> str:
        return f"{self.first}:{self.stop}"


def seed_range(first: int, count: int) -> Seeds:
    """Return the range of a number of seeds from the first one on."""
    return Seeds(first, first + count)


def common(a: Seeds, b: Seeds) -> Seeds:
    """Return the common seeds of two ranges, possibly none."""
    return Seeds(max(a.first, b.first), min(a.stop, b.stop))


def merge_ranges(ranges: Iterable[Seeds]) -> list[Seeds]:
    """Return ranges in order, with adjacent ones merged."""
    out: list[Seeds] = []
    for seeds in ranges:
        if out and out[-1].stop == seeds.first:
            out[-1] = Seeds(out[-1].first, seeds.stop)
        else:
            out.append(seeds)
    return out


def gaps(ranges: Iterable[Seeds], span: Seeds, size: int) -> list[Seeds]:
    """Return the ranges of `span` that none of `ranges` contains, cut at multiples of `size`."""
    out, at = [], span.first
    for seeds in [*sorted(ranges), Seeds(span.stop, span.stop)]:
        while at < min(seeds.first, span.stop):
            out.append(Seeds(at, min(seeds.first, span.stop, (at // size + 1) * size)))
            at = out[-1].stop
        at = max(at, seeds.stop)
    return out
