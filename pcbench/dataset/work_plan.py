"""What of a study is to be done, cell by cell: designed and checked before anything is written, and cut into tasks."""

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from itertools import chain
from typing import NamedTuple

from pcbench import planning
from pcbench.dataset import task
from pcbench.dataset.manifest import Owned
from pcbench.dataset.seed_ranges import Seeds
from pcbench.planning import memo, padding, plan_cache
from pcbench.planning.padding import Plan
from pcbench.study.grid import Cell

DRAFTS = 2**27  # bytes of drafts that are kept between planning and computing, those of 10,000 cells of few schedules
AHEAD = 16  # tasks that wait for the program after theirs
SeedsOf = Callable[[Cell], Seeds]
Gaps = dict[tuple[str, int], dict[str, list[Seeds]]]  # by cell and observer


class Planned(NamedTuple):
    """What is to be done: designed and checked. Of many cells those that are not kept are laid out again as tasks are drawn."""

    owned: Owned
    todo: Gaps
    room: padding.Capacity
    ask: memo.Once  # has the designs
    kept: tuple[Plan, ...] = ()  # drafts of the first cells
    cells: int = 0  # how many cells those are

    def drafts(self, wanted: SeedsOf) -> Iterator[Plan]:
        """Yield the cells' drafts; of those that are kept the ones of a program together, which is made once then."""
        programs: dict[Hashable, list[Plan]] = {}
        for p in self.kept:
            programs.setdefault(padding.key_of(padding.fitted(p, self.room, self.ask)), []).append(p)
        yield from chain.from_iterable(programs.values())
        if self.cells < len(self.owned.cells):
            many = lambda cell: wanted(cell).many  # noqa: E731
            yield from planning.drafts(self.owned.cells, self.todo, self.ask, many, self.cells, apart=True)

    def tasks(self, wanted: SeedsOf) -> Iterator[task.Task]:
        """Yield the tasks, cell by cell; those of expensive observers last, so that nothing waits for them.

        The first task of a program comes after one that makes it and estimates how long a call takes (see `interleaved`).
        """
        cells = {cell.key: cell for cell in self.owned.cells}
        begun: set[Hashable] = set()
        for expensive in sorted(
            {cells[key].entry(label).expensive for key, mine in self.todo.items() for label in mine}
        ):
            yield from interleaved(self._tasks(wanted, expensive, begun))

    def _tasks(self, wanted: SeedsOf, expensive: bool, begun: set[Hashable]) -> Iterator[task.Task]:
        """Yield the tasks of observers that are expensive, or are not; of a program that is not `begun`, one that times it."""
        for p in self.drafts(wanted):
            ranges = {
                label: each
                for label, each in self.todo.get(p.cell.key, {}).items()
                if label in p.labels and p.cell.entry(label).expensive == expensive
            }
            if not ranges:
                continue
            fitted = padding.fitted(p, self.room, self.ask)
            program = padding.key_of(fitted)
            for each in task.tasks(fitted, p.layout.width, ranges):
                if program not in begun:
                    begun.add(program)
                    yield each._replace(timed=True)
                yield each


def interleaved(tasks: Iterable[task.Task], ahead: int = AHEAD) -> Iterator[task.Task]:
    """Yield tasks with the one that makes a program before the others of the program before it; these wait, at most `ahead`.

    So two programs are compiled side by side, although all tasks of one wait for it.
    """
    waiting: deque[task.Task] = deque()
    for each in tasks:
        if each.timed:
            yield each
            yield from waiting
            waiting.clear()
        else:
            waiting.append(each)
            if len(waiting) > ahead:
                yield waiting.popleft()
    yield from waiting


def planned(owned: Owned, todo: Gaps, wanted: SeedsOf) -> Planned:
    """Design what is to be done, and find the room that it takes; raise UserError where that cannot be."""
    first, keep = Planned(owned, todo, padding.Capacity(), memo.once()), plan_cache.Drafts(DRAFTS)
    room = padding.needed(keep.passing(padding.checked(first.drafts(wanted))))
    return first._replace(room=room, kept=keep.whole(), cells=keep.cells)
