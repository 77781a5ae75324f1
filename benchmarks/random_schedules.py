"""What a schedule of its own for every run costs, beside one schedule for all runs, in one process.

    python benchmarks/random_schedules.py [--quick] [--json]

The same observers on the same scenario, 1024 runs a device: once on a schedule that all share, then with jitter, loss, both,
random intervals, and delays that let samples overtake. Rows take turns (see `turns`); a turn is what a user gets: jobs stacked,
sent, simulated and read, draws and sorting of the events included. The ratio is of the best turns, within a scenario.
With overtaking an observer keeps as many samples as may be overtaken and runs again from there: that row does other work.
"""

import argparse
import json
import sys
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table
from turns import Row, take

from pcbench import ensemble, machine, planning, study_file

JOBS = 3  # a device and turn
SETS = {
    "cart/white": ["pccebo", "kfbo"],
    "cart/gaussian-fast": ["pccebo", "pi-pco", "dkf"],
    "cart/variable": ["pco", "pi-pco", "pccebo", "dkf"],
}
RANDOM: dict[str, dict[str, Any]] = {
    "one schedule for all": {},
    "jitter 0.04 s": {"jitter": 0.04},
    "loss 20 %": {"loss": 0.2},
    "jitter and loss": {"jitter": 0.04, "loss": 0.2},
    "random intervals": {"profile": "uniform"},
    "overtaking": {"delay_jitter": 0.3},
}


def row_of(scenario: str, observers: list[str], what: str, axes: dict[str, Any]) -> Row:
    """Return one way to sample as a row to be timed, compiled and warm."""
    raw = {"name": "cost", "scenarios": [scenario], "observers": observers, "axes": {k: [v] for k, v in axes.items()}}
    (planned,) = planning.plan(study_file.parse(raw, "cost"))
    devices, width = ensemble.cores(), planned.layout.width
    jobs = [ensemble.Job(planned.problem, 0, np.arange(width) + i * width) for i in range(JOBS * devices)]
    made = ensemble.program(planned.layout, jobs[0])

    def work() -> None:
        for _ in ensemble.run(planned.layout, jobs, devices):
            pass

    work()
    return Row(
        f"{scenario} ({', '.join(observers)}): {what}",
        devices,
        width * devices,
        width * len(jobs),
        work,
        made.compile_seconds,
    )


def main() -> None:
    """Parse, time, print."""
    parser = argparse.ArgumentParser(description="Random schedules beside a shared one: cost in one process.")
    parser.add_argument("--quick", action="store_true", help="the first scenario, one turn")
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    options = parser.parse_args()
    machine.setup()
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_compilation_cache", False)
    found = []
    for scenario in list(SETS)[: 1 if options.quick else None]:
        kinds = {w: a for w, a in RANDOM.items() if w != "overtaking" or "kfbo" not in SETS[scenario]}
        rows = [row_of(scenario, SETS[scenario], what, axes) for what, axes in kinds.items()]
        timed = take(rows, 1 if options.quick else 5)
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
        cells = (
            f"{r['tick_us']:.1f}",
            f"{r['ratio']:.2f}",
            f"{r['ratio_of_medians']:.2f}",
            f"{r['compile_seconds']:.1f}",
        )
        table.add_row(r["what"], *cells)
    (Console() if sys.stdout.isatty() else Console(width=150)).print(table)


if __name__ == "__main__":
    main()
