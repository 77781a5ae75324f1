"""Runs on an accelerator: run-ticks a second in float64 for calls of growing width, and the same numbers as on the CPU.

    python benchmarks/accelerator.py [--small] [--json]

One run-tick is one run advanced by one tick, for plant, observers and metrics, from the runs' random numbers to what the
tables are made of. Every row is a program of the engine, unchanged, on the first device that jax has. Before a row is timed,
its first 64 runs are compared with those of a program on the CPU: the largest difference of MAE, RMSE and peak, divided by
the largest value of that metric. If one exceeds 1e-11, the program ends with exit code 1.

A call's time includes the transfer of its arguments and results. Best of three calls, after one that is not timed.
Without an accelerator the first device is the CPU, so the script can be tried anywhere.
"""

import argparse
import json
import sys
from time import perf_counter
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from pcbench import planning
from pcbench.engine import runner
from pcbench.runtime import config
from pcbench.simulation.types import RunSums
from pcbench.study import parse

HELICOPTER = {"base": "helicopter/constant", "duration": 2.0, "steady_start": 1.0}  # [s]
CASES: dict[str, dict[str, Any]] = {
    "cart, pccebo and kfbo": {"scenario": {"base": "cart/white"}, "observers": ["pccebo", "kfbo"]},
    "reactor, ekf": {"scenario": {"base": "reactor/batch"}, "observers": ["ekf"]},
    "helicopter, high-gain": {"scenario": HELICOPTER, "observers": ["high-gain"]},
    "helicopter, ekf": {"scenario": HELICOPTER, "observers": ["ekf"]},
}
WIDTHS = [2**10, 2**14, 2**17, 2**20]  # runs in a call
COMPARED = 64  # runs
TOLERANCE = 1e-11
CALLS = 3
PATIENCE = 5.0  # [s]: a case whose call takes longer gets no wider one


def metrics_of(outcome: RunSums) -> dict[str, np.ndarray]:
    """Return sum of |e|, root of the sum of e^2 and peak of each observer, [3, signals, runs]."""
    return {
        label: np.stack([s.absolute.sum(0), np.sqrt(s.square.sum(0)), s.peak.max(0)])
        for label, s in outcome.streams.items()
    }


def difference(got: RunSums, expected: RunSums) -> float:
    """Return the largest difference of a metric over the largest value of that metric and signal; NaN if any is NaN."""
    mine, theirs = metrics_of(got), metrics_of(expected)
    apart = np.concatenate([np.abs(mine[o] - theirs[o]).max(-1) for o in theirs], -1)
    size = np.concatenate([np.abs(theirs[o]).max(-1) for o in theirs], -1)
    with np.errstate(divide="ignore"):
        return float(np.divide(apart, size, out=np.zeros_like(apart), where=apart != 0).max())


def rows_of(what: str, case: dict[str, Any], widths: list[int]) -> list[dict[str, Any]]:
    """Return a row for each width: run-ticks a second, seconds of compiling, memory, difference to the CPU."""
    given = {"name": "accelerator", "seeds": COMPARED} | case
    (p,) = planning.plan(parse.grid_of(given, {}, []).study)
    ticks, device = p.cell.times.ticks, jax.devices()[0]
    cpu = runner.program(
        p.layout._replace(width=COMPARED), job := runner.Job(p.problem, 0, np.arange(COMPARED)), _cpu()
    )
    ((_, expected),) = runner.serial(cpu, [job])
    rows = []
    for width in widths:
        job = runner.Job(p.problem, 0, np.arange(width))
        made = runner.program(p.layout._replace(width=width), job, device)
        ((_, got),) = runner.serial(made, [job])
        found = difference(jax.tree.map(lambda a: a[..., :COMPARED], got), expected)
        seconds = []
        for i in range(CALLS):
            start = perf_counter()
            list(runner.serial(made, [job._replace(seeds=np.arange(width) + (i + 1) * width)]))
            seconds.append(perf_counter() - start)
        rows.append(
            {
                "what": what,
                "device": device.device_kind,
                "runs": width,
                "ticks": ticks,
                "rate": width * ticks / min(seconds) / 1e6,
                "microseconds_per_tick": min(seconds) / ticks * 1e6,
                "compile_seconds": made.compile_seconds,
                "memory_MiB": made.memory / 2**20,
                "difference": found,
            }
        )
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        if min(seconds) > PATIENCE:
            break
    return rows


def _cpu() -> jax.Device:
    return jax.devices("cpu")[0]


COLUMNS = {  # key: head and format
    "what": ("what", "{}"),
    "runs": ("runs", "{:,}"),
    "ticks": ("ticks", "{:,}"),
    "rate": ("run-ticks [M/s]", "{:,.3g}"),
    "microseconds_per_tick": ("a tick [us]", "{:,.3g}"),
    "compile_seconds": ("compile [s]", "{:.1f}"),
    "memory_MiB": ("memory [MiB]", "{:,.0f}"),
    "difference": ("to CPU", "{:.1e}"),
}


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    table = Table(title=f"{rows[0]['device']}, float64")
    for key, (head, _) in COLUMNS.items():
        table.add_column(head, justify="left" if key == "what" else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(shape.format(row[key]) for key, (_, shape) in COLUMNS.items()))
    Console(width=150).print(table)


def main() -> None:
    """Parse, compare, time, print."""
    parser = argparse.ArgumentParser(description="Run-ticks a second on an accelerator, compared with the CPU.")
    parser.add_argument("--small", action="store_true", help="one narrow call of each case")
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    options = parser.parse_args()
    config.setup()
    rows = [r for what, case in CASES.items() for r in rows_of(what, case, [COMPARED] if options.small else WIDTHS)]
    if options.json:
        print(json.dumps({"unit": "million run-ticks a second", "rows": rows}, indent=2))
    else:
        show(rows)
    for row in rows:
        if not row["difference"] <= TOLERANCE:
            raise SystemExit(
                f"accelerator: {row['what']}, {row['runs']} runs: got metrics {row['difference']:.1e} off the CPU's, "
                f"expected {TOLERANCE:g} at most."
            )


if __name__ == "__main__":
    main()
