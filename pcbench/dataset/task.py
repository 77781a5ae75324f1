"""One task of a study: it simulates some seeds of one cell and writes complete files.

A task is a pure function of its description. Wherever and however often it runs, its files contain the same bytes.
"""

from collections.abc import Iterator
from contextlib import nullcontext
from math import isfinite
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np
import pyarrow as pa

from pcbench import statistics
from pcbench.dataset import block_files, columns, storage, table_builder, timing
from pcbench.dataset.executors import Hold
from pcbench.dataset.seed_ranges import Seeds
from pcbench.dataset.serialize import pack, unpack
from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.planning import run_local
from pcbench.planning.padding import Plan
from pcbench.plants import signals_of
from pcbench.runtime import config, provenance
from pcbench.study.grid import Cell

ROW_BYTES = 1000  # a row takes as results, as columns, as Python's text and as the bytes of its file: 600 measured


class Work(NamedTuple):
    """What all tasks of a study share."""

    out: str  # folder or URI of the dataset
    study: str
    root_seed: int
    memory: float = float("inf")  # bytes that one task may take


class Task(NamedTuple):
    """Some seeds of one cell, for the observers of one program."""

    parcel: bytes | Plan  # the planned cell
    pieces: tuple[tuple[Seeds, tuple[str, ...]], ...]  # seeds and observers: the blocks to write
    timed: bool = False  # no block is written: it is estimated how long a call takes

    def __reduce__(self) -> tuple[object, ...]:
        """Serialize to bytes that another process can read, also with a user's code."""
        parcel = pack(self.parcel) if isinstance(self.parcel, Plan) else self.parcel
        return Task, (parcel, self.pieces, self.timed)

    @property
    def runs(self) -> int:
        """Return the number of runs in its blocks."""
        return 0 if self.timed else sum(seeds.many * len(labels) for seeds, labels in self.pieces)


class Call(NamedTuple):
    """The estimated time of a call of a program."""

    seconds: float
    width: int  # runs
    labels: tuple[str, ...]  # its observers


class Report(NamedTuple):
    """The report of a task after its files are written."""

    cell: tuple[str, int]  # its key
    cost: timing.Cost
    versions: dict[str, str]  # of what computed it
    call: Call | None = None  # of a task that is timed


def compute(work: Work, task: Task, hold: Hold = nullcontext) -> Report:
    """Simulate a task's seeds while it holds a device, then write its blocks; raise UserError if that fails."""
    with hold() as device:
        compute_start = perf_counter()
        p, results, program, call = simulate_task(work, task, device)
        computing_seconds = perf_counter() - compute_start
    start, target = perf_counter(), storage.target(work.out)
    blocks = {} if call else dict(files(work, task, p, results))
    for name, table in blocks.items():
        storage.write_table(
            target, name, table, durable=False
        )  # `run_missing` syncs the names of all blocks at the end
    cost = timing.Cost(
        runs=task.runs,
        compiled={(config.name(), program.number): program.compile_seconds},
        computing_seconds=computing_seconds,
        writing_seconds=perf_counter() - start,
    )
    return Report(p.cell.key, cost, provenance.versions(), call)


def simulate_task(
    work: Work, task: Task, device: jax.Device | None = None
) -> tuple[Plan, run_local.Results, runner.Program, Call | None]:
    """Return the results of a task's runs, or the time of a call, estimated from calls that end early.

    Raises UserError if a call needs more memory than is available.
    """
    with config.float64():
        p = unpack(task.parcel)
        seeds = np.concatenate([np.arange(*s) for s, _ in task.pieces])
        jobs = list(run_local.jobs(p, work.root_seed, seeds))
        program = runner.program(p.layout, jobs[0], device)
        if program.memory > work.memory:
            raise UserError(
                f"--memory: one call of {p.cell.scenario.name} with {', '.join(p.labels)} takes {program.memory / 1e6:.0f} MB, "
                f"got {work.memory / 1e6:.0f} MB for each of those at a time, expected more; give more, or fewer workers."
            )
        if task.timed:
            return p, {}, program, Call(timing.seconds(program, jobs[0]), program.width, p.labels)
        return p, run_local.results(p, runner.serial(program, jobs)), program, None


def files(work: Work, task: Task, p: Plan, results: run_local.Results) -> Iterator[tuple[str, pa.Table]]:
    """Yield the blocks of a task: name and rows."""
    at = 0
    for seeds, labels in task.pieces:
        common: dict[int, dict[str, pa.Array]] = {}
        for label in labels:
            part = {m: values[..., at : at + seeds.many] for m, values in results[label].items()}
            yield block(work, p, label, part, seeds, common)
        at += seeds.many


def block(
    work: Work,
    p: Plan,
    label: str,
    results: statistics.Results,
    seeds: Seeds,
    common: dict[int, dict[str, pa.Array]] | None = None,
) -> tuple[str, pa.Table]:
    """Return the name and the rows of one block; its metadata contain what statistics need in addition to the rows.

    `common` stores the shared columns of blocks with these seeds, by their number of signals, and is extended here.
    """
    c, n_signals = p.certificates[label], len(results["mae"])
    certificate = {"inequality": c.inequality, "margin": float(c.margin) if isfinite(c.margin) else None}
    about = {
        "study": work.study,
        "root_seed": work.root_seed,
        "cell": p.cell.digest,
        "observer": label,
        "options": p.cell.options_digests[label],
        "first": seeds.first,
        "last": seeds.stop,
        "metrics": {m: len(results[m]) for m in statistics.RUN_METRICS if m in results},
        "predicts_unknown_input": p.predicts_unknown_input[label],
        "bound": None if p.bound is None else [float(b) for b in p.bound[:n_signals]],
        "certificate": certificate | {"solver": c.solver, "status": c.status},
        "engine": p.cell.engine,
        "versions": provenance.versions(),
    }
    common = {} if common is None else common
    if n_signals not in common:
        signals, head = signals_of(p.cell.scenario)[:n_signals], columns.keys(work.study, p.cell)
        common[n_signals] = table_builder.common_columns(head, np.arange(*seeds), signals)
    table = table_builder.runs_table(common[n_signals], results, p.predicts_unknown_input[label])
    name = block_files.Block(p.cell.scenario.name, label, p.cell.number, seeds).name
    return name, block_files.seal_block(table, about)


def tasks(parcel: bytes | Plan, width: int, missing: dict[str, list[Seeds]]) -> Iterator[Task]:
    """Yield the tasks for a cell's `missing` ranges (by observer): one block per range, as many as fill a call."""
    by_seeds: dict[Seeds, list[str]] = {}
    for label, ranges in missing.items():
        for s in ranges:
            by_seeds.setdefault(s, []).append(label)
    pieces: list[tuple[Seeds, tuple[str, ...]]] = []
    for seeds, labels in sorted(by_seeds.items()):
        if pieces and sum(s.many for s, _ in pieces) + seeds.many > width:
            yield Task(parcel, tuple(pieces))
            pieces = []
        pieces.append((seeds, tuple(labels)))
    if pieces:
        yield Task(parcel, tuple(pieces))


def bytes_of_a_block(cell: Cell, seeds: int) -> int:
    """Return the memory of the results of some seeds for all observers of a cell: arrays, rows and file."""
    return seeds * len(signals_of(cell.scenario)) * len(cell.options) * ROW_BYTES
