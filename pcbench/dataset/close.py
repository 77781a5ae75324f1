"""From the blocks of a dataset to its closing tables, stats and pairs, and the record of how they came about.

What they hold is a function of the rows alone: not of how these are cut into files, nor of who computed them. They are written
as they grow, compressed, so that memory hardly grows with the number of cells.

Holm's adjusted p-values of a whole table of pairs, which is known only when its last row is.
"""

import hashlib
import json
from collections import deque
from itertools import groupby, islice
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow as pa

from pcbench import statistics
from pcbench.dataset import aggregate, block_files, columns, moments_tables, parquet_io, storage
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import Owned
from pcbench.dataset.parquet_io import GrowingTable
from pcbench.dataset.seed_ranges import Seeds, joined
from pcbench.dataset.table_builder import Frame
from pcbench.runtime import provenance
from pcbench.study.grid import Cell
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified


def adjusted(content: pa.Buffer, about: dict[bytes, bytes]) -> pa.Buffer:
    """Put Holm's adjusted p-values into the rows of pairs: one family a scenario, signal and metric."""
    file = parquet_io.opened(content)
    families: dict[tuple[str, ...], list[float]] = {}
    keys = ["scenario", "signal", "metric"]
    for batch in file.iter_batches(columns=[*keys, "p_value"], use_threads=False):
        for *family, p in zip(*(batch[c].to_pylist() for c in [*keys, "p_value"]), strict=True):
            families.setdefault(tuple(family), []).append(np.nan if p is None else p)
    after = {family: iter(statistics.holm(np.array(p))) for family, p in families.items()}
    out = GrowingTable(about)
    for i in range(file.num_row_groups):
        table = file.read_row_group(i, use_threads=False)
        mine = zip(*(table[c].to_pylist() for c in keys), strict=True)
        column = pa.array([float(next(after[family])) for family in mine], pa.float64(), from_pandas=True)
        target = table.schema.get_field_index("p_holm")
        out.add(table.set_column(target, table.schema.field(target), column))
    return out.content()


PROVENANCE = "provenance.json"
Key = tuple[str, int]  # a cell's
Rows = dict[str, list[Any]]  # by column
TOGETHER = 32  # cells whose rows are made at a time
FROM = b"pcbench.from"  # the key in a closing table's metadata: which blocks it was made of


def close(
    target: storage.Target, owned: Owned, there: list[Block], about: dict[str, Any], begun: "Closing | None" = None
) -> None:
    """Write stats.parquet and pairs.parquet of these blocks, and provenance.json with what is said `about` the run.

    `begun` are tables that have grown while the blocks came, if they are of these.
    """
    mine = begun if begun and begun.made_of == {FROM: fingerprint(there)} else Closing(target, owned, there)
    stats, pairs, weakest, ways = mine.content()
    storage.put(target, "stats.parquet", stats)
    storage.put(target, "pairs.parquet", pairs)
    digests = {"stats.parquet": digest_of(stats), "pairs.parquet": digest_of(pairs)}
    study = {
        "schema": columns.SCHEMA,
        "study": owned.study.name,
        "study_sha256": digest(owned.study, owned.cells),
        "root_seed": owned.study.root_seed,
        "blocks": len(there),
        **({"excluded": owned.study.excluded} if owned.study.excluded else {}),
        **({"tuned": owned.study.tuned.model_dump()} if owned.study.tuned else {}),
    }
    said = provenance.describe() | study | about | {"certificates": weakest, "flow": ways, "digests": digests}
    storage.put_json(target, PROVENANCE, said | {"digest": _digest(said)})


def record(target: storage.Target) -> dict[str, Any] | None:
    """Return what provenance.json says; None where it is not there, or not as it was written."""
    said = storage.document(target, PROVENANCE)
    return said if said and said.get("digest") == _digest(said) else None


