"""Six kinds of simulation next to a numba loop written for each: nanoseconds of one core per lane-tick.

    python benchmarks/numba_cases.py [--small] [--json] [--only "closed loop"]

One lane-tick is one run advanced by one tick: plant, observers, controller, and mean absolute error, RMS error and peak of each
estimated signal, in float64. The loops are in `numba_linear.py` and `numba_robots.py`. Before a case is timed, its loop
simulates the first runs with pcbench's random numbers. A metric that differs by more than 1e-9 of its value ends the program
with exit code 1.

Timing: processor time of one core, pcbench and numba in turns (see `turns`), best of the turns. Both draw their random numbers
within the time: pcbench its own (Threefry, addressed by run), numba those of NumPy (PCG64 with a ziggurat), which take less.
A turn of pcbench is one call of the width that a study uses: arguments sent, simulated and read.
The loops have advantages: what the input alone decides is computed beforehand, they are written for one case, and pcbench adds
settling time and divergence, and in a closed loop the tracking error and the cost.
The table also shows what pcbench's program does per lane-tick (`hlo_counts.py`) and its share of what the core can do: the
operations of a product of matrices, and the bandwidth of the second cache. Integer operations are those of the random numbers.
Not claimed: that no loop could be faster, only that these are what a control engineer would write with care; nor that each
operation counted is needed, since the compiler computes some results again in every kernel that uses them.
With --small runs are short and take one turn, with every row and check: the figures mean nothing then.
"""

import argparse
import json
import os
from collections.abc import Callable
from functools import partial
from time import process_time
from typing import Any, NamedTuple

import hlo_counts
import jax
import jax.numpy as jnp
import numba
import numba_linear
import numba_robots
import numpy as np
from baselines import Array
from rich.console import Console
from rich.table import Table
from throughput import FEW, OTHERS, TOLERANCE, turn
from turns import Row, take

from pcbench import planning
from pcbench.engine import runner
from pcbench.observers import high_gain
from pcbench.planning.padding import Plan
from pcbench.runtime import config
from pcbench.simulation import rng
from pcbench.simulation.types import RunSums
from pcbench.study import parse

RUNS = 32  # of a loop in one turn; each takes the same time
CHECKED = 3  # runs
TURNS = 7
HELICOPTER = {"base": "helicopter/constant", "noise_std": 5e-4}  # [rad] one of the study `helicopter`


class Kind(NamedTuple):
    """One kind of simulation."""

    what: str
    study: dict[str, Any]
    loop: Callable[..., None]
    prepare: Callable[[Plan], tuple[Any, ...]]  # the numbers of its loop
    loops: tuple[str, ...] = ("segments", "ticks")  # of its program, if their number is not in its text; see `trips_of`


def prepare_linear(p: Plan) -> numba_linear.Linear:
    """Return the numbers of a linear plant with kf."""
    problem, ticks, clock, kf = p.problem, p.cell.times.ticks, p.cell.times.clocks[0], p.problem.gains["kf"]
    Phi, Gamma, Q = problem.params.Phi, problem.params.Gamma[:, 0], kf.noise[0, 1]
    powers, noise, g = np.tile(np.eye(2), (ticks + 1, 1, 1)), np.zeros((ticks + 1, 2, 2)), np.zeros((ticks + 1, 2))
    moved = np.zeros((ticks, 2)) if p.layout.controller else np.outer(problem.inputs[:ticks, 0], Gamma)
    for k in range(ticks):
        powers[k + 1], noise[k + 1], g[k + 1] = Phi @ powers[k], Phi @ noise[k] @ Phi.T + Q, Phi @ g[k] + moved[k]
    return numba_linear.Linear(
        ticks=ticks,
        period=clock.period,
        delay=clock.delay or 0,
        jitter=clock.jitter,
        loss=clock.loss,
        noise_std=float(problem.noise_std[0]),
        process_std=problem.process_std,
        x0=problem.x0,
        xhat0=problem.xhat0,
        Phi=Phi,
        Gamma=Gamma,
        c=kf.C[0],
        moved=moved,
        g=g,
        powers=powers,
        Q=noise,
        P0=kf.P0,
        R=float(kf.R[0]),
        L=problem.gains["pccebo"].L[:, 0] if "pccebo" in problem.gains else np.zeros(2),
        K=problem.control.K[0] if p.layout.controller else np.zeros(2),
    )


