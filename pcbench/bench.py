"""The Python face of pcbench: `run`, `trace` and `design`, each a command as well."""

from collections.abc import Callable
from copy import deepcopy
from datetime import UTC, datetime
from functools import cached_property, partial
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.dataset as ds

from pcbench import machine, recording, statistics, store, sweep, tables
from pcbench.cells import cells, digest, to_toml
from pcbench.errors import UserError
from pcbench.observers import entry_of
from pcbench.planning import Planned, alone, plan, setting
from pcbench.plants import signals_of
from pcbench.scenarios import Scenario
from pcbench.study import Study, options_of, scenarios_of
from pcbench.study_file import load, override, parse
from pcbench.synthesis.certificate import Certificate, Design

Tell = Callable[[str, float], None]
Described = str | Path | dict[str, Any] | Study  # a built-in name, a TOML file, or what one holds


class Result:
    """What a study gave: three tables as pandas frames (see `tables.MEANING`), and its provenance."""

    def __init__(self, study: Study, stats: pa.Table, pairs: pa.Table, provenance: dict[str, Any], runs: Any, out: Any):
        self.study, self.provenance, self.out = study, provenance, out
        self.stats, self.pairs = tables.frame(stats), tables.frame(pairs)
        self._runs = runs

    @cached_property
    def runs(self) -> pd.DataFrame:
        """One row per cell, observer, seed and signal."""
        return self._runs()

    def __repr__(self) -> str:
        return f"<pcbench result of study '{self.study.name}': {len(self.stats)} rows of stats>"


def study_of(study: Described, changes: dict[str, Any], overrides: list[str]) -> Study:
    """Return a checked study from a name, a TOML file, a dict or a Study, with top-level `changes` put in."""
    if isinstance(study, str | Path):
        study, overrides = load(str(study), overrides), []
    raw = deepcopy(study.model_dump(exclude_none=True) if isinstance(study, Study) else dict(study))
    for change in overrides:
        override(raw, change)
    raw |= {key: value for key, value in changes.items() if value is not None}
    return parse(raw, str(raw.get("name", "study")))


def run(
    study: Described,
    *,
    seeds: int | None = None,
    observers: str | list[str] | None = None,
    axes: dict[str, list[Any]] | None = None,
    options: dict[str, dict[str, Any]] | None = None,
    root_seed: int | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    devices: int | None = None,
    tell: Tell = lambda event, value: None,
) -> Result:
    """Run a study and return its tables; with `out`, leave them in that folder as well.

    `study` is a built-in name, a scenario's name, a TOML file, a dict of the same shape, or a Study; the other
    arguments replace its keys. `overrides` are texts such as "axes.noise_std=0.1". Raises UserError, one sentence, for
    whatever the user can mend; then nothing is written.
    """
    observers = [observers] if isinstance(observers, str) else observers
    changes = {"seeds": seeds, "observers": observers, "axes": axes, "options": options, "root_seed": root_seed}
    with machine.float64():
        chosen = study_of(study, changes, overrides or [])
        start, began = perf_counter(), datetime.now(UTC)
        planned = plan(chosen)
        folder = None if out is None else Path(out)
        if folder is not None:
            store.claim(folder, to_toml(chosen))
        tell("planned", float(sum(len(p.problem.gains) for p in planned) * chosen.seeds))
        stats, pairs, kept, compile_seconds = _collect(chosen, planned, folder, devices, tell)
        provenance = machine.describe() | {
            "schema": tables.SCHEMA,
            "study": chosen.name,
            "study_sha256": digest(chosen),
            "root_seed": chosen.root_seed,
            "started": began.isoformat(timespec="seconds"),
            "wall_seconds": round(perf_counter() - start, 3),
            "compile_seconds": round(compile_seconds, 3),
            "certificates": _certificates(planned),
        }
    if folder is not None:
        store.write_table(folder / "stats.parquet", stats)
        store.write_table(folder / "pairs.parquet", pairs)
        store.write_json(folder / "provenance.json", provenance)
    return Result(chosen, stats, pairs, provenance, partial(_runs, folder, kept), folder)


