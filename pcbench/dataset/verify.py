"""A look at a dataset: how far it is, whether it is whole, whether it comes out again. Nothing is written.

Do exact numbers come out again? Those of some cells are computed anew, and must be the same but for rounding.

The last bits of a cell may depend on the cells that it shares a call with, so exact numbers are not compared bit for bit.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

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
from pcbench.dataset.manifest import Owned
from pcbench.dataset.merge import agree
from pcbench.dataset.seed_ranges import Seeds
from pcbench.dataset.table_diff import ROUNDING, ZERO, difference
from pcbench.planning import padding
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.grid import Cell, Grid, usable
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified


def differing(target: storage.Target, owned: Owned, sample: int | None, seed: int) -> tuple[list[str], list[str]]:
    """Return which cells were computed again, `sample` drawn with `seed` (None: all), and a sentence for each that differs."""
    there = moments_tables.whole(target)
    if there is None or sample == 0:
        return [], []
    cells = owned.cells
    if sample is not None and sample < len(cells):
        cells = [cells[i] for i in sorted(np.random.default_rng(seed).choice(len(cells), sample, replace=False))]
    from pcbench.dataset.moments_frames import Exact

    exact = Exact(Grid(owned.study, cells), owned.study.schedules)
    here = columns.with_intervals(columns.table(columns.together(exact.rows(m) for m in exact.solved(cells))))
    said = [
        f"{moments_tables.NAME}: {_called(c)}: other numbers come out now." for c in cells if not _same(there, here, c)
    ]
    return [_called(c) for c in cells], said


def _called(cell: Cell) -> str:
    return f"{cell.scenario.name}, cell {cell.number}"


def _same(there: pa.Table, here: pa.Table, cell: Cell) -> bool:
    """Whether the rows of a cell are the same but for rounding; a reason may say a number, which is rounded too."""
    scenario, number = cell.key
    old, new = (
        t.filter((pc.field("scenario") == scenario) & (pc.field("cell") == number)).drop_columns(["reason"])
        for t in (there, here)
    )
    return agree(old, new)


FAIR = "fair.parquet"  # of a study with several tunings
BESIDE = ("examples/", f"{moments_tables.FOLDER}/")


class Share(NamedTuple):
    """How far the runs of one observer in one scenario are."""

    scenario: str
    observer: str
    cells: int
    blocks: int
    seeds: int  # that stand, over all cells
    wanted: int  # that the study names
    certified: bool | None  # whether something proves its gains, as its first block says; None: it has none


class Status(NamedTuple):
    """What stands in a dataset."""

    study: str
    shares: list[Share]
    damaged: list[str]
    doubled: list[str]
    unfinished: list[str]  # of killed writers
    bytes: int
    closed: bool  # the closing tables stand, and are of these blocks


def status(out: str | Path) -> Status:
    """Return what stands in a dataset, from the blocks' names and footers; raise UserError where there is no study."""
    target = storage.target(out)
    owned = manifest.opened(target)
    there = block_files.present(target)
    study, rows = owned.study, []
    by: dict[tuple[str, str], list[Block]] = {}
    for b in there:
        by.setdefault((b.scenario, b.observer), []).append(b)
    kept = block_files.settled(there)
    doubled = [b.name for b in sorted(set(there) - set(kept))]
    wanted = run_missing.everything(owned, there)
    left = moments_tables.simulated(target, owned)
    todo = run_missing.missing(left, kept, wanted, lambda cell: 2**40)
    for scenario in study.scenarios:
        mine = [c for c in left.cells if c.scenario.name == scenario]
        for observer in dict.fromkeys(o for c in mine for o in c.options):
            asked = sum(wanted(cell).many for cell in mine if observer in cell.options)
            gaps = [todo.get((scenario, c.number), {}).get(observer, []) for c in mine]
            lacking = sum(seeds.many for ranges in gaps for seeds in ranges)
            each = by.get((scenario, observer), [])
            proof = block_files.about_block(target, each[0]).get("certificate") if each else None
            certified = is_certified(proof) if proof else None
            share = Share(
                scenario=scenario,
                observer=observer,
                cells=sum(observer in c.options for c in mine),
                blocks=len(each),
                seeds=asked - lacking,
                wanted=asked,
                certified=certified,
            )
            rows.append(share)
    damaged = [b.name for b in there if storage.footer(target, b.name) is None] + close.damaged(target)
    return Status(
        study=study.name,
        shares=rows,
        damaged=damaged,
        doubled=doubled,
        unfinished=[p.name for p in storage.unfinished(target)],
        bytes=sum(storage.sizes(target).values()),
        closed=close.is_closed(target, there),
    )


