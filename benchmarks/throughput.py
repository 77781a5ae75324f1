"""Lane-ticks a second: pcbench beside a NumPy loop, NumPy over runs and numba, all in one process for a number of cores.

    python benchmarks/throughput.py [--small] [--json] [--cores N] [--history benchmarks/history.csv]

With --small it has few lanes, few ticks and one turn, with every row and every check: its figures mean nothing then.

One lane-tick is one run of cart/white advanced by one tick: plant, pccebo and kfbo, and MAE, RMSE and peak of both states
of both observers, in float64. Before anything is timed, the metrics of every row are compared with pcbench's for the same
draws; a difference above 1e-9 ends the program with exit code 1.

Timing: rows take turns (see `turns`); best and median of the turns. 'busy' is CPU time over wall time. Each number of cores
has a process of its own, whose runtime is given as many threads and no more (NPROC): one that waits does so by spinning, so
that with two a row on one core would be busy 2. All rows on one core are held to it.
Rows of other kinds (process noise, a schedule for each run, a closed loop, a nonlinear plant) stand beside the definition of a
run, `vmap` of `lax.scan`, which computes the same to 1e-9: an engine that is slower than it is none. Each has lane-ticks of
its own, so that of these rows only the ratio to the definition can be compared.
A turn of pcbench is what a user gets of a cell: jobs stacked, sent, simulated and read. All draw their noise inside the time.
With --history a table of ratios on one core gets a line, one a release: they are of one process, whatever the machine.
Not claimed: that the baselines could not be faster; only that they are what a person would write.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import numba
import numpy as np
from baselines import Array, Case, one_run, over_runs, prepare, runs_alone
from rich.console import Console
from rich.table import Table
from turns import Row, Timed, take

import pcbench
from pcbench import planning
from pcbench.engine import runner
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.runtime import config, provenance
from pcbench.simulation import rng
from pcbench.simulation.simulate_runs import simulate_runs
from pcbench.simulation.types import GridPointParams, Layout, RunSums
from pcbench.study import parse

SCENARIO, OBSERVERS = "cart/white", ["pccebo", "kfbo"]
TOLERANCE = 1e-9
FEW = 64  # lanes with --small
LANES = 256  # of other kinds
JOBS = 3  # a device and turn: the next call is prepared while the last one runs, as in a study
MINE = "(d) pcbench"
PLANT = {
    "A": [[0.0, 1.0], [-2.0, -3.0]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0]],
    "tick": 0.001,
    "sampling_period": 0.05,
    "delay": 0.1,
    "noise_std": 0.1,
    "process_std": [0.01, 0.05],
}
OTHERS: dict[str, dict[str, Any]] = {  # studies of one cell; each has a horizon of its own with --small
    "process noise": {"lti": PLANT, "observers": ["pccebo", "kf"]},
    "a schedule for each run": {"lti": PLANT | {"sampling_jitter": 0.02, "loss": 0.2}, "observers": ["kf"]},
    "closed loop": {
        "lti": PLANT,
        "observers": ["kf"],
        "controller": {"use": "lqr", "Q1": [1.0, 1.0], "Q2": [0.1]},
    },
    "nonlinear plant": {"scenario": {"base": "reactor/batch", "name": "batch"}, "observers": ["ekf"]},
}
DEFINITION, OURS = ", by the definition", ", pcbench"  # how their rows end
SHORT = {"process noise": 1.0, "a schedule for each run": 1.0, "closed loop": 1.0, "nonlinear plant": 100.0}  # [s]
CAPTION = (
    "Every row: plant, pccebo and kfbo one tick on; MAE, RMSE and peak of both states streamed; float64; same numbers to "
    "1e-9. All simulate the plant in every lane, which starts at random in pcbench's. (b) and (c) have what depends on the "
    "input alone prepared beforehand; pcbench adds settling time and divergence. Ratios are of the best of one process, a "
    "process for a number of cores; busy is CPU over wall time. To definition: of the row above, the same runs by vmap of "
    "lax.scan, on all cores that XLA takes."
)


def sums_of(outcome: RunSums) -> Array:
    """Return what the baselines return, [3, 4, L], from the windows of pcbench's streams."""
    each = [outcome.streams[o] for o in OBSERVERS]
    return np.concatenate([np.stack([s.absolute.sum(0), s.square.sum(0), s.peak.max(0)]) for s in each], 1)


