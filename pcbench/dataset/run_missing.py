"""Start or resume a study: only the missing runs are planned, divided into tasks and computed.

Gains are designed and checked before anything is written. Cells are laid out when their tasks are generated, while
others compute, so the memory hardly grows with a study's axes.
"""

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import jax

from pcbench import planning
from pcbench.dataset import block_files, manifest, moments_tables, storage, task
from pcbench.dataset.block_files import Block
from pcbench.dataset.columns import SCHEMA
from pcbench.dataset.executors import Executor
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.seed_ranges import Seeds, gaps, seed_range
from pcbench.dataset.timing import Cost, add_costs
from pcbench.errors import UserError
from pcbench.planning import memo, padding
from pcbench.planning.padding import Plan
from pcbench.runtime import provenance
from pcbench.runtime.progress import COMPILING, SILENT, Progress, Stopwatch
from pcbench.study.grid import Cell

CALLS = 4  # per block: a file costs milliseconds, a call of the cheapest plant a tenth of a second
TASKS = 64  # at least, for all cores and workers
LONG_CALL = 60.0  # [s] a longer call is announced
HOUR = 3600.0  # [s]
MANY_FILES = 10_000  # blocks of a study; with more, each block has more seeds
DRAFTS = 2**27  # bytes of drafts that are kept between planning and computing, those of 10,000 cells of few schedules
ARRAY_BYTES = 200  # of an array without its numbers
DELAYED = 16  # tasks that wait until the next program compiles
SeedsOf = Callable[[Cell], Seeds]
Gaps = dict[tuple[str, int], dict[str, list[Seeds]]]  # by cell and observer


class Sizes(NamedTuple):
    """Settings of a run that do not change any number."""

    block_size: int | None = None  # seeds a block
    memory: float = float("inf")  # bytes that results may take at a time


def required_seeds(
    claim: StudyClaim, blocks: list[Block], min_seeds: Mapping[str, int] = MappingProxyType({})
) -> SeedsOf:
    """Return the required seeds of a cell: those of the study, and any further ones that one of its observers has.

    `min_seeds` gives a minimum number of seeds for some cells, by their digest.
    """
    base = seed_range(claim.study.first_seed, claim.study.seeds)
    stops = {c.key: base.first + max(min_seeds[c.digest], base.many) for c in claim.cells if c.digest in min_seeds}
    for b in blocks:
        stops[b.scenario, b.cell] = max(stops.get((b.scenario, b.cell), base.stop), b.seeds.stop)
    return lambda cell: Seeds(base.first, stops.get(cell.key, base.stop))


def valid_blocks(target: storage.Target, claim: StudyClaim, on_warning: Callable[[str], None]) -> list[Block]:
    """Return the valid blocks; report and remove damaged and duplicate ones."""
    observers = {(cell.scenario.name, observer) for cell in claim.cells for observer in cell.options}
    digests, blocks = manifest.digests(claim), block_files.present(target)
    for b in blocks:
        if (b.scenario, b.cell) not in digests or (b.scenario, b.observer) not in observers:
            raise UserError(
                f"{target.name}/{b.name}: is of no cell of this study, expected its blocks only; move it away."
            )
    with ThreadPoolExecutor() as pool:
        reasons = pool.map(lambda b: block_files.damage(target, b, digests[b.scenario, b.cell]), blocks)
        damages = dict(zip(blocks, reasons, strict=True))
    for b, damage in damages.items():
        if damage == block_files.OTHER_SCHEMA:
            raise UserError(
                f"{target.name}/{b.name}: {damage}, expected version {SCHEMA}; give a new folder with --out, or start over "
                "with --overwrite."
            )
    valid = block_files.drop_overlaps(b for b, damage in damages.items() if not damage)
    valid_set = set(valid)
    for b, damage in damages.items():
        if damage:
            on_warning(f"{target.name}/{b.name}: is damaged ({damage}); it is computed again.")
        elif b not in valid_set:
            on_warning(f"{target.name}/{b.name}: contains seeds that another block contains; it is removed.")
        if b not in valid_set:
            storage.remove(target, b.name)
    old = block_files.about_block(target, valid[0]).get("versions", {}) if valid else {}
    if valid and old != (new := provenance.versions()):
        changes = ", ".join(f"{k} {old.get(k)}, now {v}" for k, v in new.items() if old.get(k) != v)
        on_warning(f"{target.name}: was begun with {changes}; the last bits of new runs may differ.")
    return valid


def missing_seeds(claim: StudyClaim, blocks: list[Block], seeds_of: SeedsOf, size: Callable[[Cell], int]) -> Gaps:
    """Return the ranges of seeds that no block contains."""
    by_cell = block_files.series(blocks)
    out: Gaps = {}
    for cell in claim.cells:
        for o in cell.options:
            if ranges := gaps((b.seeds for b in by_cell.get((*cell.key, o), ())), seeds_of(cell), size(cell)):
                out.setdefault(cell.key, {})[o] = ranges
    return out


