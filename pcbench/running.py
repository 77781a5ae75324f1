"""Running a study whose every option is known: its blocks, its closing tables, and what it took."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter

from pcbench import machine
from pcbench.dataset import campaign, closing, executors, folder, ledger, store, until
from pcbench.errors import UserError
from pcbench.result import Result
from pcbench.study import Study

Tell = Callable[[str, float], None]
Say = Callable[[str], None]


def silent(event: str, value: float) -> None:
    """Hear of progress and do nothing."""


def execute(
    study: Study,
    *,
    out: str | Path | None = None,
    fresh: bool = False,
    until_se: str | None = None,
    max_seeds: int | None = None,
    devices: int | None = None,
    dask: str | None = None,
    workers: int | None = None,
    block: int | None = None,
    memory: str | int | None = None,
    tell: Tell = silent,
    say: Say = lambda sentence: None,
) -> Result:
    """Run a study and return its tables; the arguments and errors are those of `bench.run`."""
    goal = check(until_se, max_seeds, devices, dask, workers, block, memory)
    with machine.float64(), ExitStack() as stack:
        start, began = perf_counter(), datetime.now(UTC)
        keep = tempfile.TemporaryDirectory(prefix="pcbench-") if out is None else None
        place = store.target(keep.name if keep else str(out))
        claimed = folder.claim(place, study, fresh)
        until.check(goal, claimed)
        choice = campaign.Options(positive(block, "--block"), executors.share(memory, dask, workers, devices))
        made = (
            executors.dask(dask, positive(workers, "--workers"))
            if dask
            else executors.here(positive(devices, "devices"))
        )
        execute = stack.enter_context(made)
        there = [] if claimed.fresh else campaign.whole(place, claimed, say)
        effort = campaign.fill(place, claimed, there, execute, campaign.everything(claimed, there), choice, tell)
        for wanted in until.rounds(goal, place, claimed, say):
            there = ledger.settled(ledger.present(place))
            effort = campaign.added(effort, campaign.fill(place, claimed, there, execute, wanted, choice, tell))
        there = ledger.settled(ledger.present(place))
        if effort.runs or not closing.is_closed(place, there):
            tell("closing", 0.0)
            about = {
                "started": began.isoformat(timespec="seconds"),
                "wall_seconds": round(perf_counter() - start, 3),
                "compile_seconds": round(effort.compile_seconds, 3),
                "writing_seconds": round(effort.writing_seconds, 3),
                "runs_added": effort.runs,
                "until_se": until_se,
            }
            closing.close(place, claimed, there, about)
    where: str | Path | None = out
    if out is not None and place.local:
        where = Path(place.root if "://" in str(out) else out)
    return Result(study, place, where, effort, keep)


def check(
    until_se: str | None = None,
    max_seeds: int | None = None,
    devices: int | None = None,
    dask: str | None = None,
    workers: int | None = None,
    block: int | None = None,
    memory: str | int | None = None,
) -> until.Goal | None:
    """Return the standard error to be reached; raise UserError for an argument of `execute` that is none, before any work."""
    positive(block, "--block")
    positive(workers, "--workers")
    positive(devices, "devices")
    executors.share(memory, dask, workers, devices)
    return until.parse(until_se, max_seeds)


def positive(count: int | None, where: str) -> int | None:
    """Return a count that was given; raise UserError where it is none."""
    if count is not None and count < 1:
        raise UserError(f"{where}: got {count}, expected 1 or more; leave it out.")
    return count
