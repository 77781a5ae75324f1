"""Status and verification of a dataset: is it complete, is it undamaged, can it be reproduced? Nothing is written.

Recomputed blocks must have the same bits. The last bits of a cell's exact numbers may depend on the other cells of its
call, so these must be equal to rounding.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pcbench import planning
from pcbench.dataset import (
    block_files,
    close,
    columns,
    executors,
    manifest,
    moments_tables,
    parquet_io,
    run_missing,
    storage,
    task,
)
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.seed_ranges import Seeds
from pcbench.dataset.table_diff import ROUNDING, ZERO, agree, difference
from pcbench.planning import padding
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.grid import Cell, Grid, usable
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified

FAIR = "fair.parquet"  # of a study with several tunings
BESIDE = ("examples/", f"{moments_tables.FOLDER}/")
T = TypeVar("T")


class Share(NamedTuple):
    """The progress of one observer's runs in one scenario."""

    scenario: str
    observer: str
    cells: int
    blocks: int
    seeds: int  # that stand, over all cells
    wanted: int  # that the study names
    certified: bool | None  # whether something proves its gains, as its first block says; None: it has none


class Status(NamedTuple):
    """The content of a dataset."""

    study: str
    shares: list[Share]
    damaged: list[str]
    doubled: list[str]
    unfinished: list[str]  # of killed writers
    bytes: int
    closed: bool  # the closing tables stand, and are of these blocks


def status(out: str | Path) -> Status:
    """Return the content of a dataset, from the blocks' names and footers; raise UserError if there is no study."""
    target = storage.target(out)
    owned = manifest.load_manifest(target)
    there = block_files.present(target)
    kept = block_files.drop_overlaps(there)
    wanted = run_missing.everything(owned, there)
    left = moments_tables.select_simulations(target, owned)
    todo = run_missing.missing_seeds(left, kept, wanted, lambda cell: 2**40)
    shares = []
    for scenario in owned.study.scenarios:
        mine = [c for c in left.cells if c.scenario.name == scenario]
        for observer in dict.fromkeys(o for c in mine for o in c.options):
            cells = [c for c in mine if observer in c.options]
            asked = sum(wanted(cell).many for cell in cells)
            lacking = sum(seeds.many for c in cells for seeds in todo.get(c.key, {}).get(observer, []))
            blocks = [b for b in there if (b.scenario, b.observer) == (scenario, observer)]
            proof = block_files.about_block(target, blocks[0]).get("certificate") if blocks else None
            certified = is_certified(proof) if proof else None
            share = Share(
                scenario=scenario,
                observer=observer,
                cells=len(cells),
                blocks=len(blocks),
                seeds=asked - lacking,
                wanted=asked,
                certified=certified,
            )
            shares.append(share)
    return Status(
        study=owned.study.name,
        shares=shares,
        damaged=[b.name for b in there if storage.footer(target, b.name) is None] + close.damaged_files(target),
        doubled=[b.name for b in sorted(set(there) - set(kept))],
        unfinished=[p.name for p in storage.unfinished(target)],
        bytes=sum(storage.sizes(target).values()),
        closed=close.is_closed(target, there),
    )


class Verdict(NamedTuple):
    """The result of a verification."""

    files: int  # checked, every page
    wrong: list[str]  # a sentence each
    recomputed: list[str]  # blocks
    differing: list[str]  # a sentence each
    exact: list[str]  # cells whose exact numbers were computed again
    unlike: list[str]  # a sentence for each of them that has others now


def verify(out: str | Path, sample: int | None, seed: int, progress: Progress = SILENT) -> Verdict:
    """Check every file of a dataset, recompute `sample` blocks (None: all), and compare them bit for bit.

    The blocks are selected at random with `seed`. The closing tables are recomputed and compared too, and so are the
    exact numbers of as many cells.
    """
    target = storage.target(out)
    owned = manifest.load_manifest(target, run=sample != 0)
    digests = manifest.digests(owned)
    there, wrong, good = block_files.present(target), [], []
    progress.begin("checking", len(there))
    for b in there:
        if reason := block_files.damage(target, b, digests.get((b.scenario, b.cell), "")):
            wrong.append(f"{b.name}: {reason}.")
        else:
            good.append(b)
        progress.step(1)
    kept = block_files.drop_overlaps(good)
    wrong += [f"{b.name}: holds seeds that another block holds." for b in sorted(set(good) - set(kept))]
    wrong += _others(target, owned)
    wrong += [] if wrong else _closing_differs(target, owned, kept)
    elsewhere = {(*c.key, o) for c in owned.cells for o in c.options if c.entry(o).elsewhere}  # not to be computed here
    chosen = _draw_sample([b for b in kept if (b.scenario, b.cell, b.observer) not in elsewhere], sample, seed)
    progress.begin("computing again", len(chosen))
    differing = list(_again(target, owned, chosen, progress))
    cells = [] if moments_tables.load_exact_rows(target) is None else _draw_sample(owned.cells, sample, seed)
    unlike = list(_exact_again(target, owned, cells))
    return Verdict(len(there), wrong, [b.name for b in chosen], differing, list(map(_cell_title, cells)), unlike)


def _draw_sample(things: list[T], sample: int | None, seed: int) -> list[T]:
    """A random sample of some items, in their order."""
    if sample is None or sample >= len(things):
        return things
    return [things[i] for i in sorted(np.random.default_rng(seed).choice(len(things), sample, replace=False))]


