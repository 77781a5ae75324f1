"""Lane-ticks a second: pcbench beside a NumPy loop, NumPy over runs and numba, all in one process.

    python benchmarks/throughput.py [--quick] [--json]

One lane-tick is one run of cart/white advanced by one tick: plant, pccebo and kfbo, and MAE, RMSE and peak of both states
of both observers, in float64. Before anything is timed, the metrics of every row are compared with pcbench's for the same
draws, with the fixed and with a random start; a difference above 1e-9 ends the program with exit code 1.

Timing: rows take turns, so that the machine's drift meets all alike; best and median of the turns. A row on one core has
every thread of the process held to that core, another one each turn, where the system can; a row on all has none held.
A turn of pcbench is what a user gets: jobs stacked, sent, simulated and read. Noise is drawn inside the time.
Not claimed: that the baselines could not be faster; only that they are what a person would write.
"""

import argparse
import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import perf_counter, sleep
from typing import Any, NamedTuple

import jax
import numba
import numpy as np
from baselines import Array, Case, one_run, over_runs, prepare, runs_alone
from rich.console import Console
from rich.table import Table

from pcbench import bench, draws, ensemble, machine, study, sweep
from pcbench.rollout import Layout, Outcome, Problem

SCENARIO, OBSERVERS = "cart/white", ["pccebo", "kfbo"]
TOLERANCE = 1e-9
JOBS = 3  # a device and turn: the next call is prepared while the last one runs, as in a study
KINDS = {  # watch, random start
    "pcbench, streams": (False, False),
    "pcbench, streams, random start": (False, True),
    "pcbench, full product": (True, False),
    "pcbench, full product, random start": (True, True),
}
CAPTION = """\
Every row: plant, pccebo and kfbo one tick on; MAE, RMSE and peak of both states streamed; float64; same numbers to 1e-9.
NumPy and numba simulate the plant in every lane. With the fixed start and no process noise the plant is the same in all
lanes, and pcbench computes it once: like for like are its random-start rows, where the plant differs from lane to lane.
(b) and (c) have what depends on the input alone prepared beforehand; the full product adds settling time and divergence.
Ratios are of the best."""


class Row(NamedTuple):
    """One way to do it."""

    what: str
    cores: int
    lanes: int  # side by side
    runs: int  # in a turn
    work: Callable[[], Any]  # one turn
    compile_seconds: float | None


def hold(cores: list[int]) -> None:
    """Hold every thread of this process to these cores, where the system can; threads made later inherit it."""
    threads = Path("/proc/self/task")
    if hasattr(os, "sched_setaffinity"):
        for thread in [int(p.name) for p in threads.iterdir()] if threads.exists() else [0]:
            with suppress(ProcessLookupError):  # a thread that has just ended
                os.sched_setaffinity(thread, cores)


def take_turns(rows: list[Row], turns: int, ticks: int) -> list[Array]:
    """Return each row's lane-ticks a second in every turn."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    rates = np.zeros((len(rows), turns))
    for turn in range(turns):
        for i, row in enumerate(rows):
            hold(cores if row.cores > 1 else [cores[turn % len(cores)]])
            sleep(0.02)  # threads that still spin after the row before go to sleep
            start = perf_counter()
            row.work()
            rates[i, turn] = row.runs * ticks / (perf_counter() - start)
    hold(cores)
    return list(rates)


def sums_of(outcome: Outcome) -> Array:
    """Return what the baselines return, [3, 4, L], from the windows of pcbench's streams."""
    each = [outcome.streams[o] for o in OBSERVERS]
    return np.concatenate([np.stack([s.absolute.sum(0), s.square.sum(0), s.peak.max(0)]) for s in each], 1)


def agree(what: str, got: Array, expected: Array, ticks: int) -> None:
    """Exit with a sentence where MAE, RMSE or peak differ by more than TOLERANCE."""
    mine, theirs = (np.stack([s[0] / ticks, np.sqrt(s[1] / ticks), s[2]]) for s in (got, expected))
    worst = np.abs(mine - theirs).max()
    if not worst <= TOLERANCE:
        raise SystemExit(f"throughput: {what}: got metrics {worst:.1e} off pcbench's, expected {TOLERANCE:g} at most.")


def pcbench_rows(layout: Layout, problem: Problem, kinds: list[str], ticks: int) -> tuple[list[Row], dict[bool, Array]]:
    """Return pcbench's rows, and its sums for seeds 0 .. L-1 by random start."""
    rows, sums, width = [], {}, layout.width
    for kind in kinds:
        watch, random = KINDS[kind]
        for devices in dict.fromkeys((1, len(jax.devices()))):
            jobs = [ensemble.Job(problem, 0, np.arange(width) + i * width) for i in range(JOBS * devices)]
            made = ensemble.program(layout._replace(watch=watch, random_start=random), jobs[0], devices)
            got = sums_of(next(ensemble.run(made, jobs[:1]))[1])
            agree(kind, got, sums.setdefault(random, got), ticks)
            work = lambda made=made, jobs=jobs: [None for _ in ensemble.run(made, jobs)]  # noqa: E731
            rows.append(Row(kind, devices, width * devices, width * len(jobs), work, made.compile_seconds))
    return rows, sums


