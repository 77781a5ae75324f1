"""Do exact numbers come out again? Those of some cells are computed anew, and must be the same but for rounding.

The last bits of a cell may depend on the cells that it shares a call with, so exact numbers are not compared bit for bit.
"""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pcbench.dataset import columns, moments_tables, storage
from pcbench.dataset.exact_merge import agree
from pcbench.dataset.manifest import Owned
from pcbench.study.grid import Cell, Grid


def differing(target: storage.Target, owned: Owned, sample: int | None, seed: int) -> tuple[list[str], list[str]]:
    """Return which cells were computed again, `sample` drawn with `seed` (None: all), and a sentence for each that differs."""
    there = moments_tables.whole(target)
    if there is None or sample == 0:
        return [], []
    cells = owned.cells
    if sample is not None and sample < len(cells):
        cells = [cells[i] for i in sorted(np.random.default_rng(seed).choice(len(cells), sample, replace=False))]
    from pcbench.dataset.moments_frames import Exact

    exact = Exact(Grid(owned.study, cells), owned.study.schedules)
    here = columns.with_intervals(columns.table(columns.together(exact.rows(m) for m in exact.solved(cells))))
    said = [
        f"{moments_tables.NAME}: {_called(c)}: other numbers come out now." for c in cells if not _same(there, here, c)
    ]
    return [_called(c) for c in cells], said


def _called(cell: Cell) -> str:
    return f"{cell.scenario.name}, cell {cell.number}"


def _same(there: pa.Table, here: pa.Table, cell: Cell) -> bool:
    """Whether the rows of a cell are the same but for rounding; a reason may say a number, which is rounded too."""
    scenario, number = cell.key
    old, new = (
        t.filter((pc.field("scenario") == scenario) & (pc.field("cell") == number)).drop_columns(["reason"])
        for t in (there, here)
    )
    return agree(old, new)