def prepare_arm(p: Plan) -> numba_robots.Arm:
    """Return the numbers of the arm with smo."""
    problem, clock, plant, smo = p.problem, p.cell.times.clocks[0], p.problem.params, p.problem.gains["smo"]
    return numba_robots.Arm(
        ticks=p.cell.times.ticks,
        period=clock.period,
        dt=float(problem.dt),
        noise_std=problem.noise_std,
        x0=problem.x0,
        xhat0=problem.xhat0,
        stiffness=float(plant.stiffness),
        gravity=float(plant.gravity),
        friction=plant.friction,
        d=plant.d,
        F=smo.F,
        Lx=np.vstack([smo.Lx, np.zeros((2, 2))]),
        S=smo.S,
        P2=smo.law.P2,
        rho=float(smo.law.rho),
        eps=float(smo.law.eps),
        fhat=smo.reconstruction[0],
        transition=np.stack([np.linalg.matrix_power(smo.Phi, age) for age in range(clock.period + 1)]),
    )


def prepare_helicopter(p: Plan) -> numba_robots.Helicopter:
    """Return the numbers of the helicopter with high-gain or ekf."""
    problem, clock, plant, law = p.problem, p.cell.times.clocks[0], p.problem.params, p.problem.control
    ((label, gains),) = problem.gains.items()
    lag, first, is_ekf = int(problem.line.lag[0]), -int(law.first), label == "ekf"
    return numba_robots.Helicopter(
        ticks=p.cell.times.ticks,
        period=clock.period,
        delay=clock.delay or 0,
        dt=float(problem.dt),
        noise_std=problem.noise_std,
        x0=problem.x0,
        z0=np.concatenate([problem.xhat0, gains.start]),
        M1=float(plant.J[0] + plant.ml2),
        Jps=float(plant.J[1]),
        ml2=float(plant.ml2),
        mgl=float(plant.mgl),
        K=plant.K,
        B=plant.B,
        Kp=law.Kp,
        Kd=law.Kd,
        limit=law.limit,
        path=law.path[first - lag :, :2].copy(),
        lag=lag,
        weight=float(problem.line.weight[0]),
        theta=0.0 if is_ekf else float(gains.theta),
        S0=high_gain.S0,
        P0=gains.P0 if is_ekf else np.eye(6),
        Q=gains.Q if is_ekf else np.eye(6),
        R=gains.R if is_ekf else np.ones(2),
        highest=float(gains.high[0]),
    )


KINDS = [
    Kind("process noise", OTHERS["process noise"], numba_linear.process_noise, prepare_linear),
    Kind(
        "a schedule for each run",
        OTHERS["a schedule for each run"],
        numba_linear.random_schedule,
        prepare_linear,
        ("segments", "once", "once", "ticks"),
    ),
    Kind(
        "closed loop",
        OTHERS["closed loop"],
        numba_linear.closed_loop,
        prepare_linear,
        ("segments", "ticks", "never", "never"),
    ),
    Kind("arm, smo", {"scenario": {"base": "arm/sampled"}, "observers": ["smo"]}, numba_robots.arm, prepare_arm),
    Kind(
        "helicopter, high-gain",
        {"scenario": HELICOPTER, "observers": ["high-gain"]},
        numba_robots.high_gain,
        prepare_helicopter,
    ),
    Kind(
        "helicopter, ekf",
        {"scenario": HELICOPTER, "observers": ["ekf"]},
        numba_robots.ekf,
        prepare_helicopter,
        ("segments", "period", "delay", "ticks"),
    ),
]