class Verdict(NamedTuple):
    """What a verification found."""

    files: int  # checked, every page
    wrong: list[str]  # a sentence each
    recomputed: list[str]  # blocks
    differing: list[str]  # a sentence each
    exact: list[str]  # cells whose exact numbers were computed again
    unlike: list[str]  # a sentence for each of them that has others now


def verify(out: str | Path, sample: int | None, seed: int, progress: Progress = SILENT) -> Verdict:
    """Check every file of a dataset, and compute `sample` blocks (None: all) again; compare bit for bit.

    Blocks are drawn with `seed`. The closing tables are made again and compared too, and exact numbers of as many cells.
    """
    target = storage.target(out)
    owned = manifest.opened(target, run=sample != 0)
    digests = manifest.digests(owned)
    there, wrong, good = block_files.present(target), [], []
    progress.begin("checking", len(there))
    for b in there:
        found = block_files.damage(target, b, digests.get((b.scenario, b.cell), ""))
        wrong += [f"{b.name}: {found}."] if found else []
        good += [] if found else [b]
        progress.step(1)
    kept = block_files.settled(good)
    wrong += [f"{b.name}: holds seeds that another block holds." for b in sorted(set(good) - set(kept))]
    wrong += _others(target, owned)
    wrong += [] if wrong else _closing_differs(target, owned, kept)
    chosen = _computed_here(owned, kept)
    if sample is not None and sample < len(chosen):
        chosen = [chosen[i] for i in sorted(np.random.default_rng(seed).choice(len(chosen), sample, replace=False))]
    progress.begin("computing again", len(chosen))
    again = [b.name for b in chosen], list(_again(target, owned, chosen, progress))
    return Verdict(len(there), wrong, *again, *differing(target, owned, sample, seed))


def _computed_here(owned: Owned, blocks: list[Block]) -> list[Block]:
    """The blocks that can be computed again: those of observers that live elsewhere cannot."""
    away = {(*c.key, o) for c in owned.cells for o in c.options if c.entry(o).elsewhere}
    return [b for b in blocks if (b.scenario, b.cell, b.observer) not in away]


def _again(target: storage.Target, owned: Owned, chosen: list[Block], progress: Progress) -> Iterator[str]:
    """Yield a sentence for every block that does not come out again."""
    work = partial(_compared, target, task.Work("", owned.study.name, owned.study.root_seed))
    with executors.here() as execute:
        by: dict[str, list[Block]] = {}
        for b in chosen:
            flow = block_files.about_block(target, b)["flow"]
            by.setdefault(_engine(flow, owned), []).append(b)
        for engine, mine in by.items():
            cells = [cell._replace(engine=engine) for cell in owned.cells]
            for count, sentences in execute(work, _tasks(owned._replace(cells=cells), mine)):
                progress.step(count)
                yield from sentences


def _engine(flow: str, owned: Owned) -> str:
    """The engine that has computed a block: that of its study, but for blocks of another that were merged or added."""
    asked = str(owned.study.engine)
    if asked == "definition" and flow != "defined":
        asked = "products" if flow == "lifted" else "steps"
    return usable("definition" if flow == "defined" else asked)


