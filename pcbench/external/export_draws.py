"""`pcbench external prepare`: the measurements of every run of a study with their arrival times, as files for any program.

The files do not contain true values, so estimates made from them cannot depend on these.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa

from pcbench.dataset import manifest, parquet_io, single_table, storage
from pcbench.dynamics import linear
from pcbench.external import runs
from pcbench.planning import context_of
from pcbench.planning.padding import Plan
from pcbench.plants import estimated_of
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.study.grid import Grid

FOLDER = "draws"
SAMPLES = {
    "scenario": (pa.string(), "", "name of the scenario"),
    "cell": (pa.int64(), "", "number of the grid point in the scenario"),
    "seed": (pa.int64(), "", "seed index of the run"),
    "channel": (pa.int64(), "", "output, from 1"),
    "sample": (pa.int64(), "", "number of the sample in its channel, from 0"),
    "sampled_tick": (
        pa.int64(),
        "",
        "timestamp: the assumed sampling tick; below 0: taken before the run, from the state at tick 0",
    ),
    "sampled": (pa.float64(), "s", "the same in seconds"),
    "arrived_tick": (
        pa.int64(),
        "",
        "tick of arrival, before the estimate of this tick; null: does not arrive within the run",
    ),
    "arrived": (pa.float64(), "s", "the same in seconds"),
    "value": (
        pa.float64(),
        "unit of the output",
        "measured value with all errors of the sensor; null: the sensor did not send it",
    ),
}
CELL = {
    "scenario": ("", "name of the scenario"),
    "cell": ("", "number of the grid point in the scenario"),
    "axes": ("", "value of each axis at the grid point"),
    "dt": ("s", "length of a tick"),
    "ticks": ("", "N, the ticks of a run"),
    "signals": ("", "name and unit of each state and unknown, in the order of the estimates"),
    "period": ("ticks", "[q] sampling period of each output; the mean if intervals vary"),
    "intervals": ("ticks", "every interval between samples that can occur, if all outputs are sampled together"),
    "delay": ("ticks", "[q] assumed delay of each output; the mean if it varies"),
    "latest": ("ticks", "assumed greatest age of a measurement at its arrival"),
    "noise_std": ("unit of the output", "[q] assumed standard deviation of the measurement noise"),
    "send_threshold": (
        "unit of the output",
        "[q] change from which on a sample of each output is sent; empty: all are sent, or by another rule",
    ),
    "R": ("product of the outputs' units", "[q, q] assumed covariance of the noise of a measurement"),
    "Q": ("product of the states' units", "[n, n] assumed covariance of the process noise of one tick"),
    "input_intensity": ("input^2/s", "assumed intensity of white noise on the input, if parameters drift"),
    "P0": ("product of the states' units", "[n, n] covariance of x(0) - xhat(0)"),
    "unknown_std": ("unit of the unknown", "[s] typical size of each unknown input or parameter"),
    "unknown0": ("unit of the unknown", "[s] initial estimate of each unknown input or parameter"),
    "unknown_range": ("unit of the unknown", "[s, 2] limits of each unknown input or parameter; null: none"),
    "model": (
        "",
        "nominal model: A, B, C, D, the matrix E of an unknown input (null: none), whether A and B are of one tick "
        "(`discrete`), and Phi, Gamma of one tick with a held input",
    ),
}
README = """# Measurements of all runs, with their arrival times

Written by `pcbench external prepare`. Ticks are whole numbers. With `--csv` each table is also a `.csv` file.

`samples.parquet` has one row per sample of each channel:

| column | unit | meaning |
|---|---|---|
{rows}

`inputs.parquet` has the inputs: scenario, cell, tick, t [s], u1, u2, ..., each held from its tick to the next.
`starts.parquet` has xhat(0): scenario, cell, seed, and one column per state in the order of `signals`, x1, x2, ...

`cells.json` has one table per grid point, with the data that the designs of pcbench also use. n states, m inputs, q outputs,
s unknown inputs or parameters.

| key | unit | meaning |
|---|---|---|
{keys}

Order of tick k: samples are taken, samples arrive (the oldest first), **the estimate of tick k is read**, the input u_k is
held over the tick. So the estimate of tick k may use samples that arrived up to tick k and inputs up to tick k - 1.

