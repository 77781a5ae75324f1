"""The Python face of pcbench: `run`, `trace` and `design`, each a command as well."""

import json
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from copy import deepcopy
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import numpy as np
import pandas as pd
import pyarrow.dataset as ds

from pcbench import machine, recording, tables
from pcbench.cells import cells
from pcbench.dataset import campaign, closing, executors, folder, ledger, store, until
from pcbench.errors import UserError
from pcbench.observers import entry_of
from pcbench.planning import alone, plan, setting
from pcbench.plants import signals_of
from pcbench.scenarios import Scenario
from pcbench.study import Study, options_of, scenarios_of
from pcbench.study_file import load, override, parse
from pcbench.synthesis.certificate import Design

Tell = Callable[[str, float], None]
Say = Callable[[str], None]
Described = str | Path | dict[str, Any] | Study  # a built-in name, a TOML file, or what one holds


class Result:
    """What a study gave: three tables as pandas frames (see `tables.MEANING`), and its provenance.

    Without a folder of its own it stands in a temporary one, which goes when the result does.
    """

    def __init__(
        self, study: Study, place: store.Target, out: Path | str | None, effort: campaign.Effort, keep: Any = None
    ):
        self.study, self.out, self.effort, self._place, self._keep = study, out, effort, place, keep
        self.provenance: dict[str, Any] = json.loads(store.text(place, "provenance.json") or b"{}")

    @cached_property
    def stats(self) -> pd.DataFrame:
        """One row per cell, observer, signal and metric."""
        return self._closing("stats.parquet")

    @cached_property
    def pairs(self) -> pd.DataFrame:
        """One row per cell, pair of observers, signal and metric."""
        return self._closing("pairs.parquet")

    @cached_property
    def runs(self) -> pd.DataFrame:
        """One row per cell, observer, seed and signal."""
        files = [f"{self._place.root}/{name}" for name in store.names(self._place, "runs")]
        base = f"{self._place.root}/runs"
        found = ds.dataset(
            files, filesystem=self._place.fs, format="parquet", partitioning="hive", partition_base_dir=base
        )
        whole = found.to_table().to_pandas()
        first = ["study", "scenario", "observer", "cell"]
        ordered = whole[first + [c for c in whole.columns if c not in first]]
        return ordered.sort_values([*first, "seed"], kind="stable", ignore_index=True)

    def _closing(self, name: str) -> pd.DataFrame:
        found = closing.table(self._place, name)
        if found is None:
            raise UserError(f"{self._place.name}/{name}: is gone or damaged; run the study again to have it made anew.")
        return tables.frame(found)

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
    first_seed: int | None = None,
    observers: str | list[str] | None = None,
    axes: dict[str, list[Any]] | None = None,
    options: dict[str, dict[str, Any]] | None = None,
    root_seed: int | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    fresh: bool = False,
    until_se: str | None = None,
    max_seeds: int | None = None,
    devices: int | None = None,
    dask: str | None = None,
    workers: int | None = None,
    block: int | None = None,
    memory: str | int | None = None,
    tell: Tell = lambda event, value: None,
    say: Say = lambda sentence: None,
) -> Result:
    """Run a study and return its tables; with `out`, a folder or a URI, leave them there: run again, it goes on.

    `study` is a built-in name, a scenario's name, a TOML file, a dict of the same shape, or a Study; the arguments up to
    `root_seed` replace its keys. `overrides` are texts such as "axes.noise_std=0.1". What is finished in `out` is not done
    again, unless `fresh`. `until_se` "METRIC=VALUE" adds seeds to each cell until the standard error of every observer is
    that small, `max_seeds` at most. Of no influence on any number: `devices` (calls at a time), `dask` (a scheduler's address,
    or "local" with `workers`), `block` (seeds a file) and `memory` (bytes, or a text such as "2GiB": what results may take at
    a time; by default a quarter of the machine's). `tell` hears of progress, `say` of damaged files. Raises UserError, one
    sentence, for whatever the user can mend.
    """
    observers = [observers] if isinstance(observers, str) else observers
    changes = {"seeds": seeds, "observers": observers, "axes": axes, "options": options, "root_seed": root_seed}
    goal = until.parse(until_se, max_seeds)
    with machine.float64(), ExitStack() as stack:
        chosen = study_of(study, changes | {"first_seed": first_seed}, overrides or [])
        start, began = perf_counter(), datetime.now(UTC)
        keep = tempfile.TemporaryDirectory(prefix="pcbench-") if out is None else None
        place = store.target(keep.name if keep else str(out))
        claimed = folder.claim(place, chosen, fresh)
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
    return Result(chosen, place, where, effort, keep)


def positive(count: int | None, where: str) -> int | None:
    """Return a count that was given; raise UserError where it is none."""
    if count is not None and count < 1:
        raise UserError(f"{where}: got {count}, expected 1 or more; leave it out.")
    return count


def one_cell(what: Described, observers: list[str], overrides: list[str]) -> tuple[Study, Any]:
    """Return a study of some observers in one scenario with its one cell; raise UserError where there are more."""
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
        study, cell = one_cell(scenario, names, overrides or [])
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
        study, cell = one_cell(scenario, [observer], overrides or [])
        return entry_of(observer).design(setting(cell), options_of(study, cell.scenario, observer))