def agree(what: str, got: Array, expected: Array, ticks: int) -> None:
    """Exit with a sentence where MAE, RMSE or peak differ by more than TOLERANCE."""
    mine, theirs = (np.stack([s[0] / ticks, np.sqrt(s[1] / ticks), s[2]]) for s in (got, expected))
    worst = np.abs(mine - theirs).max()
    if not worst <= TOLERANCE:
        raise SystemExit(f"throughput: {what}: got metrics {worst:.1e} off pcbench's, expected {TOLERANCE:g} at most.")


def pcbench_row(layout: Layout, problem: GridPointParams, cores: int) -> tuple[Row, Array]:
    """Return pcbench's row, and its sums for seeds 0 .. L-1."""
    width = layout.width
    jobs = [runner.Job(problem, 0, np.arange(width) + i * width) for i in range(JOBS * cores)]
    made = runner.program(layout, jobs[0])
    sums = sums_of(next(runner.serial(made, jobs[:1]))[1])
    work = partial(turn, layout, jobs, cores)
    return Row(MINE, cores, width * cores, width * len(jobs), work, made.compile_seconds), sums


def turn(layout: Layout, jobs: list[runner.Job], cores: int) -> None:
    """Simulate a cell's jobs."""
    for _ in runner.run(layout, jobs, cores):
        pass


