"""`pcbench external score` and `run`: external estimates as one more observer of a study, with the same metrics.

Estimates are a table with one row per tick of each run, checked for completeness. The table cannot show whether an estimate
uses measurements that had not yet arrived. This is not checked, and a sentence reports it. Metrics are those of the simulation:
sums over the same windows, with the same settling rule.
"""

import os
import subprocess
import sys
import tempfile
from itertools import chain
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from numpy.typing import NDArray

from pcbench.dataset import block_files, manifest, run_study, storage, stored_code, task
from pcbench.dataset.result import Result
from pcbench.dataset.run_study import OnWarning, RunOptions
from pcbench.dataset.seed_ranges import Seeds
from pcbench.errors import UserError, short, unknown
from pcbench.external import runs
from pcbench.external.entry import ONE_AT_A_TIME, REFERENCE
from pcbench.observers import base_of
from pcbench.planning import digits
from pcbench.planning.padding import Plan
from pcbench.plants import estimated_of
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.simulation import metrics
from pcbench.simulation.metrics import ErrorSums, SettlingState
from pcbench.simulation.types import present
from pcbench.study import parse
from pcbench.study.grid import Grid
from pcbench.study.labels import LABEL
from pcbench.study.plugins import user_code
from pcbench.synthesis.certificate import no_certificate

KEYS = ("scenario", "cell", "seed", "tick")
NOT_CHECKED = "pcbench cannot check that these estimates use only measurements that had arrived by their tick."
Floats = NDArray[np.float64]


def run(
    folder: str | Path, reference: str, name: str, progress: Progress = SILENT, on_warning: OnWarning | None = None
) -> Result:
    """Run an external estimator MODULE:NAME on the exported runs and add it to the tables; raise UserError for its errors.

    It runs in its own process, so its imports do not affect pcbench.
    """
    if not (Path(folder) / "draws" / "cells.json").is_file():
        raise UserError(f"{folder}: contains no draws; give a folder that pcbench external prepare has written.")
    with tempfile.TemporaryDirectory(prefix="pcbench-external-") as temporary:
        out = f"{temporary}/estimates.parquet"
        progress.note("running the external estimator, one run at a time")
        command = [sys.executable, "-m", "pcbench.external.entry", str(folder), reference, out]
        process = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
        if process.returncode:
            last = (process.stderr.strip().splitlines() or ["no message"])[-1]
            if process.returncode != 2:
                last = f"external estimator {reference}: ended with {last}, expected estimates; correct it."
            raise UserError(last)
        return score(folder, out, name, progress, on_warning)


def score(
    folder: str | Path, file: str | Path, name: str, progress: Progress = SILENT, on_warning: OnWarning | None = None
) -> Result:
    """Add estimates to a study's tables as the observer `name`; missing runs of the study's other observers are simulated.

    Raises UserError for a name in use, missing runs, or missing ticks.
    """
    target, where, on_warning = storage.target(folder), short(str(file)), on_warning or (lambda sentence: None)
    with config.float64():
        grid = extend_study(target, name)
        claim = manifest.claim(target, grid)
        cells = [cell for cell in claim.cells if name in cell.options]
        signals = {cell.key: [s for s, _ in estimated_of(cell.scenario)] for cell in cells}
        all_signals = list(dict.fromkeys(s for names in signals.values() for s in names))
        tables = sort_by_cell(read_estimates(file), where, all_signals, cells[0].key if len(cells) == 1 else None)
        seeds = _seeds(target, grid)
        blocks = []
        progress.begin("runs", seeds.many * len(cells))
        for cell in cells:
            place = f"{where}: {cell.scenario.name}, cell {cell.number}"
            xhat = estimates_of(tables.get(cell.key), place, signals[cell.key], np.arange(*seeds), cell.times.ticks)
            p = runs.plan_without_observers(cell)
            blocks.append((p, _results(p, grid.study.root_seed, seeds, xhat, progress)))
        manifest.begin(target, claim)
        work = task.Work(target.uri, grid.study.name, grid.study.root_seed)
        for block in block_files.present(target):  # earlier results of this estimator
            if block.observer == name:
                storage.remove(target, block.name)
        for p, results in blocks:
            p = p._replace(  # with the external estimator among its observers
                certificates={name: no_certificate(ONE_AT_A_TIME)}, predicts_unknown_input={name: None}, labels=(name,)
            )
            file_name, rows = task.block(work, p, name, results, seeds)
            storage.write_table(target, file_name, rows)
        on_warning(f"{name}: {NOT_CHECKED}")
        return run_study.execute(grid, folder, RunOptions(progress=progress, on_warning=on_warning))