def _collect(
    study: Study, planned: list[Planned], folder: Path | None, devices: int | None, tell: Tell
) -> tuple[pa.Table, pa.Table, list[tuple[str, str, pa.Table]], float]:
    """Run, and turn each finished cell into rows; runs go to the folder, or are kept where there is none."""
    stats, pairs, kept, compiled = [], [], [], []

    def listen(event: str, value: float) -> None:
        if event == "compiled":
            compiled.append(value)
        tell(event, value)

    for done in sweep.execute(study, planned, devices=devices, tell=listen):
        scenario = done.planned.cell.scenario
        signals = signals_of(scenario)
        head = tables.keys(study.name, done.planned.cell) | {"plant": scenario.plant}
        for observer, results in done.results.items():
            table = tables.runs_table(study.name, done, observer, signals)
            if folder is None:
                kept.append((scenario.name, observer, table))
            else:
                store.write_table(store.runs_path(folder, scenario.name, observer, done.planned.cell.number), table)
            who = {"observer": observer, "carries_input": done.planned.carries_input[observer]}
            stats += [head | who | row for row in _described(done, results, signals)]
        units, sizes, carries = dict(signals), scenario.prior_std + scenario.unknown_std, done.planned.carries_input
        for row in statistics.pairs(done.results, [name for name, _ in signals], sizes):
            about: dict[str, Any] = {"unit": tables.unit_of(row["metric"], units[row["signal"]])}
            about |= {f"carries_input_{side}": carries[row[f"observer_{side}"]] for side in "ab"}
            pairs.append(head | about | row)
    axes = tables.axes_of(stats[0])
    return (
        tables.rows_table(stats, tables.stats_order(axes)),
        tables.rows_table(statistics.adjusted(pairs), tables.pairs_order(axes)),
        kept,
        sum(compiled),
    )


def _certificates(planned: list[Planned]) -> dict[str, dict[str, Any]]:
    """The weakest certificate of each observer over the cells of each scenario; margin None: nothing to prove."""
    weakest: dict[str, dict[str, Certificate]] = {}
    for p in planned:
        mine = weakest.setdefault(p.cell.scenario.name, {})
        for observer, c in p.certificates.items():
            mine[observer] = min(mine.get(observer, c), c, key=lambda c: c.margin)
    return {
        scenario: {
            observer: {
                "inequality": c.inequality,
                "margin": c.margin if isfinite(c.margin) else None,
                "solver": c.solver,
                "status": c.status,
            }
            for observer, c in mine.items()
        }
        for scenario, mine in weakest.items()
    }


def _described(done: sweep.Done, results: dict[str, Any], signals: tuple[tuple[str, str], ...]) -> list[dict[str, Any]]:
    rows = []
    prior, bound = done.planned.cell.scenario.prior_std, done.planned.bound
    for i, (signal, unit) in enumerate(signals[: len(results["mae"])]):
        known = None if bound is None or bound[i] < statistics.SEEN * prior[i] else float(bound[i])
        for row in statistics.describe(results, i, known):
            rows.append({"signal": signal, "unit": tables.unit_of(row["metric"], unit)} | row)
    return rows


def _runs(folder: Path | None, kept: list[tuple[str, str, pa.Table]]) -> pd.DataFrame:
    if folder is not None:
        whole = ds.dataset(folder / "runs", format="parquet", partitioning="hive").to_table().to_pandas()
    else:
        named = [
            t.append_column("scenario", [[s] * len(t)]).append_column("observer", [[o] * len(t)]) for s, o, t in kept
        ]
        whole = pa.concat_tables(named).to_pandas()
    first = ["study", "scenario", "observer", "cell"]
    ordered = whole[first + [c for c in whole.columns if c not in first]]
    return ordered.sort_values([*first, "seed"], kind="stable", ignore_index=True)


