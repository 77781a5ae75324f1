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
from pcbench.study.grid import Cell, Grid, usable_engine
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified

FAIR = "fair.parquet"  # of a study with several tunings
OPTIONAL = ("examples/", f"{moments_tables.FOLDER}/")
T = TypeVar("T")


class Share(NamedTuple):
    """The progress of one observer's runs in one scenario."""

    scenario: str
    observer: str
    cells: int
    blocks: int
    seeds: int  # computed, over all cells
    wanted: int  # required by the study
    certified: bool | None  # whether its gains have a certificate, from its first block; None: no gains


class Status(NamedTuple):
    """The content of a dataset."""

    study: str
    shares: list[Share]
    damaged: list[str]
    doubled: list[str]
    unfinished: list[str]  # of killed writers
    bytes: int
    closed: bool  # the closing tables exist, and belong to these blocks


def status(out: str | Path) -> Status:
    """Return the content of a dataset, from the blocks' names and footers; raise UserError if there is no study."""
    target = storage.target(out)
    claim = manifest.load_manifest(target)
    blocks = block_files.present(target)
    valid = block_files.drop_overlaps(blocks)
    seeds_of = run_missing.required_seeds(claim, blocks)
    simulations = moments_tables.select_simulations(target, claim)
    todo = run_missing.missing_seeds(simulations, valid, seeds_of, lambda cell: 2**40)
    shares = []
    for scenario in claim.study.scenarios:
        scenario_cells = [c for c in simulations.cells if c.scenario.name == scenario]
        for observer in dict.fromkeys(o for c in scenario_cells for o in c.options):
            cells = [c for c in scenario_cells if observer in c.options]
            n_seeds = sum(seeds_of(cell).many for cell in cells)
            n_missing = sum(seeds.many for c in cells for seeds in todo.get(c.key, {}).get(observer, []))
            observer_blocks = [b for b in blocks if (b.scenario, b.observer) == (scenario, observer)]
            certificate = (
                block_files.about_block(target, observer_blocks[0]).get("certificate") if observer_blocks else None
            )
            certified = is_certified(certificate) if certificate else None
            share = Share(
                scenario=scenario,
                observer=observer,
                cells=len(cells),
                blocks=len(observer_blocks),
                seeds=n_seeds - n_missing,
                wanted=n_seeds,
                certified=certified,
            )
            shares.append(share)
    return Status(
        study=claim.study.name,
        shares=shares,
        damaged=[b.name for b in blocks if storage.read_footer(target, b.name) is None] + close.damaged_files(target),
        doubled=[b.name for b in sorted(set(blocks) - set(valid))],
        unfinished=[p.name for p in storage.unfinished_files(target)],
        bytes=sum(storage.file_sizes(target).values()),
        closed=close.is_closed(target, blocks),
    )


class Verdict(NamedTuple):
    """The result of a verification."""

    files: int  # checked, every page
    wrong: list[str]  # a sentence each
    recomputed: list[str]  # blocks
    differing: list[str]  # a sentence each
    exact: list[str]  # cells whose exact numbers were computed again
    unlike: list[str]  # a sentence for each of them that was not reproduced


def verify(out: str | Path, sample: int | None, seed: int, progress: Progress = SILENT) -> Verdict:
    """Check every file of a dataset, recompute `sample` blocks (None: all), and compare them bit for bit.

    The blocks are selected at random with `seed`. The closing tables are recomputed and compared too, and so are the
    exact numbers of as many cells.
    """
    target = storage.target(out)
    claim = manifest.load_manifest(target, run=sample != 0)
    digests = manifest.digests(claim)
    blocks, errors, intact = block_files.present(target), [], []
    progress.begin("checking", len(blocks))
    for b in blocks:
        if reason := block_files.damage(target, b, digests.get((b.scenario, b.cell), "")):
            errors.append(f"{b.name}: {reason}.")
        else:
            intact.append(b)
        progress.step(1)
    unique = block_files.drop_overlaps(intact)
    errors += [f"{b.name}: contains seeds that another block contains." for b in sorted(set(intact) - set(unique))]
    errors += _changed_files(target, claim)
    errors += [] if errors else _closing_differs(target, claim, unique)
    elsewhere = {(*c.key, o) for c in claim.cells for o in c.options if c.entry(o).elsewhere}  # not to be computed here
    selection = _draw_sample([b for b in unique if (b.scenario, b.cell, b.observer) not in elsewhere], sample, seed)
    progress.begin("computing again", len(selection))
    block_errors = list(_recompute_blocks(target, claim, selection, progress))
    cells = [] if moments_tables.load_exact_rows(target) is None else _draw_sample(claim.cells, sample, seed)
    exact_errors = list(_recompute_exact(target, claim, cells))
    return Verdict(
        len(blocks), errors, [b.name for b in selection], block_errors, list(map(_cell_title, cells)), exact_errors
    )


def _draw_sample(population: list[T], sample: int | None, seed: int) -> list[T]:
    """A random sample of some items, in their order."""
    if sample is None or sample >= len(population):
        return population
    return [population[i] for i in sorted(np.random.default_rng(seed).choice(len(population), sample, replace=False))]