def extend_study(target: storage.Target, name: str) -> Grid:
    """Return the study of a folder with the external estimator `name`; raise UserError for an invalid name."""
    if not LABEL.fullmatch(name) or base_of(name) or user_code.is_reference(name):
        raise UserError(
            f"--name: got '{short(name)}', expected letters, digits and '-', and no name that begins as one of pcbench's own "
            "observers; write another, such as matlab-ekf."
        )
    text = storage.read_bytes(target, manifest.TEXT)
    if text is None:
        raise UserError(f"{target.name}: contains no study; give a folder that pcbench external prepare has written.")
    content = manifest.read_text(target, text)
    raw = {k: v for k, v in content.items() if k != "resolved"}
    custom_observers = dict(raw.get("custom_observers", {}))
    labels = list(raw.get("observers") or dict.fromkeys(chain(*content["resolved"]["observers"].values())))
    if name in labels and custom_observers.get(name) != REFERENCE:
        raise UserError(f"--name: got '{name}', which the study has as an observer of its own; give another name.")
    raw["custom_observers"] = custom_observers | {name: REFERENCE}
    raw["observers"] = labels if name in labels else [*labels, name]
    return parse.grid(raw, f"{target.name}/{manifest.TEXT}", stored_code.gate(target, content, True))


def _seeds(target: storage.Target, grid: Grid) -> Seeds:
    """Return all seeds that the study's other observers have or will have."""
    study_seeds = Seeds(grid.study.first_seed, grid.study.first_seed + grid.study.seeds)
    return Seeds(study_seeds.first, max([study_seeds.stop, *(b.seeds.stop for b in block_files.present(target))]))


def _results(p: Plan, root_seed: int, seeds: Seeds, xhat: Floats, progress: Progress) -> dict[str, Floats]:
    """Return the metrics of all runs of a grid point, [s, runs], computed in parts; `xhat` [runs, N, s]."""
    parts = []
    for first in range(0, len(xhat), runs.BATCH):
        estimates = xhat[first : first + runs.BATCH]
        numbers = np.arange(*seeds)[first : first + len(estimates)]
        parts.append(compute_metrics(p, np.stack([run.x for run in runs.runs(p, root_seed, numbers)]), estimates))
        progress.step(len(estimates))
    return {name: np.concatenate([part[name] for part in parts], -1) for name in parts[0]}


def compute_metrics(p: Plan, x: Floats, xhat: Floats) -> dict[str, Floats]:
    """Return every metric of runs by name, [s, runs]: x [runs, N+1, n + s] and xhat [runs, N, s] at ticks 0 .. N-1."""
    n, tail, dt = p.cell.times.ticks, p.cell.times.tail, p.cell.scenario.dt
    n_signals = xhat.shape[-1]
    e = x[:, :n, :n_signals] - xhat
    if plant_errors := p.layout.plant.errors:
        problem = jax.tree.map(jnp.asarray, p.problem)

        def errors(k: Array, x: Array, xhat: Array) -> Array:
            return plant_errors(problem.params, present(problem, k, False), x, xhat)

        each_tick = jax.vmap(jax.vmap(errors), (None, 0, 0))
        e = np.concatenate([e, each_tick(jnp.arange(n), jnp.asarray(x[:, :n]), jnp.asarray(xhat))], -1)
    e = np.moveaxis(e, (0, 1, 2), (2, 0, 1))  # [N, s, runs]
    size = np.abs(e)
    with np.errstate(invalid="ignore", over="ignore"):
        windows = [slice(a, b) for a, b in np.asarray(p.problem.windows)]
        window_sums = [(size[w].sum(0), (e[w] * e[w]).sum(0), size[w].max(0, initial=0.0)) for w in windows]
        sums: Any = ErrorSums._make(np.stack(part) for part in zip(*window_sums, strict=True))
        settling: Any = _settling(size, p)
    digits.require_of(p, x[:, n - 1].T, sums.absolute[1:].sum(0) / (n - tail))
    falls = bool((p.problem.jumps < n).any())
    return metrics.finalize(sums, settling, e[-1], n, tail, dt, falls)  # type: ignore[arg-type]


