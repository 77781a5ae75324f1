"""What the observers of one cell cost, kept beside its run in time."""

from pathlib import Path

import pandas as pd

from pcbench.planning import drafts, operation_counts
from pcbench.plots.example_cache import Thing, kept
from pcbench.runtime import config
from pcbench.study import Study
from pcbench.study.grid import Cell, cells


def of(study: Study, scenario: str, out: str | Path | None, cell: int = 0) -> pd.DataFrame | None:
    """Return scenario, cell, observer, sample, tick, memory, as `pcbench.operation_counts`; counted if not in `out`.

    None where nothing is sampled, so that there is no cost of a sample; and where an observer's code is not here.
    """
    one = next(each for each in cells(study, scenario) if each.number == cell)
    if one.scenario.sampling.continuous:
        return None
    return kept(out, Thing(f"{scenario}.costs", one, ["of the last sample"]), lambda: _made(one))


def _made(cell: Cell) -> pd.DataFrame:
    head = {"scenario": cell.scenario.name, "cell": cell.number}
    with config.float64():
        found = {label: each for p in drafts([cell]) for label, each in operation_counts.costs(p).items()}
    return pd.DataFrame([head | {"observer": label, **each._asdict()} for label, each in found.items()])