def _changed_files(target: storage.Target, claim: StudyClaim) -> Iterator[str]:
    """Yield a sentence for every file other than the blocks that has changed."""
    for name in close.damaged_files(target):
        yield f"{name}: has changed; run the study again to write it again."
    record = close.record(target)
    if record and record["study_sha256"] != digest(claim.study, claim.cells):
        yield f"{manifest.TEXT}: is not of the study that was run; run that study again to write it again."
    for name in [n for n in storage.file_names(target) if n.startswith(OPTIONAL) or n in (FAIR, moments_tables.NAME)]:
        if parquet_io.unseal_table(storage.read_buffer(target, name)) is None:
            yield f"{name}: has changed; remove it, and run the study again."


def _closing_differs(target: storage.Target, claim: StudyClaim, blocks: list[Block]) -> Iterator[str]:
    """Yield a sentence for every closing table that does not follow from the blocks."""
    if not close.is_closed(target, blocks):
        yield "stats.parquet and pairs.parquet do not belong to the blocks; run the study again to continue."
        return
    tables = close.closing_tables(target, claim, blocks)
    for name, content in (("stats.parquet", tables.stats), ("pairs.parquet", tables.pairs)):
        table = close.table(target, name)
        if table is None or not table.equals(parquet_io.parse_table(content)):
            yield f"{name}: does not follow from the blocks; run the study again to write it again."


def _recompute_blocks(
    target: storage.Target, claim: StudyClaim, blocks: list[Block], progress: Progress
) -> Iterator[str]:
    """Yield a sentence for every block that is not reproduced."""
    work = partial(_verify_task, target, task.Work("", claim.study.name, claim.study.root_seed))
    by_engine: dict[str, list[Block]] = {}
    for b in blocks:
        by_engine.setdefault(usable_engine(block_files.about_block(target, b)["engine"]), []).append(b)
    with executors.local_executor() as execute:
        for engine, group in by_engine.items():
            cells = [cell._replace(engine=engine) for cell in claim.cells]
            for count, sentences in execute(work, _tasks(cells, group)):
                progress.step(count)
                yield from sentences


def _tasks(cells: list[Cell], blocks: list[Block]) -> Iterator[task.Task]:
    """Yield the tasks that recompute blocks; blocks of one cell with the same seeds share a task."""
    by_cell: dict[tuple[str, int], dict[Seeds, list[str]]] = {}
    for b in blocks:
        by_cell.setdefault((b.scenario, b.cell), {}).setdefault(b.seeds, []).append(b.observer)
    subset = []  # cells with the observers that are computed again: another may have no gains there (`find_limit`)
    for cell in cells:
        names = {label for group in by_cell.get(cell.key, {}).values() for label in group}
        subset.append(cell._replace(options={o: values for o, values in cell.options.items() if o in names}))
    room = padding.required_capacity(planning.drafts(cells, ()))
    for draft in planning.drafts(subset, by_cell, split_expensive=True):
        for seeds, observers in by_cell[draft.cell.key].items() if draft.labels else ():
            if labels := tuple(label for label in draft.labels if label in observers):
                yield task.Task(padding.fit_to_capacity(draft, room), ((seeds, labels),))


def _verify_task(target: storage.Target, work: task.Work, t: task.Task, hold: executors.Hold) -> tuple[int, list[str]]:
    """Return how many blocks a task recomputed, and a sentence for each that differs."""
    with hold() as device:
        p, results, _, _ = task.simulate_task(work, t, device)
    blocks = [(block_files.block_of(name), rows) for name, rows in task.files(work, t, p, results)]
    return len(blocks), [s for b, new in blocks if b for s in _difference(b, block_files.read_block(target, b), new)]


def _difference(b: Block, old_table: pa.Table, new_table: pa.Table) -> Iterator[str]:
    """Yield the differences of a block from the recomputed one: its rows to the bit, then its metadata."""
    old, new = (block_files.about(table) for table in (old_table, new_table))
    if old_table.equals(new_table):
        keys = (old.keys() | new.keys()) - {"versions", "digest", "engine"}
        if any(old.get(k) != new.get(k) for k in keys):
            yield f"{b.name}: its rows are reproduced, its metadata are not."
        return
    deviation = difference(old_table, new_table)
    if deviation is None:
        yield f"{b.name}: differs in its rows from the computed ones."
        return
    old_versions, new_versions = (m["versions"] | {"engine": m["engine"]} for m in (old, new))
    changes = [f"{k} {v}, now {new_versions.get(k)}" for k, v in old_versions.items() if new_versions.get(k) != v]
    origin = f"made with {'; '.join(changes)}; " if changes else ""
    kind = "rounding" if deviation.relative < ROUNDING or deviation.of_largest < ZERO else "more than rounding"
    yield f"{b.name}: {origin}numbers differ by {deviation.of_largest:.1e} of the largest error of their signal ({kind})."


def _recompute_exact(target: storage.Target, claim: StudyClaim, cells: list[Cell]) -> Iterator[str]:
    """Yield a sentence for each of some cells whose exact numbers are not reproduced."""
    if not cells:
        return
    from pcbench.dataset.moments_frames import Exact  # with pandas

    exact, old = Exact(Grid(claim.study, cells), claim.study.schedules), moments_tables.load_exact_rows(target)
    new = columns.with_intervals(columns.table(columns.concat_columns(exact.all_rows(cells))))
    for cell in cells:
        condition = (pc.field("scenario") == cell.scenario.name) & (pc.field("cell") == cell.number)
        if old is None or not agree(old.filter(condition), new.filter(condition)):
            yield f"{moments_tables.NAME}: {_cell_title(cell)}: the computed numbers differ."


def _cell_title(cell: Cell) -> str:
    return f"{cell.scenario.name}, cell {cell.number}"
