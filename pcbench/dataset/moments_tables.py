"""The exact results of a study as files: `exact.parquet` with rows as in stats, and `moments/` over time.

They are computed once for a study, before the simulations, and determine which observers of which cells need runs. The
moments of a cell are at ticks 0 .. N; over a long duration only about `POINTS` ticks are stored. A study of more than
`MAX_CELLS` cells has no `moments/`, because writing a file per cell would take most of the time.
"""

import itertools
import re
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench.dataset import columns, manifest, parquet_io, storage
from pcbench.dataset.manifest import StudyClaim
from pcbench.runtime import provenance, thread_pools
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.grid import Grid
from pcbench.study.serialize import digest

if TYPE_CHECKING:
    from pcbench.dataset.moments_frames import Exact

NAME, FOLDER = "exact.parquet", "moments"
OVER_TIME = re.compile(rf"{FOLDER}/scenario=[^/]+/cell=\d+\.parquet")
OF = b"pcbench.of"  # key of the study's digest (`mark_of`) in the metadata
POINTS = 1000
MAX_CELLS = 1000  # cells of a study whose moments over time are kept
WRITERS = 4  # threads that write: a file takes 1 ms to compute and 5 ms to reach the disk
MAX_REFUSALS = 3  # reported refusals


def make(
    target: storage.Target, claim: StudyClaim, on_warning: Callable[[str], None], progress: Progress = SILENT
) -> bool:
    """Compute the exact results of a study if they are missing; return whether it did. `on_warning` gets what is not exact."""
    mark = mark_of(claim)
    old_table = load_exact_rows(target)
    if old_table is not None and not claim.overwrite and parquet_io.metadata(old_table).get(OF) == mark:
        return False
    manifest.begin(target, claim)
    for name in [n for n in storage.file_names(target) if n == NAME or OVER_TIME.fullmatch(n)]:
        storage.remove(target, name)
    from pcbench.dataset.moments_frames import Exact  # imports pandas, which studies of runs do not need

    exact = Exact(Grid(claim.study, claim.cells), claim.study.schedules)
    parts: list[dict[str, object]] = []  # rows by column, of all cells
    progress.begin("exact cells", len(claim.cells))
    with thread_pools.pool(WRITERS, always_wait=True) as threads:  # the next are computed while files wait for the disk
        futures: deque[Future[None]] = deque()
        for name, table in _over_time(claim, exact, parts, progress):
            futures.append(threads.submit(storage.write_table, target, name, parquet_io.seal_table(table)))
            if len(futures) > 2 * WRITERS:
                futures.popleft().result()
        for future in futures:
            future.result()
    rows = columns.concat_columns(parts)
    reasons = np.asarray(rows["reason"])[np.asarray(rows["metric"]) == "mse"]
    refusals = list(dict.fromkeys(filter(None, reasons)))
    for sentence in refusals[:MAX_REFUSALS]:
        on_warning(sentence)
    if refusals[MAX_REFUSALS:]:
        on_warning(
            f"{target.name}: {len(refusals) - MAX_REFUSALS} more have no exact value; the column reason of stats shows why."
        )
    table = parquet_io.with_metadata(columns.with_intervals(columns.table(rows)), {OF: mark})
    storage.write_table(target, NAME, parquet_io.seal_table(table))
    return True


def _over_time(
    claim: StudyClaim, exact: "Exact", rows: list[dict[str, object]], progress: Progress
) -> Iterator[tuple[str, pa.Table]]:
    """Yield the files of moments, name and table each; `rows` gets the rows of every cell, by column."""
    moments = exact.solve_cells(claim.cells, "std" if len(claim.cells) <= MAX_CELLS else "", POINTS)
    for key, parts in itertools.groupby(moments, key=lambda m: m.plan.cell.key):
        frames: list[dict[str, NDArray[np.generic]]] = []
        for m in parts:
            rows += exact.rows(m)
            frames += exact.over_time(m, POINTS)
        if frames:
            part = np.repeat(np.arange(len(frames)), [len(f["t"]) for f in frames])
            words = {name: columns.words([str(f[name][0]) for f in frames], part) for name in ("observer", "signal")}
            numbers = {name: np.concatenate([f[name] for f in frames]) for name in ("t", "mean", "std")}
            yield moments_file(*key), columns.table(words | numbers)
        progress.step(1)