def _tasks(owned: Owned, chosen: list[Block]) -> Iterator[task.Task]:
    """Yield the tasks that compute blocks again: those of one cell and the same seeds together."""
    by: dict[tuple[str, int], dict[Seeds, list[str]]] = {}
    for b in chosen:
        by.setdefault((b.scenario, b.cell), {}).setdefault(b.seeds, []).append(b.observer)
    room = padding.needed(planning.drafts(owned.cells, ()))
    for draft in planning.drafts([_asked(cell, by.get(cell.key, {})) for cell in owned.cells], by, apart=True):
        for seeds, observers in by[draft.cell.key].items() if draft.labels else ():
            if labels := tuple(label for label in draft.labels if label in observers):
                yield task.Task(padding.fitted(draft, room), ((seeds, labels),))


def _asked(cell: Cell, by: dict[Seeds, list[str]]) -> Cell:
    """A cell with the observers that are computed again: another may have no gains there (`find_limit`)."""
    asked = {label for labels in by.values() for label in labels}
    return cell._replace(options={o: given for o, given in cell.options.items() if o in asked})


def _compared(target: storage.Target, work: task.Work, one: task.Task, hold: task.Hold) -> tuple[int, list[str]]:
    """Return how many blocks a task computed again, and a sentence for each that differs."""
    with hold() as device:
        p, results, program = task.simulated(work, one, device)
    made = [(block_files.block_of(name), rows) for name, (rows, _) in task.files(work, one, p, results, program.ways)]
    return len(made), [said for b, now in made if b for said in _difference(b, block_files.read(target, b), now)]


def _difference(b: Block, there: pa.Table, here: pa.Table) -> Iterator[str]:
    """Yield how a block differs from what comes out now, if it does: rows to the bit, then what it says of itself."""
    old, new = (block_files.about(table) for table in (there, here))
    if there.equals(here):
        if [k for k in old.keys() | new.keys() if k not in ("versions", "digest", "flow") and old.get(k) != new.get(k)]:
            yield f"{b.name}: its rows come out again, what it says of itself does not."
        return
    apart = difference(there, here)
    if apart is None:
        yield f"{b.name}: has other rows than come out now."
        return
    now = new["versions"]
    changed = [f"{k} {v}, now {now.get(k)}" for k, v in old["versions"].items() if now.get(k) != v]
    if (way := old["flow"]) != new["flow"]:
        changed.append(f"flow {way}, now {new['flow']}")
    made = f"made with {'; '.join(changed)}; " if changed else ""
    kind = "rounding" if apart.relative < ROUNDING or apart.of_largest < ZERO else "more than rounding"
    yield (f"{b.name}: {made}numbers differ by {apart.of_largest:.1e} of the largest error of their signal ({kind}).")


def _others(target: storage.Target, owned: Owned) -> Iterator[str]:
    """Yield a sentence for every file beside the blocks that is not as it was written."""
    for name in close.damaged(target):
        yield f"{name}: is not as it was written; run the study again to have it made anew."
    said = close.record(target)
    if said and said["study_sha256"] != digest(owned.study, owned.cells):
        yield f"{manifest.TEXT}: is not of the study that was run; run that again to have it written anew."
    for name in [n for n in storage.names(target) if n.startswith(BESIDE) or n in (FAIR, moments_tables.NAME)]:
        content = storage.get(target, name)
        if content is None or parquet_io.whole(content) is None:
            yield f"{name}: is not as it was written; remove it to have it made anew."


def _closing_differs(target: storage.Target, owned: Owned, kept: list[Block]) -> list[str]:
    """Return a sentence for every closing table that does not follow from the blocks."""
    if not close.is_closed(target, kept):
        return ["stats.parquet and pairs.parquet are not of the blocks that stand; run the study again to go on."]
    stats, pairs = close.closing_tables(target, owned, kept)
    out = []
    for name, made in (("stats.parquet", stats), ("pairs.parquet", pairs)):
        there = close.table(target, name)
        if there is None or not there.equals(parquet_io.parsed(made)):
            out.append(f"{name}: does not follow from the blocks; run the study again to have it made anew.")
    return out