def _digest(said: dict[str, Any]) -> str:
    text = json.dumps({k: v for k, v in said.items() if k != "digest"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def digest_of(content: pa.Buffer) -> str:
    """Return the digest of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:32]


def closing_tables(target: storage.Target, owned: Owned, there: list[Block]) -> tuple[pa.Buffer, pa.Buffer]:
    """Return stats and pairs as the bytes of their files.

    Cells are taken in the order of the study, those without runs left out.
    """
    return Closing(target, owned, there).content()[:2]


class Closing:
    """The closing tables as they grow, some cells at a time in the order of the study: while others are computed."""

    def __init__(
        self, target: storage.Target, owned: Owned, there: list[Block], lacking: dict[Key, int] | None = None
    ) -> None:
        """Begin with the blocks that are, or will be, `there`; cells still lack so many runs."""
        self.target, self.owned, self.lacking = target, owned, dict(lacking or {})
        self.made_of = {FROM: made_from(target, there)}
        self.stats, self.pairs = GrowingTable(self.made_of), GrowingTable(self.made_of)
        self.exact = moments_tables.rows_by_cell(target)
        self.weakest: dict[str, dict[str, Any]] = {}
        self.ways: dict[str, dict[str, str]] = {}
        self.left = deque(owned.cells)
        self.waits = self._waiting()
        self.held: dict[Key, aggregate.Held] = {}  # of cells whose turn is still to come
        self.blocks: dict[tuple[str, int, str], list[Block]] = {}
        for b in sorted(block_files.settled(there)):
            self.blocks.setdefault((b.scenario, b.cell, b.observer), []).append(b)

    def done(self, key: Key, runs: int, held: aggregate.Held) -> None:
        """Take in the cells whose turn it is, once these runs of one are there; `held` are blocks that they stand in."""
        if runs == self.lacking[key]:  # of a cell that comes in parts nothing is held
            self.held[key] = held
        self.lacking[key] -= runs
        if not self.lacking[key]:
            self.waits.discard(key)
        while not self.waits and self.left:
            self._add_some()
            self.waits = self._waiting()

    def content(self) -> tuple[pa.Buffer, pa.Buffer, dict[str, dict[str, Any]], dict[str, dict[str, str]]]:
        """Return the tables of all cells, the weakest certificates, and how observers went: lifted, stepped, or both."""
        while self.left:
            self._add_some()
        return self.stats.content(), adjusted(self.pairs.content(), self.made_of), self.weakest, self.ways

    def _waiting(self) -> set[Key]:
        """Those of the next cells that lack runs."""
        return {c.key for c in islice(self.left, TOGETHER) if self.lacking.get(c.key)}

    def _add_some(self) -> None:
        """Add the next TOGETHER cells, whatever is there of them: where a file's parts end depends on the study alone."""
        cells = [self.left.popleft() for _ in range(min(TOGETHER, len(self.left)))]
        each = [
            (cell, aggregate.observed(self.target, cell, self.blocks, self.held.pop(cell.key, {}))) for cell in cells
        ]
        for alike, some in groupby(map(self._with_runs, each), key=itemgetter(0)):
            for cell, found, _ in (group := [one for _, one in some]):
                self._note(cell, found)
            if alike is None:
                for cell, found, _ in group:
                    self._add_one(cell, found)
            else:
                self._put(
                    group[0][0], *aggregate.rows_of_cells(self.owned.study.name, [runs for *_, runs in group if runs])
                )

    def _with_runs(self, one: tuple[Cell, aggregate.Found]) -> tuple[Any, tuple[Cell, aggregate.Found, Any]]:
        """A cell with its runs and their kind, by which it is put together with others; None where it is not."""
        cell, found = one
        runs = aggregate.few(self.target, cell, found) if found and cell.key not in self.exact else None
        return runs and aggregate.kind(runs), (cell, found, runs)

    def _add_one(self, cell: Cell, found: aggregate.Found) -> None:
        known = self.exact.get(cell.key)
        if not known:
            if found:
                self._put(cell, *aggregate.rows_of(self.target, self.owned.study.name, cell, found))
            return
        stats, pairs = (
            columns.stats_order(columns.axes_of(cell.values)),
            columns.pairs_order(columns.axes_of(cell.values)),
        )
        rows, compared = known, moments_tables.pairs(known, pairs)
        if found:
            mine = aggregate.rows_of(self.target, self.owned.study.name, cell, found)
            rows = _both(known, mine[0].table(stats).to_pydict(), found)
            compared = columns.together([mine[1].table(pairs).to_pydict(), compared])
        self.stats.add_columns(_in_order(cell, {name: rows[name] for name in stats}))
        self.pairs.add_columns(compared)

    def _put(self, cell: Cell, stats: Frame, pairs: Frame) -> None:
        """Add rows of this cell, and of others of its kind."""
        self.stats.add(stats.table(columns.stats_order(columns.axes_of(cell.values))))
        self.pairs.add(pairs.table(columns.pairs_order(columns.axes_of(cell.values))))

    def _note(self, cell: Cell, found: aggregate.Found) -> None:
        """Note certificates and ways."""
        mine = self.weakest.setdefault(cell.scenario.name, {}) if found else {}
        went = self.ways.setdefault(cell.scenario.name, {}) if found else {}
        for name, each in found.items():
            c, way = each.about["certificate"], each.about["flow"]
            mine[name] = min(mine.get(name, c), c, key=_strength)
            went[name] = way if went.get(name, way) == way else "both"


def _both(known: Rows, simulated: Rows, found: aggregate.Found) -> Rows:
    """Rows of stats of a cell of which some observers are exact: those of runs say why they are not."""
    each = zip(known["observer"], known["metric"], known["reason"], strict=True)
    why = {observer: reason for observer, metric, reason in each if metric == "mse"}
    here = [at for at, name in enumerate(known["observer"]) if name not in found]
    exact = {name: [values[at] for at in here] for name, values in known.items()}
    return columns.together([exact, simulated | {"reason": [why.get(name) for name in simulated["observer"]]}])


def _in_order(cell: Cell, rows: Rows) -> Rows:
    """Rows of stats with observers in the order of the study."""
    order = {name: i for i, name in enumerate(cell.options)}
    places = [order[name] for name in rows["observer"]]
    if places == sorted(places):
        return rows
    turn = sorted(range(len(places)), key=places.__getitem__)
    return {name: [values[at] for at in turn] for name, values in rows.items()}


def _strength(certificate: dict[str, Any]) -> float:
    """What orders certificates: gains that nothing proves are weaker than all that something does."""
    margin = certificate["margin"]
    return -np.inf if is_certified(certificate) is False else np.inf if margin is None else margin


def fingerprint(there: list[Block]) -> bytes:
    """Return a digest of which runs there are, the same however they are cut into blocks."""
    ranges: dict[tuple[str, str, int], list[Seeds]] = {}
    for b in block_files.settled(there):
        ranges.setdefault(b[:3], []).append(b.seeds)
    whole = [(*key, *seeds) for key, each in ranges.items() for seeds in joined(each)]
    return hashlib.sha256(repr(whole).encode()).hexdigest().encode()


def made_from(target: storage.Target, there: list[Block]) -> bytes:
    """Return a digest of what closing tables are made of: of runs, and of exact rows where there are any."""
    runs, exact = fingerprint(there), storage.get(target, moments_tables.NAME)
    return runs if exact is None else runs + digest_of(exact).encode()


def damaged(target: storage.Target) -> list[str]:
    """Return the closing files that are there, but not as they were written."""
    said = record(target)
    if said is None:
        return [PROVENANCE] if storage.get(target, PROVENANCE) is not None else []
    return [name for name in said["digests"] if storage.get(target, name) is not None and table(target, name) is None]


def is_closed(target: storage.Target, there: list[Block]) -> bool:
    """Return whether the closing tables stand, and are of these blocks."""
    for name in ("stats.parquet", "pairs.parquet"):
        found = table(target, name)
        said = {} if found is None else found.schema.metadata or {}
        if said.get(FROM) != made_from(target, there) or not columns.has_schema(said):
            return False
    return True


def table(target: storage.Target, name: str) -> pa.Table | None:
    """Return a closing table; None where it is not there, or not as it was written: every byte counts."""
    content, said = storage.get(target, name), record(target)
    if content is None or said is None or said["digests"].get(name) != digest_of(content):
        return None
    try:
        return parquet_io.parsed(content)
    except (pa.ArrowException, OSError, ValueError):
        return None