def count_missing(target: storage.Target, claim: StudyClaim) -> int:
    """Return the number of runs of a study without a block."""
    blocks = block_files.present(target)
    simulations = moments_tables.select_simulations(target, claim)
    return runs_in(missing_seeds(simulations, blocks, required_seeds(claim, blocks), lambda cell: 2**40))


def runs_in(todo: Gaps) -> int:
    """Return the number of missing runs."""
    return sum(seeds.many for labels in todo.values() for ranges in labels.values() for seeds in ranges)


class RunPlan(NamedTuple):
    """The missing runs, with designed and checked gains. Drafts that are not kept are laid out again for their tasks."""

    claim: StudyClaim
    todo: Gaps
    seeds_of: SeedsOf
    cache: memo.Cache  # has the designs
    room: padding.Capacity = padding.Capacity()
    first_drafts: tuple[Plan, ...] = ()  # drafts of the first cells
    n_cells: int = 0  # number of these cells

    def drafts(self, skip: int = 0) -> Iterator[Plan]:
        """Lay out all cells except the first `skip`."""
        count = lambda cell: self.seeds_of(cell).many  # noqa: E731
        return planning.drafts(self.claim.cells, self.todo, self.cache, count, skip, split_expensive=True)

    def programs(self) -> dict[Hashable, list[Plan]]:
        """Return the drafts that are kept, by the key of their compiled program."""
        out: dict[Hashable, list[Plan]] = {}
        for p in self.first_drafts:
            out.setdefault(padding.key_of(padding.fit_to_capacity(p, self.room, self.cache)), []).append(p)
        return out

    def tasks(self, programs: dict[Hashable, list[Plan]]) -> Iterator[task.Task]:
        """Yield the tasks, cell by cell; those of expensive observers last, so that no others wait for them.

        Of the drafts that are kept, those of one program are consecutive, so it is compiled once. The first task of a
        program comes after one that compiles it and estimates the time of a call (see `interleave`).
        """
        cells = {cell.key: cell for cell in self.claim.cells}
        timed_programs: set[Hashable] = set()
        for expensive in sorted(
            {cells[key].entry(label).expensive for key, labels in self.todo.items() for label in labels}
        ):
            rest = self.drafts(self.n_cells) if self.n_cells < len(cells) else ()
            yield from interleave(self._tasks(chain(*programs.values(), rest), expensive, timed_programs))

    def _tasks(self, drafts: Iterable[Plan], expensive: bool, timed_programs: set[Hashable]) -> Iterator[task.Task]:
        """Yield the tasks of expensive observers, or of the others; the first task of a program estimates its time."""
        for p in drafts:
            ranges = {
                label: seeds
                for label, seeds in self.todo.get(p.cell.key, {}).items()
                if label in p.labels and p.cell.entry(label).expensive == expensive
            }
            if not ranges:
                continue
            plan = padding.fit_to_capacity(p, self.room, self.cache)
            program = padding.key_of(plan)
            for t in task.tasks(plan, p.layout.width, ranges):
                if program not in timed_programs:
                    timed_programs.add(program)
                    yield t._replace(timed=True)
                yield t


def interleave(tasks: Iterable[task.Task], limit: int = DELAYED) -> Iterator[task.Task]:
    """Yield the task that compiles a program before the waiting tasks of the program before it, at most `limit`.

    So two programs are compiled at the same time, although all tasks of a program wait for its compilation.
    """
    queue: deque[task.Task] = deque()
    for t in tasks:
        if t.timed:
            yield t
            yield from queue
            queue.clear()
        else:
            queue.append(t)
            if len(queue) > limit:
                yield queue.popleft()
    yield from queue


def plan_runs(claim: StudyClaim, todo: Gaps, seeds_of: SeedsOf) -> RunPlan:
    """Design the missing runs, and determine the buffer sizes; raise UserError if a design fails.

    Drafts are kept, in the order of their cells, up to DRAFTS bytes. What several share counts once.
    """
    plan, room, budget = RunPlan(claim, todo, seeds_of, memo.new_cache()), padding.Capacity(), DRAFTS
    drafts: list[Plan] = []
    ids: set[int] = set()  # arrays, all alive in drafts that are kept
    for p in padding.check_drafts(plan.drafts()):
        room = padding.larger(room, padding.capacity_of(p))
        if budget >= 0:
            new = {id(a): a for a in jax.tree.leaves(p.problem) if id(a) not in ids}
            budget -= sum(getattr(a, "nbytes", 0) + ARRAY_BYTES for a in new.values())
            drafts.append(p)
            ids.update(new)
    if budget < 0:  # the last cell may lack drafts: a closed loop has one for each observer
        drafts = [p for p in drafts if p.cell.key != drafts[-1].cell.key]
    return plan._replace(room=room, first_drafts=tuple(drafts), n_cells=len({p.cell.key for p in drafts}))


