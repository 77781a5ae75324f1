"""Run a study with all options resolved: its blocks, its closing tables, and the time and memory it took."""

import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import NamedTuple

from pcbench.dataset import (
    adaptive_seeds,
    block_files,
    close,
    executors,
    manifest,
    moments_tables,
    run_missing,
    storage,
)
from pcbench.dataset.result import Result
from pcbench.dataset.timing import Cost, add_costs
from pcbench.errors import UserError
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.grid import Grid

OnWarning = Callable[[str], None]


class RunOptions(NamedTuple):
    """Settings of a run. Of these only the number of runs changes a result. See `pcbench.run`."""

    overwrite: bool = False
    until_se: str | None = None
    max_seeds: int | None = None
    devices: int | None = None
    dask: str | None = None
    workers: int | None = None
    block_size: int | None = None
    memory: str | int | None = None
    progress: Progress = SILENT
    on_warning: OnWarning = lambda sentence: None
    min_seeds: Mapping[str, int] = MappingProxyType({})  # of cells, by digest

    def checked(self) -> "RunOptions":
        """Return the settings; raise UserError for an invalid value, before the computation starts."""
        for count, where in ((self.block_size, "--block-size"), (self.workers, "--workers"), (self.devices, "devices")):
            if count is not None and count < 1:
                raise UserError(f"{where}: got {count}, expected 1 or more; leave it out.")
        executors.task_memory(self.memory, self.dask, self.workers, self.devices)
        adaptive_seeds.parse(self.until_se, self.max_seeds)
        return self


def execute(grid: Grid, out: str | Path | None = None, options: RunOptions | None = None) -> Result:
    """Run a study and return its tables; with `out`, store them in that folder or URI. Raises as `pcbench.run`."""
    options = (options or RunOptions()).checked()
    goal, on_warning, progress = (
        adaptive_seeds.parse(options.until_se, options.max_seeds),
        options.on_warning,
        options.progress,
    )
    with config.float64(), ExitStack() as stack:
        start, start_time = perf_counter(), datetime.now(UTC)
        tempdir = tempfile.TemporaryDirectory(prefix="pcbench-") if out is None else None
        target = storage.target(tempdir.name if tempdir else str(out))
        claim = manifest.claim(target, grid, options.overwrite)
        adaptive_seeds.check(goal, claim)
        sizes = run_missing.Sizes(
            options.block_size, executors.task_memory(options.memory, options.dask, options.workers, options.devices)
        )
        run_tasks = stack.enter_context(
            executors.dask(options.dask, options.workers) if options.dask else executors.local_executor(options.devices)
        )
        blocks = [] if claim.overwrite else run_missing.valid_blocks(target, claim, on_warning)
        cost, exact_start = Cost(), perf_counter()
        if grid.study.evaluation != "runs" and moments_tables.make(target, claim, on_warning, progress):
            claim, blocks = claim._replace(overwrite=False), block_files.drop_overlaps(block_files.present(target))
            cost = Cost(exact_seconds=perf_counter() - exact_start)
        simulations = moments_tables.select_simulations(target, claim)
        seeds_of = run_missing.required_seeds(simulations, blocks, options.min_seeds)
        more = run_missing.run_blocks(target, simulations, blocks, run_tasks, seeds_of, sizes, progress, on_warning)
        cost = add_costs(cost, more)
        for seeds_of in adaptive_seeds.rounds(goal, target, simulations, on_warning):
            blocks = block_files.drop_overlaps(block_files.present(target))
            more = run_missing.run_blocks(target, simulations, blocks, run_tasks, seeds_of, sizes, progress, on_warning)
            cost = add_costs(cost, more)
        blocks = block_files.drop_overlaps(block_files.present(target))
        if cost.runs or not close.is_closed(target, blocks):
            progress.note("statistics")
            closing_start = perf_counter()
            tables = close.closing_tables(target, claim, blocks)
            seconds = {"wall_seconds": perf_counter() - start, "compile_seconds": cost.compile_seconds}
            seconds |= {name: getattr(cost, name) for name in cost._fields[2:]}
            seconds["closing_seconds"] = perf_counter() - closing_start
            started = start_time.isoformat(timespec="seconds")
            about = {"started": started, "runs_added": cost.runs, "until_se": options.until_se}
            about |= {name: round(value, 3) for name, value in seconds.items()}
            close.close(target, claim, tables, about)
    where: str | Path | None = out
    if out is not None and target.local:
        where = Path(target.root if "://" in str(out) else out)
    return Result(claim.study, target, where, cost, tempdir)