def check_baselines(case: Case, problem: Problem, sums: dict[bool, Array]) -> None:
    """Exit unless every baseline finds pcbench's metrics in pcbench's draws."""
    ticks, lanes = len(case.u), sums[False].shape[-1]
    seeds, samples = np.arange(lanes), -(-ticks // case.period)
    noise = np.asarray(jax.jit(jax.vmap(lambda seed: draws.measurement_noise(0, seed, samples)[0], 0, 1))(seeds))
    normal = np.asarray(draws.normals(draws.run_keys(np.asarray(0), seeds, "initial", 2), np.zeros(2, int)))
    for random, expected in sums.items():
        x0 = problem.xhat0[:, None] + problem.spread0 @ normal if random else np.tile(problem.x0[:, None], lanes)
        agree("a loop per run", one_run(case, x0[:, 0], noise[:, 0])[..., None], expected[..., :1], ticks)
        agree("NumPy over runs", over_runs(case, x0, noise), expected, ticks)
        agree("numba", runs_alone(case, x0, noise), expected, ticks)


def baseline_rows(case: Case, problem: Problem, width: int) -> list[Row]:
    """Return the baselines' rows."""
    samples, rng = -(-len(case.u) // case.period), np.random.default_rng(0)

    def given(lanes: int) -> tuple[Case, Array, Array]:
        return case, np.tile(problem.x0[:, None], lanes), rng.standard_normal((samples, lanes))

    def compiled(threads: int) -> None:
        numba.set_num_threads(threads)
        runs_alone(*given(threads * width))

    start = perf_counter()
    runs_alone(*given(1))
    compile_seconds = perf_counter() - start
    every = dict.fromkeys((1, numba.config.NUMBA_NUM_THREADS))
    return [
        Row(
            "(a) NumPy, a loop per run", 1, 1, 1, lambda: one_run(case, problem.x0, rng.standard_normal(samples)), None
        ),
        Row("(b) NumPy over runs", 1, width, width, lambda: over_runs(*given(width)), None),
        *(
            Row("(c) numba, a loop per run", n, n * width, n * width, lambda n=n: compiled(n), compile_seconds)
            for n in every
        ),
    ]


def report(rows: list[Row], rates: list[Array], ticks: int) -> list[dict[str, Any]]:
    """Return the table's rows as data; rates in millions of lane-ticks a second."""
    best = [float(r.max()) / 1e6 for r in rates]
    return [
        {
            "what": row.what,
            "cores": row.cores,
            "lanes": row.lanes,
            "ticks": ticks,
            "best": best[i],
            "median": float(np.median(rates[i])) / 1e6,
            "ratio_a": best[i] / best[0],
            "ratio_b": best[i] / best[1],
            "compile_seconds": row.compile_seconds,
        }
        for i, row in enumerate(rows)
    ]


def show(found: list[dict[str, Any]], console: Console) -> None:
    """Print the one table."""
    table = Table(title=f"{SCENARIO}: lane-ticks a second", caption=CAPTION, caption_justify="left")
    table.add_column("what")
    for head in (
        "cores",
        "lanes",
        "ticks",
        "best [M/s]",
        "median [M/s]",
        "ratio to (a)",
        "ratio to (b)",
        "compile [s]",
    ):
        table.add_column(head, justify="right")
    for row in found:
        made = row["compile_seconds"]
        numbers = [f"{row[key]:,}" for key in ("cores", "lanes", "ticks")]
        speeds = [f"{row['best']:.4g}", f"{row['median']:.4g}", f"{row['ratio_a']:,.0f}", f"{row['ratio_b']:.3g}"]
        table.add_row(row["what"], *numbers, *speeds, "" if made is None else f"{made:.1f}")
    console.print(table)


def main() -> None:
    """Parse, check, time, print."""
    parser = argparse.ArgumentParser(description="Lane-ticks a second of pcbench, NumPy and numba on cart/white.")
    parser.add_argument("--quick", action="store_true", help="few ticks, one turn, streams on one device only")
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    options = parser.parse_args()
    machine.setup()
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_compilation_cache", False)  # compile seconds are to be those of compiling
    (planned,) = sweep.plan(bench.study_of(study.load(SCENARIO, []), {"observers": OBSERVERS}, []))
    ticks = 2000 if options.quick else sweep.ticks(planned.cell)
    problem = planned.problem._replace(windows=np.array([[0, ticks // 3], [ticks // 3, ticks - 1], [ticks - 1, ticks]]))
    case = prepare(problem, ticks)
    rows, sums = pcbench_rows(planned.layout, problem, list(KINDS)[: 1 if options.quick else None], ticks)
    others = baseline_rows(case, problem, planned.layout.width)
    check_baselines(case, problem, sums)
    rows = others + rows
    found = report(rows, take_turns(rows, 1 if options.quick else 5, ticks), ticks)
    if options.json:
        print(json.dumps({"scenario": SCENARIO, "unit": "million lane-ticks a second", "rows": found}, indent=2))
    else:
        show(found, Console(width=150))


if __name__ == "__main__":
    main()
