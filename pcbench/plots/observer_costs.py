"""Data for the figure of operation counts, per observer of one cell; the figure is `lines.cost`."""

from pathlib import Path

import pandas as pd

from pcbench.planning import drafts, operation_counts
from pcbench.plots import example_cache
from pcbench.runtime import config
from pcbench.study import Study
from pcbench.study.grid import cells


def frame_of(study: Study, scenario: str, out: str | Path | None, cell: int = 0) -> pd.DataFrame | None:
    """Return scenario, cell, observer, sample, tick, memory, as `pcbench.operation_counts`; counted if not in `out`.

    None if the scenario has continuous measurements, or if the code of an observer is not loaded.
    """
    grid_point = next(c for c in cells(study, scenario) if c.number == cell)
    if grid_point.scenario.sampling.continuous:
        return None
    entry = example_cache.CacheEntry(f"{scenario}.costs", grid_point, ["of the last sample"])
    costs = example_cache.load_table(out, entry)
    if costs is not None or not entry.is_computable:
        return costs
    with config.float64():
        counts = {label: cost for p in drafts([grid_point]) for label, cost in operation_counts.costs(p).items()}
    head = {"scenario": grid_point.scenario.name, "cell": cell}
    rows = [head | {"observer": label, **cost._asdict()} for label, cost in counts.items()]
    return example_cache.store(out, entry, pd.DataFrame(rows))