def draws_of(p: Plan, seed: int) -> tuple[Array, Array]:
    """Return the random numbers of one of pcbench's runs as its loop takes them: `noise`, `uniform`."""
    root, seeds, ticks = jnp.asarray(0), jnp.asarray([seed]), p.cell.times.ticks
    channels, states = len(p.problem.noise_std), len(p.problem.process_std)
    random = p.cell.times.random
    samples = p.problem.schedule.due.shape[1] - 1 if random else -(-ticks // p.cell.times.clocks[0].period)
    noise = [np.asarray(rng.measurement_noise(0, seed, samples, channels)).ravel()]
    if states:
        keys = rng.run_keys(root, seeds, "process", states)
        noise.append(
            np.asarray(jax.jit(jax.vmap(lambda k: rng.normals(keys, [k] * states)))(jnp.arange(ticks))).ravel()
        )
    if not random:
        return np.concatenate(noise), np.zeros(0)
    channel = jnp.asarray(0)
    shift, loss = (
        rng.uniforms(root, seeds, s, channel, samples, n)[:, n // 2, 0] for s, n in (("jitter", 3), ("loss", 1))
    )
    return np.concatenate(noise), np.concatenate([shift, loss])


def trips_of(kind: Kind, p: Plan) -> list[float]:
    """Return how often each loop of a program runs: segments of ticks between events, per window, and loops inside them."""
    ticks, clock = p.cell.times.ticks, p.cell.times.clocks[0]
    segments = ticks * (2 * clock.jitter + 1) / clock.period
    lengths = {"segments": segments / len(p.problem.windows), "ticks": ticks / segments, "once": 1.0, "never": 0.0}
    lengths |= {"period": float(clock.period), "delay": float(clock.delay or 0)}
    return [lengths[name] for name in kind.loops]


@numba.njit
def simulate(run, case, rng, noise, uniform, out):
    """Simulate len(out) runs, one after the other, each with new draws; `noise` and `uniform` are room for them."""
    for lane in range(len(out)):
        for i in range(len(noise)):
            noise[i] = rng.standard_normal()
        for i in range(len(uniform)):
            uniform[i] = rng.random()
        run(case, noise, uniform, out[lane])


def sums_of(p: Plan, outcome: RunSums) -> Array:
    """Return the sums of |e| and e^2 and the peaks of all observers, [3, signals, runs]."""
    each = [outcome.streams[name] for name, _ in p.layout.observers]
    return np.concatenate([np.stack([s.absolute.sum(0), s.square.sum(0), s.peak.max(0)]) for s in each], 1)


def check(what: str, got: Array, expected: Array) -> None:
    """Exit with a sentence if a metric of a run differs by more than TOLERANCE of its value."""
    got, expected = (np.stack([s[0], np.sqrt(s[1]), s[2]]) for s in (got, expected))
    worst = np.abs(got / expected - 1).max()
    if not worst <= TOLERANCE:
        raise SystemExit(f"numba_cases: {what}: got metrics {worst:.1e} off pcbench's, expected {TOLERANCE:g} at most.")


def measured(kind: Kind, small: bool) -> dict[str, Any]:
    """Check, count and time one kind."""
    table = "lti" if "lti" in kind.study else "scenario"
    cut = {table: kind.study[table] | {"duration": 1.0, "steady_start": 0.5}} if small else {}
    study = {"name": "kind", "seeds": runner.NARROW_WIDTHS[-1]} | kind.study | cut
    (p,) = planning.plan(parse.grid_of(study, {}, []).study)
    layout, ticks = p.layout._replace(width=FEW) if small else p.layout, p.cell.times.ticks
    jobs = [runner.Job(p.problem, 0, np.arange(layout.width))]
    program = runner.program(layout, jobs[0])
    ((_, outcome),) = runner.serial(program, jobs)
    expected, case = sums_of(p, outcome), kind.prepare(p._replace(problem=jax.tree.map(np.asarray, p.problem)))
    for seed in range(CHECKED):
        out = np.zeros(expected.shape[:2])
        kind.loop(case, *(draws := draws_of(p, seed)), out)
        check(f"{kind.what}, run {seed}", out, expected[..., seed])
    runs = 1 if small else RUNS
    work = partial(simulate, kind.loop, case, np.random.default_rng(0), *draws)
    start = process_time()
    work(np.zeros((1, *out.shape)))
    compile_seconds = process_time() - start
    rows = [
        Row("pcbench", 1, layout.width, layout.width, partial(turn, layout, jobs, 1), program.compile_seconds),
        Row("numba", 1, 1, runs, partial(work, np.zeros((runs, *out.shape))), compile_seconds),
    ]
    timed = take(rows, 1 if small else TURNS)
    mine, loop = 1e9 * timed.cpu.min(1) / (np.array([layout.width, runs]) * ticks)
    counts = hlo_counts.count(program.call.as_text(), trips_of(kind, p))
    per_lane_tick = [float(n) / (layout.width * ticks) for n in counts[:3]]
    found = {
        "what": kind.what,
        "ticks": ticks,
        "lanes": layout.width,
        "pcbench": mine,
        "numba": loop,
        "ratio": loop / mine,
    }
    return found | dict(zip(counts._fields, [*per_lane_tick, counts.kernels / ticks], strict=True))


COLUMNS = {  # key: head and format
    "what": ("case", "{}"),
    "ticks": ("ticks", "{:,}"),
    "lanes": ("lanes", "{:,}"),
    "pcbench": ("pcbench [ns]", "{:.0f}"),
    "numba": ("numba [ns]", "{:.0f}"),
    "ratio": ("ratio", "{:.2f}"),
    "flops": ("flops", "{:,.0f}"),
    "integer": ("integer", "{:,.0f}"),
    "bytes": ("bytes", "{:,.0f}"),
    "kernels": ("kernels per tick", "{:.0f}"),
    "share": ("share of flops", "{:.0%}"),
    "share_l2": ("share of L2", "{:.0%}"),
}


def show(rows: list[dict[str, Any]], core: hlo_counts.Core) -> None:
    """Print the table."""
    caption = f"Per lane-tick. One core: {core.gflops:.0f} GFLOP/s, {core.l1:.0f} bytes/ns in L1, {core.l2:.0f} in L2."
    table = Table(title="pcbench next to numba, one core", caption=caption)
    for head, _ in COLUMNS.values():
        table.add_column(head, justify="left" if head == "case" else "right", no_wrap=head == "case")
    for row in rows:
        table.add_row(*(shape.format(row[key]) for key, (_, shape) in COLUMNS.items()))
    Console(width=150).print(table)


def main() -> None:
    """Parse, check, time, print."""
    parser = argparse.ArgumentParser(description="Six kinds of simulation next to numba loops written for them.")
    parser.add_argument("--small", action="store_true", help="short runs and one turn; every row and check")
    parser.add_argument("--json", action="store_true", help="print JSON for a program instead of the table")
    parser.add_argument("--only", help="the kinds whose name contains this")
    options = parser.parse_args()
    kinds = [kind for kind in KINDS if (options.only or "") in kind.what]
    if not kinds:
        parser.error(f"--only: got {options.only!r}, expected a part of one of: {'; '.join(k.what for k in KINDS)}")
    os.environ["NPROC"] = "1"
    config.setup()
    jax.config.update("jax_platforms", "cpu")
    core = hlo_counts.core()
    rows = [measured(kind, options.small) for kind in kinds]
    for row in rows:
        row |= {
            "share": row["flops"] / row["pcbench"] / core.gflops,
            "share_l2": row["bytes"] / row["pcbench"] / core.l2,
        }
    if options.json:
        print(
            json.dumps({"unit": "per lane-tick, times in nanoseconds", "core": core._asdict(), "rows": rows}, indent=2)
        )
    else:
        show(rows, core)


if __name__ == "__main__":
    main()
