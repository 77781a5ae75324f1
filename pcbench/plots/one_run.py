"""One run of each scenario tick by tick, thinned for the eye: what a report shows in time.

It is the study's first seed in the scenario's first cell, simulated anew by `api.trace` and kept in the folder `examples`
beside the tables, where it is found again.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pcbench import api
from pcbench.dataset import parquet, store
from pcbench.machine import provenance
from pcbench.planning import setting
from pcbench.plants import signals_of
from pcbench.study import Study
from pcbench.study.cells import Cell, cells
from pcbench.study.own_observers import is_absent

KEY = b"pcbench.example"  # the key in a file's metadata: what it was made of
POINTS = 300  # ticks that are kept
UNIT = 1e-12  # a row of C shows a state as it is when it differs from a unit vector by less


def of(study: Study, scenario: str, out: str | Path | None) -> pd.DataFrame | None:
    """Return signal, series, kind, t [s], value of one run; made where it does not stand in the folder `out`.

    `kind` is truth (of the plant; in a closed loop each observer has its own), estimate, measured (as it has arrived and is
    held; of signals that an output shows as they are) or target (of a closed loop). None where it does not stand there and the
    code of an observer of a user's own is not here.
    """
    target = None if out is None else store.target(str(out))
    name = f"examples/{scenario.replace('/', '%2F')}.parquet"
    first = cells(study, scenario)[0]
    key = _key(study, first)
    found = None if target is None else store.get(target, name)
    kept = None if found is None else parquet.whole(found)
    if kept is not None and kept.schema.metadata.get(KEY) == key:
        return kept.to_pandas()
    if any(map(is_absent, [*first.own.values(), *first.scenario.own.values()])):
        return None
    made = _made(study, first)
    if target is not None:
        table = pa.Table.from_pandas(made, preserve_index=False)
        about = {**(table.schema.metadata or {}), KEY: key}
        store.put_table(target, name, parquet.sealed(table.replace_schema_metadata(about)))
    return made


def _key(study: Study, cell: Cell) -> bytes:
    """What an example was made of: the cell, the observers with their options, the run, and the release."""
    options = {o: given.model_dump() for o, given in cell.options.items()}
    said = [cell.digest, options, study.first_seed, provenance.versions(), POINTS]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest().encode()


def _made(study: Study, cell: Cell) -> pd.DataFrame:
    scenario = cell.scenario.name
    axes = {name: [values[0]] for name, values in study.axes.items()}
    here = study.model_copy(update={"scenarios": [scenario], "axes": axes})
    names, closed = list(cell.options), bool(cell.scenario.loop.controller)
    groups = [[name] for name in names] if closed else [names]
    parts = [part for group in groups for part in _series(here, cell, group, closed)]
    return pd.concat(parts, ignore_index=True)


def _series(study: Study, cell: Cell, observers: list[str], closed: bool) -> list[pd.DataFrame]:
    trace = api.trace(study, observers, seed=study.first_seed)
    thin = trace.iloc[:: -(-len(trace) // POINTS)]
    shown = _shown(cell)
    out = []
    for signal, _ in signals_of(cell.scenario):
        columns = {(f"plant under {observers[0]}" if closed else "plant", "truth"): signal}
        columns |= {(o, "estimate"): f"{o}.{signal}" for o in observers}
        columns |= {("target", "target"): f"target.{signal}"} if observers[0] == next(iter(cell.options)) else {}
        columns |= {("measured", "measured"): f"y{shown[signal] + 1}"} if signal in shown and not closed else {}
        for (series, kind), column in columns.items():
            if column in thin:
                values = {"signal": signal, "series": series, "kind": kind, "t": thin.t, "value": thin[column]}
                out.append(pd.DataFrame(values))
    return out


def _shown(cell: Cell) -> dict[str, int]:
    """Which output shows a state as it is, by state."""
    C = setting(cell).model.C
    states = [name for name, _ in signals_of(cell.scenario)]
    return {
        states[j]: i
        for i in range(len(C))
        for j in range(C.shape[1])
        if np.abs(C[i] - np.eye(C.shape[1])[j]).max() < UNIT
    }