def check_baselines(case: Case, problem: GridPointParams, sums: Array) -> None:
    """Exit unless every baseline finds pcbench's metrics in pcbench's draws."""
    ticks, lanes = len(case.u), sums.shape[-1]
    seeds, samples = np.arange(lanes), -(-ticks // case.period)
    noise = np.asarray(jax.jit(jax.vmap(lambda seed: rng.measurement_noise(0, seed, samples)[0], 0, 1))(seeds))
    normal = np.asarray(rng.normals(rng.run_keys(np.asarray(0), seeds, "initial", 2), np.zeros(2, int)))
    x0 = problem.x0[:, None] + problem.spread0 @ normal
    agree("a loop per run", one_run(case, x0[:, 0], noise[:, 0])[..., None], sums[..., :1], ticks)
    agree("NumPy over runs", over_runs(case, x0, noise), sums, ticks)
    agree("numba", runs_alone(case, x0, noise), sums, ticks)


def baseline_rows(case: Case, problem: GridPointParams, width: int, cores: int) -> list[Row]:
    """Return the baselines' rows, those of NumPy on one core."""
    samples, rng = -(-len(case.u) // case.period), np.random.default_rng(0)

    def given(lanes: int) -> tuple[Case, Array, Array]:
        return case, np.tile(problem.x0[:, None], lanes), rng.standard_normal((samples, lanes))

    def compiled() -> None:
        numba.set_num_threads(cores)
        runs_alone(*given(cores * width))

    start = perf_counter()
    runs_alone(*given(1))
    compile_seconds = perf_counter() - start
    return [
        Row(
            "(a) NumPy, a loop per run", 1, 1, 1, lambda: one_run(case, problem.x0, rng.standard_normal(samples)), None
        ),
        Row("(b) NumPy over runs", 1, width, width, lambda: over_runs(*given(width)), None),
        Row("(c) numba, a loop per run", cores, cores * width, cores * width, compiled, compile_seconds),
    ]


def other_rows(cores: int, small: bool) -> list[tuple[Row, int]]:
    """Return the definition's and pcbench's row of each other kind, with their ticks, after a check that they agree."""
    lanes, out = FEW if small else LANES, []
    for kind, given in OTHERS.items():
        table = "lti" if "lti" in given else "scenario"
        cut = {table: given[table] | {"duration": SHORT[kind], "steady_start": SHORT[kind] / 2}} if small else {}
        (p,) = planning.plan(parse.grid_of({"name": "kind", "seeds": lanes} | given | cut, {}, []).study)
        layout, seeds, ticks = p.layout._replace(width=lanes), np.arange(lanes), p.cell.times.ticks
        jobs = [runner.Job(p.problem, 0, seeds + i * lanes) for i in range(cores)]
        made, start = runner.program(layout, jobs[0]), perf_counter()
        defined = by_the_definition(p, lanes)
        expected = jax.tree.map(np.asarray, defined().streams)
        seconds = perf_counter() - start
        (got,) = (out.streams for _, out in runner.serial(made, jobs[:1]))
        for label in expected:
            agree(
                f"{kind}, {label}",
                *(np.stack([s.absolute.sum(0), s.square.sum(0), s.peak.max(0)]) for s in (got[label], expected[label])),
                ticks,
            )
        out.append((Row(f"{kind}{DEFINITION}", cores, lanes, lanes, defined, seconds), ticks))
        work = partial(turn, layout, jobs, cores)
        out.append((Row(f"{kind}{OURS}", cores, lanes * cores, lanes * cores, work, made.compile_seconds), ticks))
    return out


def by_the_definition(p: Plan, lanes: int) -> Callable[[], RunSums]:
    """Return what simulates runs 0 .. `lanes` - 1 of a cell by `simulate_runs`, each on its schedule if these are random."""
    schedules = None
    if p.cell.times.random:
        each = padding.fit([planning.alone(p, 0, seed) for seed in range(lanes)])
        p = each[0]._replace(layout=each[0].layout._replace(ring=max(one.layout.ring for one in each)))
        schedules = jax.tree.map(lambda *a: np.stack(a), *(one.problem.schedule for one in each))
    call, problem = jax.jit(simulate_runs, static_argnums=0), jax.tree.map(np.asarray, p.problem)
    return lambda: jax.block_until_ready(call(p.layout, problem, np.asarray(0), np.arange(lanes), schedules))


def report(rows: list[Row], timed: Timed, ticks: list[int]) -> list[dict[str, Any]]:
    """Return the table's rows as data; rates in millions of lane-ticks a second."""
    rates = np.array([row.runs * many / 1e6 for row, many in zip(rows, ticks, strict=True)])[:, None] / timed.wall
    of_the_cart = sum(not row.what.endswith((DEFINITION, OURS)) for row in rows)
    best, median, busy = rates.max(1), np.median(rates, 1), np.median(timed.cpu / timed.wall, 1)
    return [
        {
            "what": row.what,
            "cores": row.cores,
            "busy": float(busy[i]),
            "lanes": row.lanes,
            "ticks": ticks[i],
            "best": float(best[i]),
            "median": float(median[i]),
            "ratio_a": float(best[i] / best[0]) if i < of_the_cart else None,
            "ratio_b": float(best[i] / best[1]) if i < of_the_cart else None,
            "ratio_definition": float(best[i] / best[i - 1]) if row.what.endswith(OURS) else None,
            "compile_seconds": row.compile_seconds,
        }
        for i, row in enumerate(rows)
    ]


COLUMNS = {  # key: head and format
    "what": ("what", "{}"),
    "cores": ("cores", "{}"),
    "busy": ("busy", "{:.2f}"),
    "lanes": ("lanes", "{:,}"),
    "ticks": ("ticks", "{:,}"),
    "best": ("best [M/s]", "{:,.3g}"),
    "median": ("median [M/s]", "{:,.3g}"),
    "ratio_a": ("to (a)", "{:,.0f}"),
    "ratio_b": ("to (b)", "{:,.3g}"),
    "ratio_definition": ("to definition", "{:,.3g}"),
    "compile_seconds": ("compile [s]", "{:.1f}"),
}


def show(found: list[dict[str, Any]], console: Console) -> None:
    """Print the one table."""
    table = Table(title=f"{SCENARIO}: millions of lane-ticks a second", caption=CAPTION, caption_justify="left")
    for key, (head, _) in COLUMNS.items():
        table.add_column(head, justify="left" if key == "what" else "right", no_wrap=True)
    for row in found:
        table.add_row(*("" if row[key] is None else shape.format(row[key]) for key, (_, shape) in COLUMNS.items()))
    console.print(table)


def remember(found: list[dict[str, Any]], path: Path) -> None:
    """Add a line with pcbench's rate on one core over those of numba and of NumPy over runs."""
    alone = {row["what"]: row["best"] for row in found if row["cores"] == 1}
    line = {"release": pcbench.__version__, "commit": (provenance.describe()["git"] or {}).get("commit", "")[:10]}
    for other, what in (("numba", "(c) numba, a loop per run"), ("NumPy", "(b) NumPy over runs")):
        line[f"pcbench / {other}"] = f"{alone[MINE] / alone[what]:.2f}"
    new = not path.exists()
    with path.open("a", newline="") as file:
        table = csv.DictWriter(file, line)
        if new:
            table.writeheader()
        table.writerow(line)


def measured(cores: int, small: bool) -> list[dict[str, Any]]:
    """Check and time all rows on so many cores in this process, whose runtime has not begun."""
    os.environ["NPROC"] = str(cores)
    config.setup()
    jax.config.update("jax_platforms", "cpu")
    if not small:
        jax.config.update("jax_enable_compilation_cache", False)  # compile seconds are to be those of compiling
    given = {"observers": OBSERVERS, "options": {"scenario": {"random_initial_state": True}}}
    (planned,) = planning.plan(parse.grid_of(parse.load(SCENARIO, []), given, []).study)
    ticks = 500 if small else planned.cell.times.ticks
    windows = np.array([[0, ticks // 3], [ticks // 3, ticks - 1], [ticks - 1, ticks]])
    problem, layout = (
        planned.problem._replace(windows=windows),
        planned.layout._replace(width=FEW if small else runner.WIDTH),
    )
    case = prepare(problem, ticks)
    mine, sums = pcbench_row(layout, problem, cores)
    others = baseline_rows(case, problem, layout.width, cores)
    check_baselines(case, problem, sums)
    more = other_rows(cores, small)
    rows = [*others, mine, *(row for row, _ in more)]
    every = [ticks] * (len(rows) - len(more)) + [many for _, many in more]
    return report(rows, take(rows, 1 if small else 5), every)


def in_its_own_process(cores: int, small: bool) -> list[dict[str, Any]]:
    """Return the same of a process of its own; of more than one core without the rows that use one."""
    command = [sys.executable, __file__, "--json", "--cores", str(cores), *(["--small"] if small else [])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.returncode)
    return [row for row in json.loads(done.stdout)["rows"] if row["cores"] == cores]


def main() -> None:
    """Parse, check, time, print."""
    parser = argparse.ArgumentParser(description="Lane-ticks a second of pcbench, NumPy and numba on cart/white.")
    parser.add_argument("--small", action="store_true", help="few ticks and one turn; every row and check")
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    parser.add_argument("--cores", type=int, help="measure on so many only; left out: on one, then on all")
    parser.add_argument("--history", type=Path, help="a table of ratios on one core that gets a line")
    options = parser.parse_args()
    if options.cores:
        found = measured(options.cores, options.small)
    else:
        every = dict.fromkeys((1, runner.cores()))
        found = [row for cores in every for row in in_its_own_process(cores, options.small)]
    if options.history:
        remember(found, options.history)
    if options.json:
        print(json.dumps({"scenario": SCENARIO, "unit": "million lane-ticks a second", "rows": found}, indent=2))
    else:
        show(found, Console() if sys.stdout.isatty() else Console(width=150))


if __name__ == "__main__":
    main()
