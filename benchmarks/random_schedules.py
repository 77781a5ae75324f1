"""What a schedule of its own for every run costs, beside one schedule for all runs, in one process.

    python benchmarks/random_schedules.py [--small] [--json]

The same observers on the same scenario, 1024 runs a device: once on a schedule that all share, then with jitter, loss, both,
random intervals, and out-of-sequence samples. Rows take turns (see `turns`); a turn is what a user gets: jobs stacked,
sent, simulated and read, draws and sorting of the events included. The ratio is of the best turns, within a scenario.
Before it is timed, every row is checked: its runs end with finite errors, and are not those of one schedule for all.
With --small 32 runs of every row go on for two seconds of their scenario, one turn: its figures mean nothing then.
With out-of-sequence samples an observer stores the newest ones and uses them again: that row does other work.
"""

import argparse
import json
import sys
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.console import Console
from rich.table import Table
from turns import Row, take

from pcbench import planning
from pcbench.engine import runner
from pcbench.planning import padding
from pcbench.runtime import config
from pcbench.study import grid, parse

JOBS = 3  # a device and turn
FEW = 32  # lanes with --small
ONE = {"cart/white": "kfbo", "cart/variable": "pco"}  # observers with --small
SETS = {
    "cart/white": ["pccebo", "kfbo"],
    "cart/gaussian-fast": ["pccebo", "pi-pco", "kf"],
    "cart/variable": ["pco", "pi-pco", "pccebo", "kf"],
}
RANDOM: dict[str, dict[str, Any]] = {
    "one schedule for all": {},
    "jitter 0.04 s": {"sampling_jitter": 0.04},
    "loss 20 %": {"loss": 0.2},
    "jitter and loss": {"sampling_jitter": 0.04, "loss": 0.2},
    "random intervals": {"sampling_pattern": "uniform"},
    "out of sequence": {"delay_jitter": 0.3},
}


class Made(NamedTuple):
    """A row to be timed, compiled and warm, and the last errors of its first runs."""

    row: Row
    errors: np.ndarray


def planned(scenario: str, observers: list[str], axes: dict[str, Any], small: bool) -> padding.Plan:
    """Return a cell of one way to sample, laid out."""
    raw = {"name": "cost", "scenarios": [scenario], "observers": observers, "axes": {k: [v] for k, v in axes.items()}}
    study = parse.parse(raw, "cost")
    (cell,) = grid.cells_of(study)
    if not small:
        return next(planning.drafts([cell]))
    cell = cell.with_fields(duration=2.0, steady_start=1.0)
    draft = next(planning.drafts([cell]))
    return draft._replace(layout=draft.layout._replace(width=FEW))


def rows_of(scenario: str, observers: list[str], small: bool) -> list[Made]:
    """Return every way to sample a scenario as a row; those that can share a program do, as in a study."""
    kinds = {what: axes for what, axes in RANDOM.items() if what != "out of sequence" or "kfbo" not in observers}
    each = padding.fit([planned(scenario, observers, axes, small) for axes in kinds.values()])
    return [_made(f"{scenario} ({', '.join(observers)}): {what}", p) for what, p in zip(kinds, each, strict=True)]


def _made(what: str, p: padding.Plan) -> Made:
    devices, width = runner.cores(), p.layout.width
    jobs = [runner.Job(p.problem, 0, np.arange(width) + i * width) for i in range(JOBS * devices)]
    made = runner.program(p.layout, jobs[0])

    def work() -> list[Any]:
        return list(runner.run(p.layout, jobs, devices))

    errors = np.concatenate(list(work()[0][1].final.values()))
    return Made(Row(what, devices, width * devices, width * len(jobs), work, made.compile_seconds), errors)


def check(made: list[Made]) -> None:
    """Exit with a sentence where a row's runs are not finite, or are those of one schedule for all."""
    for i, (row, errors) in enumerate(made):
        if not np.isfinite(errors).all():
            raise SystemExit(f"random_schedules: {row.what}: got errors that are not finite, expected runs that end.")
        if i and np.array_equal(errors, made[0].errors):
            raise SystemExit(f"random_schedules: {row.what}: got the runs of one schedule for all, expected others.")


def main() -> None:
    """Parse, check, time, print."""
    parser = argparse.ArgumentParser(description="Random schedules beside a shared one: cost in one process.")
    parser.add_argument(
        "--small", action="store_true", help="few runs, two seconds of each scenario; every row and check"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    options = parser.parse_args()
    config.setup()
    jax.config.update("jax_platforms", "cpu")
    if not options.small:
        jax.config.update("jax_enable_compilation_cache", False)
    found = []
    for scenario, observers in ({s: [o] for s, o in ONE.items()} if options.small else SETS).items():
        made = rows_of(scenario, observers, options.small)
        check(made)
        rows = [row for row, _ in made]
        timed = take(rows, 1 if options.small else 5)
        best, median = timed.wall.min(1), np.median(timed.wall, 1)
        for i, row in enumerate(rows):
            microseconds = 1e6 * best[i] / JOBS / 10_000
            ratios = {"ratio": best[i] / best[0], "ratio_of_medians": median[i] / median[0]}
            found.append({"what": row.what, "tick_us": microseconds, "compile_seconds": row.compile_seconds} | ratios)
    if options.json:
        print(json.dumps({"rows": found}, indent=2))
        return
    table = Table(title="Schedules of their own: cost of a tick of 1024 runs a device, all observers")
    for head in ("what", "tick [us]", "to one schedule", "medians", "compile [s]"):
        table.add_column(head, justify="left" if head == "what" else "right", no_wrap=head != "what")
    for r in found:
        cells_ = (
            f"{r['tick_us']:.1f}",
            f"{r['ratio']:.2f}",
            f"{r['ratio_of_medians']:.2f}",
            f"{r['compile_seconds']:.1f}",
        )
        table.add_row(r["what"], *cells_)
    (Console() if sys.stdout.isatty() else Console(width=150)).print(table)


if __name__ == "__main__":
    main()