def load_exact_rows(target: storage.Target) -> pa.Table | None:
    """Return the exact rows of a dataset; None if there are none, or if they were changed."""
    return parquet_io.unseal_table(storage.read_buffer(target, NAME))


def rows_by_cell(target: storage.Target) -> dict[tuple[str, int], pa.Table]:
    """Return the exact rows of a dataset by cell, as parts of one table."""
    table = load_exact_rows(target)
    if table is None or not len(table):
        return {}
    by_name = {name: column.combine_chunks() for name, column in zip(table.column_names, table.columns, strict=True)}
    lists = {
        name: column.cast(pa.list_(pa.float64())) for name, column in by_name.items() if pa.types.is_list(column.type)
    }
    table = columns.with_intervals(columns.table(by_name | lists))
    codes, numbers = by_name["scenario"].dictionary_encode().indices.to_numpy(), by_name["cell"].to_numpy()
    starts = np.flatnonzero(np.diff(codes, prepend=-1) | np.diff(numbers, prepend=-1)).tolist()
    parts = [table[start:stop] for start, stop in itertools.pairwise([*starts, len(table)])]
    return {(part["scenario"][0].as_py(), part["cell"][0].as_py()): part for part in parts}


def select_simulations(target: storage.Target, claim: StudyClaim) -> StudyClaim:
    """Return the part of the study to simulate: all of it, nothing, or the observers without an exact number."""
    if claim.study.evaluation == "runs":
        return claim
    if claim.study.evaluation == "exact":
        return claim._replace(cells=[])
    table = load_exact_rows(target)
    rows = [] if table is None else table.select(["scenario", "cell", "observer", "method"]).to_pylist()
    exact = {(row["scenario"], row["cell"], row["observer"]) for row in rows if row["method"] == "exact"}
    options = [{o: values for o, values in c.options.items() if (*c.key, o) not in exact} for c in claim.cells]
    return claim._replace(cells=[c._replace(options=o) for c, o in zip(claim.cells, options, strict=True) if o])


def pairs(rows: pa.Table) -> pa.Table:
    """Return rows of `pairs`: differences of the exact numbers of each cell whose schedules are not random."""
    groups: dict[tuple[object, ...], list[int]] = {}
    about = ("method", "n", "scenario", "cell", "signal", "metric")
    for i, (method, n, *key) in enumerate(zip(*(rows[name].to_pylist() for name in about), strict=True)):
        if method == "exact" and not n:
            groups.setdefault(tuple(key), []).append(i)
    index = np.array(
        [pair for group in groups.values() for pair in itertools.combinations(group, 2)], np.int64
    ).reshape(-1, 2)
    a, b = (rows["mean"].to_numpy()[index[:, side]] for side in (0, 1))
    diff, nan = a - b, np.full(len(index), np.nan)
    is_tie = np.abs(diff) <= 1e-9 * np.maximum(np.abs(a), np.abs(b))
    out: dict[str, Any] = {"mean_diff": diff, "se": np.zeros(len(index)), "ci_low": diff, "ci_high": diff}
    out |= {"prob_a_better": np.where(is_tie, 0.5, np.nan), "p_value": nan, "p_holm": nan}
    sides = [rows.take(pa.array(index[:, side])) for side in (0, 1)]
    for name in ("observer", "predicts_unknown_input", "certified"):
        out |= {f"{name}_{side}": part[name].combine_chunks() for side, part in zip("ab", sides, strict=True)}
    order = columns.pairs_order(columns.axes_of(rows.column_names))
    return columns.with_intervals(
        columns.table({name: out[name] if name in out else sides[0][name].combine_chunks() for name in order})
    )


def moments_file(scenario: str, cell: int) -> str:
    """Return the name of a cell's file of moments."""
    return f"{FOLDER}/scenario={scenario.replace('/', '%2F')}/cell={cell}.parquet"


def mark_of(claim: StudyClaim) -> bytes:
    """Return a digest of a study and of the releases in use; it is the same for all seeds, as exact numbers are."""
    study = claim.study.model_copy(update={"first_seed": 0, "seeds": 1})
    return f"{digest(study, claim.cells)} {sorted(provenance.versions().items())}".encode()