def _one_cell(what: Described, observers: list[str], overrides: list[str]) -> tuple[Study, Any]:
    study = study_of(study_of(what, {}, overrides), {"observers": observers}, [])
    every = [cell for name in study.scenarios for cell in cells(study, name)]
    if len(every) > 1:
        raise UserError(
            f"{study.name}: got {len(every)} cells, expected one here; name one scenario, each axis with one value."
        )
    return study, every[0]


def scenario_of(what: str, overrides: list[str] | None = None) -> Scenario:
    """Return the one scenario that a name or a TOML file stands for; raise UserError where there are more."""
    study = load(what, overrides)
    if len(study.scenarios) > 1:
        raise UserError(f"{what}: got {len(study.scenarios)} scenarios, expected one here; name a scenario.")
    return scenarios_of(study)[study.scenarios[0]]


def trace(
    scenario: Described, observers: str | list[str], *, seed: int = 0, overrides: list[str] | None = None
) -> pd.DataFrame:
    """Return one run tick by tick, ticks 0 .. N: t [s], each signal, <observer>.<signal>, u1.., y1.. (held arrivals).

    Signals are the states and what the plant has of unknown inputs or parameters; observers have columns for what they
    estimate. A trace of a closed loop is of one observer, and has the set point too: target.<signal>.

    `scenario` is a scenario's name, or a study (TOML file, dict, `pcbench.lti`) with one scenario and one cell.
    Estimates are those of the present, read after the jump of the tick; y is what has arrived and is held, NaN before.
    """
    names = [observers] if isinstance(observers, str) else list(observers)
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32.")
    with machine.float64():
        study, cell = _one_cell(scenario, names, overrides or [])
        if cell.scenario.controller and len(names) > 1:
            raise UserError(
                f"{study.name}: got {len(names)} observers in a closed loop, expected one: each drives a plant of its own; "
                "trace them one at a time."
            )
        (p,) = (alone(planned, study.root_seed, seed) for planned in plan(study))
        out = recording.compiled()(p.layout, p.problem, np.asarray(study.root_seed), np.asarray(seed))
        out = jax.tree.map(np.asarray, out)
    signals = [name for name, _ in signals_of(p.cell.scenario)]
    columns = {"t": np.arange(len(out.x)) * p.cell.scenario.dt}
    columns |= {signal: out.x[:, i] for i, signal in enumerate(signals)}
    for name, (called, _) in zip(p.labels, p.layout.observers, strict=True):
        columns |= {f"{name}.{signals[i]}": each for i, each in enumerate(out.estimates[called].T)}
    columns |= {f"target.{signals[i]}": each for i, each in enumerate(out.target.T)}
    columns |= {f"u{i + 1}": u for i, u in enumerate(out.u.T)}
    columns |= {f"y{i + 1}": y for i, y in enumerate(_held(out.arrived).T)}
    frame = pd.DataFrame(columns)
    frame.attrs["carries_input"] = dict(p.carries_input)  # of the predictions to now, by observer
    return frame


def _held(arrived: np.ndarray) -> np.ndarray:
    """What has arrived and is held at every tick, [N+1, q], from what arrives at each; NaN before the first."""
    last = np.maximum.accumulate(np.where(np.isnan(arrived), -1, np.arange(len(arrived))[:, None]))
    return np.where(last >= 0, np.take_along_axis(arrived, np.maximum(last, 0), 0), np.nan)


def design(scenario: Described, observer: str, *, overrides: list[str] | None = None) -> Design:
    """Return an observer's gains in a scenario with the certificate that proves them."""
    with machine.float64():
        study, cell = _one_cell(scenario, [observer], overrides or [])
        return entry_of(observer).design(setting(cell), options_of(study, cell.scenario, observer))
