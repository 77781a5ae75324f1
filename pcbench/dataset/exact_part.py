"""What of a study is exact, as files: `exact.parquet`, rows as in stats, and `moments/`, means and deviations over time.

They are made before anything is simulated, once for a study: they say which observers of which cells are left to runs. A cell's
moments are at ticks 0 .. N, of long horizons at every so many that `POINTS` are left, about.
"""

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from pcbench.dataset import columns, ownership, parquet, store
from pcbench.dataset.ownership import Owned
from pcbench.machine import pools, provenance
from pcbench.machine.progress import SILENT, Progress
from pcbench.study.as_toml import digest
from pcbench.study.cells import Grid

if TYPE_CHECKING:
    from pcbench.dataset.exact import Exact

NAME, FOLDER = "exact.parquet", "moments"

OF = b"pcbench.of"  # the key in its metadata: of which study it is
POINTS = 1000
WRITERS = 4  # files under way at a time: a cell's takes 1 ms to make and 5 to reach the disk
SAID = 3  # refusals that are said
Row = dict[str, Any]


def made(target: store.Target, owned: Owned, say: Callable[[str], None], progress: Progress = SILENT) -> bool:
    """Make the exact part of a study, unless it stands; return whether it was made, and `say` what has no exact answer."""
    mark = of(owned)
    there = whole(target)
    if there is not None and not owned.fresh and (there.schema.metadata or {}).get(OF) == mark:
        return False
    ownership.begin(target, owned)
    for name in [n for n in store.names(target) if n == NAME or n.startswith(FOLDER)]:
        store.remove(target, name)
    from pcbench.dataset.exact import Exact  # takes half a second, with pandas, which a study of runs does not wait for

    exact = Exact(Grid(owned.study, owned.cells), owned.study.schedules)
    rows: list[Row] = []
    progress.begin("exact cells", len(owned.cells))
    _put(target, _cells(owned, exact, rows, progress))
    refused = list(dict.fromkeys(row["reason"] for row in rows if row["metric"] == "mse" and row["reason"]))
    for sentence in refused[:SAID]:
        say(sentence)
    if refused[SAID:]:
        say(f"{target.name}: {len(refused) - SAID} more have no exact answer; the column reason of stats says why.")
    table = columns.rows_table(rows, columns.stats_order(columns.axes_of(rows[0])))
    store.put_table(
        target, NAME, parquet.sealed(table.replace_schema_metadata((table.schema.metadata or {}) | {OF: mark}))
    )
    return True


def _cells(owned: Owned, exact: "Exact", rows: list[Row], progress: Progress) -> Iterator[tuple[str, pa.Table]]:
    """Yield the files of moments, name and table each; `rows` gets what is known of every cell."""
    for key, parts in itertools.groupby(exact.solved(owned.cells, "std"), key=lambda m: m.planned.cell.key):
        frames: list[dict[str, Any]] = []
        for m in parts:
            rows += exact.rows(m)
            frames += exact.over_time(m, max(1, m.planned.cell.times.ticks // POINTS))
        if frames:
            yield place(*key), columns.table({name: _column([f[name] for f in frames]) for name in frames[0]})
        progress.step(1)


def _column(parts: list[Any]) -> Any:
    """One column of several parts; of words each part is one word."""
    if parts[0].dtype != object:
        return np.concatenate(parts)
    return columns.words([part[0] for part in parts], np.repeat(np.arange(len(parts)), [len(part) for part in parts]))


def _put(target: store.Target, files: Iterator[tuple[str, pa.Table]]) -> None:
    """Put files while the next are made: what they wait for is the disk."""
    with pools.pool(WRITERS) as threads:
        waiting: deque[Future[None]] = deque()
        for name, table in files:
            waiting.append(threads.submit(lambda n, t: store.put_table(target, n, parquet.sealed(t)), name, table))
            if len(waiting) > 2 * WRITERS:
                waiting.popleft().result()
        for each in waiting:
            each.result()


def whole(target: store.Target) -> pa.Table | None:
    """Return the exact rows of a dataset; None where it has none, or not as they were written."""
    content = store.get(target, NAME)
    return None if content is None else parquet.whole(content)


def rows_by_cell(target: store.Target) -> dict[tuple[str, int], list[Row]]:
    """Return the exact rows of a dataset by cell."""
    there, out = whole(target), dict[tuple[str, int], list[Row]]()
    for row in there.to_pylist() if there is not None else []:
        out.setdefault((row["scenario"], row["cell"]), []).append(row)
    return out


def simulated(target: store.Target, owned: Owned) -> Owned:
    """Return the study with what is left of it to simulate: all of it, nothing, or what has no exact number."""
    method = owned.study.method
    if method == "runs":
        return owned
    if method == "exact":
        return owned._replace(cells=[])
    exact = {
        (*key, row["observer"])
        for key, rows in rows_by_cell(target).items()
        for row in rows
        if row["method"] == "exact"
    }
    cells = [
        c._replace(options={o: given for o, given in c.options.items() if (*c.key, o) not in exact})
        for c in owned.cells
    ]
    return owned._replace(cells=[c for c in cells if c.options])


def pairs(rows: list[Row]) -> list[Row]:
    """Return the rows of `pairs` of one cell: differences of exact numbers, where no schedule is random."""
    each: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["method"] == "exact" and not row["n"]:
            each.setdefault((row["signal"], row["metric"]), []).append(row)
    out = []
    for (_, _), mine in each.items():
        for a, b in itertools.combinations(mine, 2):
            apart = a["mean"] - b["mean"]
            same = abs(apart) <= 1e-9 * max(abs(a["mean"]), abs(b["mean"]))
            of_both = {f"{what}_{side}": row[what] for side, row in (("a", a), ("b", b)) for what in ABOUT}
            known = {"mean_diff": apart, "se": 0.0, "ci_low": apart, "ci_high": apart}
            unknown = {"prob_a_better": 0.5 if same else np.nan, "p_value": np.nan, "p_holm": np.nan}
            out.append(a | of_both | known | unknown)
    return out


ABOUT = ("observer", "carries_input", "certified")


def place(scenario: str, cell: int) -> str:
    """Return the name of a cell's file of moments."""
    return f"{FOLDER}/scenario={scenario.replace('/', '%2F')}/cell={cell}.parquet"


def of(owned: Owned) -> bytes:
    """Return the mark of a study and of these releases; it is the same for all seeds, as exact numbers are."""
    study = owned.study.model_copy(update={"first_seed": 0, "seeds": 1})
    return f"{digest(study, owned.cells)} {sorted(provenance.versions().items())}".encode()