def _settling(size: Floats, p: Plan) -> SettlingState:
    after: Any
    n_signals, ticks = size.shape[1], np.arange(len(size))[:, None, None]
    band, bound = (np.asarray(a)[:n_signals, None] for a in (p.problem.band, p.problem.bound))
    outside = size > band  # [N, s, runs]
    is_diverged: Any = np.logical_not((size <= bound).all(1))  # [N, runs]
    unsettled = np.where(outside, ticks + 1, 0).max(0)
    first = np.where(is_diverged.any(0), is_diverged.argmax(0), -1)
    jumps = np.asarray(p.problem.jumps)
    recovery = np.zeros(size.shape[1:])
    if len(jumps):
        ticks_since_jump = np.where(jumps <= ticks[:, 0], ticks[:, 0] - jumps, np.iinfo(int).max)
        since, after = ticks_since_jump.min(1), (jumps <= ticks[:, 0]).any(1)
        recovery = np.where(outside & after[:, None, None], since[:, None, None] + 1.0, 0.0).max(0)
    return SettlingState(unsettled.astype(float), recovery, first.astype(float))  # type: ignore[arg-type]


def read_estimates(file: str | Path) -> pd.DataFrame:
    """Return the table of a Parquet or CSV file; raise UserError if it cannot be read."""
    path = Path(file).expanduser()
    try:
        if path.suffix == ".csv":
            return pd.read_csv(path)
        return pd.read_parquet(path, partitioning=None)
    except (OSError, ValueError, pd.errors.ParserError) as error:
        raise UserError(
            f"{short(str(file))}: cannot be read ({short(str(error).splitlines()[0])}), expected a Parquet file, or a .csv; "
            "give one."
        ) from None


def sort_by_cell(
    table: pd.DataFrame, where: str, signals: list[str], only: tuple[str, int] | None
) -> dict[tuple[str, int], pd.DataFrame]:
    """Return the rows of each grid point, sorted by seed and tick; with `only` one grid point its columns may be omitted.

    Raises UserError for a column that is missing or not numeric.
    """
    if only:
        table = table.copy()
        table["scenario"] = table.get("scenario", only[0])
        table["cell"] = table.get("cell", only[1])
    for name in KEYS:
        if name not in table:
            if not len(table.columns):
                raise UserError(f"{where}: got no columns, expected {', '.join(KEYS)} and the signals; write them.")
            raise unknown(where, "column of it", name, table.columns.astype(str))
    if not set(signals) & set(table.columns):
        raise UserError(
            f"{where}: got the columns {short(', '.join(map(str, table.columns)))}, expected one for each signal, "
            f"{', '.join(signals)}; write the estimates under these names."
        )
    for name in [*KEYS[1:], *(s for s in signals if s in table)]:
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise UserError(f"{where}: column {name} got {table[name].dtype}, expected numbers; write them as such.")
    groups = table.sort_values(list(KEYS), kind="stable").groupby(["scenario", "cell"], sort=False)
    return {(str(rows["scenario"].iloc[0]), int(rows["cell"].iloc[0])): rows for _, rows in groups}


def estimates_of(
    rows: pd.DataFrame | None, where: str, signals: list[str], seeds: NDArray[np.int64], ticks: int
) -> Floats:
    """Return the estimates of a grid point's runs, [seeds, ticks, signals]; raise UserError for missing runs or ticks.

    All unknown inputs or parameters of a plant may be omitted: they are the last signals.
    """
    if rows is None:
        raise UserError(f"{where}: got no rows, expected {len(seeds)} runs of {ticks:,} ticks; estimate them all.")
    rows = rows[rows.tick < ticks]
    names = [s for s in signals if s in rows]
    if names != signals[: len(names)]:
        absent = next(s for s in signals if s not in names)
        raise UserError(f"{where}: got no column '{absent}', expected every state; write it.")
    counts = rows.groupby("seed").tick.agg(["size", "nunique", "min", "max"]).reindex(seeds)
    missing = counts.index[counts["size"].isna()]
    if len(missing):
        raise UserError(
            f"{where}: got {len(seeds) - len(missing)} of {len(seeds)} runs (seed {missing[0]} is missing), expected all; "
            "estimate them too: differences are paired run by run."
        )
    wrong = counts[(counts["size"] != ticks) | (counts["nunique"] != ticks) | (counts["min"] != 0)]
    if len(wrong):
        raise UserError(
            f"{where}: got {int(wrong['size'].iloc[0]):,} ticks of seed {wrong.index[0]}, expected each of 0 .. {ticks - 1:,} "
            "once; leave a row for every tick."
        )
    xhat: Floats = rows[rows.seed.isin(seeds)][names].to_numpy(float).reshape(len(seeds), ticks, len(names))
    return xhat
