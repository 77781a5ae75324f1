"""`pcbench external score`: estimates made elsewhere as one more observer of a study, with the same metrics and pairs.

That an estimate uses nothing that had not arrived cannot be seen in it: this is trusted, and said.

The metrics of runs whose estimates are given, as the simulation keeps them: sums over the same windows, the same watches.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.dataset import block_files, manifest, run_study, storage, stored_code, task
from pcbench.dataset.result import Result
from pcbench.dataset.run_study import How, Say
from pcbench.dataset.seed_ranges import Seeds
from pcbench.errors import UserError, short
from pcbench.external import import_estimates, runs
from pcbench.external.entry import ONE_AT_A_TIME, REFERENCE
from pcbench.observers import base_of
from pcbench.planning import digits
from pcbench.planning.padding import Plan
from pcbench.plants import signals_of
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.simulation import metrics
from pcbench.simulation.metrics import ErrorSums, SettlingState
from pcbench.study import parse
from pcbench.study.grid import Grid
from pcbench.study.labels import LABEL
from pcbench.study.plugins import user_code
from pcbench.synthesis.certificate import no_certificate

Floats = NDArray[np.float64]


def scored(p: Plan, x: Floats, xhat: Floats) -> dict[str, Any]:
    """Return every metric of runs by name, [s, runs]: x [runs, N+1, n + s] and xhat [runs, N, s] at ticks 0 .. N-1."""
    n, tail, dt = p.cell.times.ticks, p.cell.times.tail, p.cell.scenario.dt
    many = xhat.shape[-1]
    e = np.moveaxis(x[:, :n, :many] - xhat, (0, 1, 2), (2, 0, 1))  # [N, s, runs]
    with np.errstate(invalid="ignore", over="ignore"):
        streams = [_stream(e[a:b]) for a, b in np.asarray(p.problem.windows)]
        watch = _watch(e, p)
    whole: Any = ErrorSums._make(np.stack(each) for each in zip(*streams, strict=True))
    digits.require_of(p, x[:, n - 1].T, whole.absolute[1:].sum(0) / (n - tail))
    falls = bool((p.problem.jumps < n).any())
    return metrics.read(whole, watch, e[-1], n, tail, dt, falls)  # type: ignore[arg-type]


def _stream(e: Floats) -> ErrorSums:
    size = np.abs(e)
    return ErrorSums(size.sum(0), (e * e).sum(0), size.max(0, initial=0.0))  # type: ignore[arg-type]


def _watch(e: Floats, p: Plan) -> SettlingState:
    after: Any
    many, ticks = e.shape[1], np.arange(len(e))[:, None, None]
    size, band, bound = np.abs(e), *(np.asarray(a)[:many, None] for a in (p.problem.band, p.problem.bound))
    outside = size > band  # [N, s, runs]
    bad: Any = np.logical_not((size <= bound).all(1))  # [N, runs]
    unsettled = np.where(outside, ticks + 1, 0).max(0)
    first = np.where(bad.any(0), bad.argmax(0), -1)
    jumps = np.asarray(p.problem.jumps)
    recovery = np.zeros(e.shape[1:])
    if len(jumps):
        gone = np.where(jumps <= ticks[:, 0], ticks[:, 0] - jumps, np.iinfo(int).max)
        since, after = gone.min(1), (jumps <= ticks[:, 0]).any(1)
        recovery = np.where(outside & after[:, None, None], since[:, None, None] + 1.0, 0.0).max(0)
    return SettlingState(unsettled.astype(float), recovery, first.astype(float))  # type: ignore[arg-type]


TRUSTED = (
    "that estimates use only what had arrived by their tick cannot be checked of such made elsewhere, and is trusted."
)


def score(
    folder: str | Path, file: str | Path, name: str, progress: Progress = SILENT, say: Say | None = None
) -> Result:
    """Add estimates to a study's tables as the observer `name`; the study's other observers are run where they are missing.

    Raises UserError for a name that is taken, for runs that are missing, and for ticks that are not all there.
    """
    target = storage.target(folder)
    with config.float64():
        grid = grown(target, name)
        owned = manifest.claim(target, grid)
        table = import_estimates.read(file)
        cells = [cell for cell in owned.cells if name in cell.options]
        each = {cell.key: [s for s, _ in signals_of(cell.scenario)] for cell in cells}
        every = list(dict.fromkeys(s for names in each.values() for s in names))
        found = import_estimates.sorted_(table, short(str(file)), every, cells[0].key if len(cells) == 1 else None)
        seeds = _seeds(target, grid)
        blocks = []
        progress.begin("runs", seeds.many * len(cells))
        for cell in cells:
            where = f"{short(str(file))}: {cell.scenario.name}, cell {cell.number}"
            given = import_estimates.of_cell(
                found.get(cell.key), where, each[cell.key], np.arange(*seeds), cell.times.ticks
            )
            p = runs.planned(cell)
            results = _results(p, grid.study.root_seed, seeds, given, progress)
            blocks.append((p, results))
        manifest.begin(target, owned)
        work = task.Work(target.uri, grid.study.name, grid.study.root_seed)
        _without(target, name)
        for p, results in blocks:
            marked = _marked(p, name)
            block, (rows, _) = task.block(work, marked, name, results, seeds, "guest")
            storage.put_table(target, block, rows)
        (say or (lambda sentence: None))(f"{name}: {TRUSTED}")
        return run_study.execute(grid, folder, How(progress=progress, say=say or (lambda sentence: None)))


def grown(target: storage.Target, name: str) -> Grid:
    """Return the study of a folder with the guest `name` among its observers; raise UserError where the name cannot be."""
    _named(name)
    said = storage.text(target, manifest.TEXT)
    if said is None:
        raise UserError(
            f"{target.name}: holds no study, expected a folder that pcbench external prepare has written; name that one."
        )
    there = manifest.read_text(target, said)
    raw = {k: v for k, v in there.items() if k != "resolved"}
    taken = dict(raw.get("custom_observers", {}))
    labels = list(
        raw.get("observers") or dict.fromkeys(o for names in there["resolved"]["observers"].values() for o in names)
    )
    if name in labels and taken.get(name) != REFERENCE:
        raise UserError(f"--name: got '{name}', which the study has as an observer of its own; give another name.")
    raw["custom_observers"] = taken | {name: REFERENCE}
    raw["observers"] = labels if name in labels else [*labels, name]
    return parse.grid(raw, f"{target.name}/{manifest.TEXT}", stored_code.gate(target, there, True))


def _named(name: str) -> None:
    if not LABEL.fullmatch(name) or base_of(name) or user_code.is_reference(name):
        raise UserError(
            f"--name: got '{short(name)}', expected letters, digits and '-', and no name that begins as one of pcbench's own "
            "observers; write another, such as matlab-ekf."
        )


def _seeds(target: storage.Target, grid: Grid) -> Seeds:
    """All seeds that the study's other observers have, or are to have."""
    named = Seeds(grid.study.first_seed, grid.study.first_seed + grid.study.seeds)
    return Seeds(named.first, max([named.stop, *(b.seeds.stop for b in block_files.present(target))]))


def _results(p: Plan, root_seed: int, seeds: Seeds, given: Any, progress: Progress) -> dict[str, Any]:
    """The metrics of all runs of a cell, some runs at a time: [s, runs]."""
    parts = []
    waiting: list[runs.Run] = []
    for run in runs.runs(p, root_seed, np.arange(*seeds)):
        waiting.append(run)
        progress.step(1)
        if len(waiting) == runs.TOGETHER or run.seed == seeds.stop - 1:
            at = waiting[0].seed - seeds.first
            parts.append(scored(p, np.stack([r.x for r in waiting]), given[at : at + len(waiting)]))
            waiting = []
    return {name: np.concatenate([part[name] for part in parts], -1) for name in parts[0]}


def _marked(p: Plan, name: str) -> Plan:
    """The plan as if it had the guest among its observers."""
    return p._replace(
        certificates={name: no_certificate(ONE_AT_A_TIME)}, predicts_unknown_input={name: None}, labels=(name,)
    )


def _without(target: storage.Target, name: str) -> None:
    """Remove what the guest has left there before."""
    for block in block_files.present(target):
        if block.observer == name:
            storage.remove(target, block.name)