def run_blocks(
    target: storage.Target,
    claim: StudyClaim,
    blocks: list[Block],
    execute: Executor,
    seeds_of: SeedsOf,
    sizes: Sizes,
    progress: Progress = SILENT,
    on_warning: Callable[[str], None] = lambda sentence: None,
) -> Cost:
    """Compute what is missing; raise UserError if a gain is not certified or a file cannot be written.

    Gains are checked before anything is written. `on_warning` gets a sentence for each program with long calls.
    """
    todo = missing_seeds(claim, blocks, seeds_of, partial(_block_size, claim, seeds_of, sizes))
    if not todo:
        storage.remove_unfinished(target)  # also of a run that was killed while it wrote the closing tables
        manifest.renew(target, claim)
        return Cost()
    _require_simulated(claim, todo)
    cost, stopwatch = Cost(), Stopwatch()
    with stopwatch("planning"):
        plan = plan_runs(claim, todo, seeds_of)
        programs = plan.programs()
    manifest.begin(target, claim)
    progress.begin("runs", runs_in(todo))
    progress.note(_activity(0, len(programs)))
    work = partial(task.compute, task.Work(target.uri, claim.study.name, claim.study.root_seed, sizes.memory))
    new = [Block(s, o, n, seeds) for (s, n), labels in todo.items() for o, ranges in labels.items() for seeds in ranges]
    n_compiled = 0
    for report in execute(work, stopwatch.measure_each("planning", plan.tasks(programs))):
        _require_versions(report)
        cost = add_costs(cost, report.cost)
        n_compiled += report.call is not None
        progress.note(_activity(n_compiled, len(programs)))
        if report.call:
            if report.call.seconds > LONG_CALL:
                on_warning(_announcement(report.cell[0], report.call, todo))
            continue
        progress.step(report.cost.runs)
    storage.sync(target, {str(Path(b.name).parent) for b in new})
    return cost._replace(planning_seconds=stopwatch.seconds["planning"])


def _activity(n_compiled: int, programs: int) -> str:
    """Return a text of the current activity, with the number of finished programs and of all."""
    return f"{COMPILING} program {n_compiled + 1} of {programs}" if n_compiled < programs else "simulating"


def _require_simulated(claim: StudyClaim, todo: Gaps) -> None:
    """Raise UserError if missing runs need the estimates of an external program."""
    for cell in claim.cells:
        for label, ranges in todo.get(cell.key, {}).items():
            if cell.entry(label).elsewhere:
                n_runs = sum(seeds.many for seeds in ranges)
                raise UserError(
                    f"{cell.scenario.name}: got no estimates of {label} for {n_runs} runs, expected them scored, as it is an "
                    "external program; write their measurements with pcbench external prepare, estimate the states, and score "
                    "them with pcbench external score, or leave the observer out."
                )


def _require_versions(report: task.Report) -> None:
    """Raise UserError if a worker has other releases than this process, because the last bits may differ."""
    local, remote = provenance.versions(), report.versions
    if remote != local:
        remote_text = ", ".join(f"{k} {v}" for k, v in remote.items() if local.get(k) != v)
        local_text = ", ".join(f"{k} {v}" for k, v in local.items() if remote.get(k) != v)
        raise UserError(
            f"--dask: a worker has {remote_text}, expected {local_text} as here; install the same releases everywhere."
        )


def _announcement(scenario: str, call: task.Call, todo: Gaps) -> str:
    """Return a sentence on long calls: the time of one, and their number."""
    seconds, width, labels = call
    counts = [
        max((runs_in({key: {o: ranges[o]}}) for o in labels if o in ranges), default=0) for key, ranges in todo.items()
    ]
    time = f"{seconds / 60:.0f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"
    return (
        f"{scenario}: a call of {', '.join(labels)}, of up to {width} runs, takes about {time} or more; calls to do: "
        f"{sum(-(-n // width) for n in counts)}. Runs are written at the end of their call."
    )


def _block_size(claim: StudyClaim, seeds_of: SeedsOf, sizes: Sizes, cell: Cell) -> int:
    """Seeds per block: up to four calls, with enough tasks for all devices, and more if there would be too many files."""
    if sizes.block_size:
        return int(max(min(sizes.block_size, sizes.memory / task.bytes_of_a_block(cell, 1)), 1))
    n_seeds, pairs = seeds_of(cell).many, sum(len(c.options) for c in claim.cells)
    size = width = planning.width(cell)
    while task.bytes_of_a_block(cell, 2 * size) < sizes.memory:
        is_small = size < CALLS * width and len(claim.cells) * n_seeds / (2 * size) >= TASKS
        if not is_small and pairs * n_seeds / size <= MANY_FILES:
            break
        size *= 2
    return size