def _others(target: storage.Target, owned: StudyClaim) -> Iterator[str]:
    """Yield a sentence for every file other than the blocks that has changed."""
    for name in close.damaged_files(target):
        yield f"{name}: has changed; run the study again to write it again."
    record = close.record(target)
    if record and record["study_sha256"] != digest(owned.study, owned.cells):
        yield f"{manifest.TEXT}: is not of the study that was run; run that study again to write it again."
    for name in [n for n in storage.names(target) if n.startswith(BESIDE) or n in (FAIR, moments_tables.NAME)]:
        if parquet_io.unseal_table(storage.get(target, name)) is None:
            yield f"{name}: has changed; remove it, and run the study again."


def _closing_differs(target: storage.Target, owned: StudyClaim, kept: list[Block]) -> Iterator[str]:
    """Yield a sentence for every closing table that does not follow from the blocks."""
    if not close.is_closed(target, kept):
        yield "stats.parquet and pairs.parquet do not belong to the blocks; run the study again to continue."
        return
    tables = close.closing_tables(target, owned, kept)
    for name, content in (("stats.parquet", tables.stats), ("pairs.parquet", tables.pairs)):
        there = close.table(target, name)
        if there is None or not there.equals(parquet_io.parse_table(content)):
            yield f"{name}: does not follow from the blocks; run the study again to write it again."


def _again(target: storage.Target, owned: StudyClaim, chosen: list[Block], progress: Progress) -> Iterator[str]:
    """Yield a sentence for every block that is not reproduced."""
    work = partial(_verify_task, target, task.Work("", owned.study.name, owned.study.root_seed))
    by: dict[str, list[Block]] = {}
    for b in chosen:
        by.setdefault(usable(block_files.about_block(target, b)["engine"]), []).append(b)
    with executors.local_executor() as execute:
        for engine, mine in by.items():
            cells = [cell._replace(engine=engine) for cell in owned.cells]
            for count, sentences in execute(work, _tasks(cells, mine)):
                progress.step(count)
                yield from sentences


def _tasks(cells: list[Cell], chosen: list[Block]) -> Iterator[task.Task]:
    """Yield the tasks that recompute blocks; blocks of one cell with the same seeds share a task."""
    by: dict[tuple[str, int], dict[Seeds, list[str]]] = {}
    for b in chosen:
        by.setdefault((b.scenario, b.cell), {}).setdefault(b.seeds, []).append(b.observer)
    asked = []  # cells with the observers that are computed again: another may have no gains there (`find_limit`)
    for cell in cells:
        again = {label for each in by.get(cell.key, {}).values() for label in each}
        asked.append(cell._replace(options={o: given for o, given in cell.options.items() if o in again}))
    room = padding.required_capacity(planning.drafts(cells, ()))
    for draft in planning.drafts(asked, by, split_expensive=True):
        for seeds, observers in by[draft.cell.key].items() if draft.labels else ():
            if labels := tuple(label for label in draft.labels if label in observers):
                yield task.Task(padding.fit_to_capacity(draft, room), ((seeds, labels),))


def _verify_task(
    target: storage.Target, work: task.Work, one: task.Task, hold: executors.Hold
) -> tuple[int, list[str]]:
    """Return how many blocks a task recomputed, and a sentence for each that differs."""
    with hold() as device:
        p, results, _, _ = task.simulate_task(work, one, device)
    blocks = [(block_files.block_of(name), rows) for name, rows in task.files(work, one, p, results)]
    return len(blocks), [s for b, now in blocks if b for s in _difference(b, block_files.read(target, b), now)]


def _difference(b: Block, there: pa.Table, here: pa.Table) -> Iterator[str]:
    """Yield the differences of a block from the recomputed one: its rows to the bit, then its metadata."""
    old, new = (block_files.about(table) for table in (there, here))
    if there.equals(here):
        if [
            k for k in old.keys() | new.keys() if k not in ("versions", "digest", "engine") and old.get(k) != new.get(k)
        ]:
            yield f"{b.name}: its rows are reproduced, its metadata are not."
        return
    apart = difference(there, here)
    if apart is None:
        yield f"{b.name}: differs in its rows from the computed ones."
        return
    before, now = (each["versions"] | {"engine": each["engine"]} for each in (old, new))
    changed = [f"{k} {v}, now {now.get(k)}" for k, v in before.items() if now.get(k) != v]
    made = f"made with {'; '.join(changed)}; " if changed else ""
    kind = "rounding" if apart.relative < ROUNDING or apart.of_largest < ZERO else "more than rounding"
    yield f"{b.name}: {made}numbers differ by {apart.of_largest:.1e} of the largest error of their signal ({kind})."


def _exact_again(target: storage.Target, owned: StudyClaim, cells: list[Cell]) -> Iterator[str]:
    """Yield a sentence for each of some cells whose exact numbers are not reproduced."""
    if not cells:
        return
    from pcbench.dataset.moments_frames import Exact  # with pandas

    exact, there = Exact(Grid(owned.study, cells), owned.study.schedules), moments_tables.load_exact_rows(target)
    here = columns.with_intervals(columns.table(columns.concat_columns(exact.all_rows(cells))))
    for cell in cells:
        mine = (pc.field("scenario") == cell.scenario.name) & (pc.field("cell") == cell.number)
        if there is None or not agree(there.filter(mine), here.filter(mine)):
            yield f"{moments_tables.NAME}: {_cell_title(cell)}: the computed numbers differ."


def _cell_title(cell: Cell) -> str:
    return f"{cell.scenario.name}, cell {cell.number}"
