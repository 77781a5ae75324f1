"""Runs of one cell in time, thinned for the eye: one of them, and how far the errors of several reach.

The run shown is the study's first seed, or any other; beside it run the seeds after it, so that the picture can say what of an
error is luck. They are simulated anew by the functions that made the tables, and kept in the folder `examples` beside these,
where they are found again: one file for each scenario, of the cell and seed that were looked at last.
"""

import hashlib
import json
from pathlib import Path

import pandas as pd
import pyarrow as pa

from pcbench.dataset import parquet, store
from pcbench.errors import UserError
from pcbench.machine import provenance
from pcbench.machine.progress import SILENT, Progress
from pcbench.plots import recorded
from pcbench.plots.recorded import POINTS, RUNS
from pcbench.study import Study
from pcbench.study.cells import Cell, cells
from pcbench.study.own_observers import is_absent

KEY = b"pcbench.example"  # the key in a file's metadata: what it was made of
FORM = 2  # of the file


def of(
    study: Study, scenario: str, out: str | Path | None, cell: int = 0, seed: int | None = None
) -> pd.DataFrame | None:
    """Return one run of a scenario as `several` does."""
    return several(study, {scenario: cell}, out, seed)[scenario]


def several(
    study: Study, at: dict[str, int], out: str | Path | None, seed: int | None = None, progress: Progress = SILENT
) -> dict[str, pd.DataFrame | None]:
    """Return signal, series, kind, t [s], value of one run of each scenario, in the cell that `at` says of it.

    What does not stand in the folder `out` is made, all together, and put there.

    `kind` is truth (of the plant; in a closed loop each observer has its own), estimate, error (truth less estimate), low and
    high (between which nine in ten errors of RUNS runs lie at that time) and rms (over them), measured (as it has arrived and
    is held; of signals that an output shows as they are) or target (of a closed loop). Runs that are all alike, and those with
    schedules of their own, have no low, high and rms. None where it does not stand there and the code of an observer of a
    user's own is not here. Raises UserError for a cell that the scenario has not.
    """
    chosen = {scenario: _cell(study, scenario, number) for scenario, number in at.items()}
    seed = study.first_seed if seed is None else seed
    if not 0 <= seed < 2**32 - RUNS:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32 - {RUNS}.")
    target = None if out is None else store.target(str(out))
    found = {scenario: _kept(target, scenario, _key(study, cell, seed)) for scenario, cell in chosen.items()}
    missing = {
        scenario: cell
        for scenario, cell in chosen.items()
        if found[scenario] is None and not any(map(is_absent, [*cell.own.values(), *cell.scenario.own.values()]))
    }
    for scenario, made in recorded.several(missing, study.root_seed, seed, progress).items():
        found[scenario] = made
        if target is not None:
            _keep(target, scenario, made, _key(study, chosen[scenario], seed))
    return found


def _cell(study: Study, scenario: str, number: int) -> Cell:
    every = {each.number: each for each in cells(study, scenario)}
    if number not in every:
        raise UserError(
            f"--cell: got {number}, expected one of 0 .. {len(every) - 1}, the cells of {scenario}; take one."
        )
    return every[number]


def _file(scenario: str) -> str:
    return f"examples/{scenario.replace('/', '%2F')}.parquet"


def _kept(target: store.Target | None, scenario: str, key: bytes) -> pd.DataFrame | None:
    """A scenario's runs as they are kept, where they are of this key."""
    found = None if target is None else store.get(target, _file(scenario))
    kept = None if found is None else parquet.whole(found)
    return kept.to_pandas() if kept is not None and kept.schema.metadata.get(KEY) == key else None


def _keep(target: store.Target, scenario: str, made: pd.DataFrame, key: bytes) -> None:
    table = pa.Table.from_pandas(made, preserve_index=False)
    about = {**(table.schema.metadata or {}), KEY: key}
    store.put_table(target, _file(scenario), parquet.sealed(table.replace_schema_metadata(about)))


def _key(study: Study, cell: Cell, seed: int) -> bytes:
    """What an example was made of: the cell, the observers with their options, the run, and the release."""
    options = {o: given.model_dump() for o, given in cell.options.items()}
    said = [cell.digest, options, cell.told, seed, provenance.versions(), POINTS, RUNS, FORM]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest().encode()
