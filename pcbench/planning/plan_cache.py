"""Drafts that are made once though a study goes over its cells twice: those that fit in so much memory."""

from collections.abc import Iterable, Iterator

import jax

from pcbench.planning.padding import Plan

LEAF = 200  # bytes that an array takes besides its numbers


class Drafts:
    """The drafts of the first cells of a study. What several have in common counts once."""

    def __init__(self, room: int) -> None:
        """Begin with none; `room` [bytes]."""
        self.left, self.full = room, False
        self.kept: list[Plan] = []
        self.seen: set[int] = set()  # arrays, all alive in drafts that are kept

    def passing(self, drafts: Iterable[Plan]) -> Iterator[Plan]:
        """Yield drafts, in the order of their cells, and keep the first."""
        for p in drafts:
            if not self.full:
                new = {id(a): a for a in jax.tree.leaves(p.problem) if id(a) not in self.seen}
                self.left -= sum(getattr(a, "nbytes", 0) + LEAF for a in new.values())
                self.full = self.left < 0
                self.kept.append(p)
                self.seen.update(new)
            yield p

    def whole(self) -> tuple[Plan, ...]:
        """Return the drafts of the cells of which all are kept; a closed loop has one for each observer."""
        last = self.kept[-1].cell.key if self.full else None
        return tuple(p for p in self.kept if p.cell.key != last)

    @property
    def cells(self) -> int:
        """Return how many cells those are."""
        return len({p.cell.key for p in self.whole()})