Write a Parquet or CSV file with one row per tick 0 .. N - 1 of each run (N is `ticks` in `cells.json`). Its columns are
scenario, cell, seed, tick, and one per signal, with its name. Then run
`pcbench external score DIR estimates.parquet --name my-observer`.
"""


def write(grid: Grid, out: str | Path, csv: bool = False, progress: Progress = SILENT) -> storage.Target:
    """Write the measurements of a study into a folder, which is also the folder of its results and scores.

    With `csv` the tables are written as CSV files in addition to Parquet.
    """
    with config.float64():
        target = storage.target(out)
        claim = manifest.claim(target, grid)
        plans = [runs.plan_without_observers(cell) for cell in claim.cells]
        storage.create_folder(target)
        if storage.read_bytes(target, manifest.TEXT) is None:
            manifest.renew(target, claim)
        seeds = grid.study.first_seed + np.arange(grid.study.seeds)
        progress.begin("runs", len(seeds) * len(plans))
        samples, starts = [], []
        for p in plans:
            for run in runs.runs(p, grid.study.root_seed, seeds):
                samples.append(_samples(p, run))
                starts.append(_keys(p, 1, seed=run.seed) | {f"x{i + 1}": [v] for i, v in enumerate(run.xhat0.tolist())})
                progress.step(1)
        schema = pa.schema(
            [pa.field(n, kind, metadata={"unit": u, "meaning": m}) for n, (kind, u, m) in SAMPLES.items()]
        )
        columns_by_name = {name: np.concatenate([np.asarray(part[name]) for part in samples]) for name in SAMPLES}
        columns = [pa.array(columns_by_name[name], SAMPLES[name][0], from_pandas=True) for name in SAMPLES]
        tables = {
            "samples": pa.Table.from_arrays(columns, schema=schema),
            "starts": _concat_tables(starts),
            "inputs": _concat_tables([_inputs(p) for p in plans]),
        }
        files = {f"{FOLDER}/{name}.parquet": parquet_io.encode_table(table) for name, table in tables.items()}
        for name, table in tables.items():
            if csv:
                files[f"{FOLDER}/{name}.csv"] = single_table.as_csv(table)
            else:
                storage.remove(target, f"{FOLDER}/{name}.csv")
        files[f"{FOLDER}/cells.json"] = (json.dumps([_cell(p) for p in plans], indent=2) + "\n").encode()
        rows = "\n".join(f"| `{name}` | {unit} | {meaning} |" for name, (_, unit, meaning) in SAMPLES.items())
        keys = "\n".join(f"| `{name}` | {unit} | {meaning} |" for name, (unit, meaning) in CELL.items())
        files[f"{FOLDER}/README.md"] = README.format(rows=rows, keys=keys).encode()
        storage.write_files(target, files)
        return target


def _keys(p: Plan, count: int, **others: object) -> dict[str, object]:
    keys = {"scenario": p.cell.scenario.name, "cell": p.cell.number} | others
    return {name: [value] * count for name, value in keys.items()}


def _samples(p: Plan, run: runs.Run) -> dict[str, object]:
    dt, ticks = p.cell.scenario.dt, p.cell.times.ticks
    sampling_ticks = np.array([s.assumed_tick(p.cell.times.error) for s in run.samples])
    arrives = np.array([s.arrives if s.arrives < min(NEVER, ticks + 1) else np.nan for s in run.samples], float)
    return _keys(p, len(sampling_ticks), seed=run.seed) | {
        "channel": [s.channel + 1 for s in run.samples],
        "sample": [s.number for s in run.samples],
        "sampled_tick": sampling_ticks,
        "sampled": sampling_ticks * dt,
        "arrived_tick": arrives,
        "arrived": arrives * dt,
        "value": run.values,
    }


def _inputs(p: Plan) -> dict[str, object]:
    u = np.asarray(p.problem.inputs)
    ticks = np.arange(len(u))
    return (
        _keys(p, len(u))
        | {"tick": ticks, "t": ticks * p.cell.scenario.dt}
        | {f"u{i + 1}": c for i, c in enumerate(u.T)}
    )


def _concat_tables(parts: list[dict[str, object]]) -> pa.Table:
    return pa.concat_tables([pa.table(part) for part in parts], promote_options="default")


def _cell(p: Plan) -> dict[str, object]:
    """Return the design data of a grid point that an external program gets: the same that observers of pcbench use."""
    context, s = context_of(p.cell), p.cell.scenario
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    model = {
        "A": context.model.A,
        "B": context.model.B,
        "C": context.model.C,
        "D": context.model.feedthrough,
        "E": context.model.E,
        "discrete": context.model.discrete,
        "Phi": Phi,
        "Gamma": Gamma,
    }
    return {
        "scenario": s.name,
        "cell": p.cell.number,
        "axes": dict(p.cell.values),
        "dt": s.dt,
        "ticks": p.cell.times.ticks,
        "signals": [{"name": name, "unit": unit} for name, unit in estimated_of(s)],
        "period": list(context.period),
        "intervals": list(context.intervals),
        "delay": list(context.delay),
        "latest": context.latest,
        "noise_std": list(context.noise_std),
        "send_threshold": list(context.send_threshold),
        "R": np.asarray(context.noise_covariance).tolist(),
        "Q": context.process_noise.tolist(),
        "input_intensity": context.input_intensity,
        "P0": np.asarray(context.P0).tolist(),
        "unknown_std": list(context.unknown_std),
        "unknown0": list(context.unknown0),
        "unknown_range": [[v if np.isfinite(v) else None for v in limits] for limits in context.unknown_range],
        "model": {name: None if value is None else np.asarray(value).tolist() for name, value in model.items()},
    }
