"""From the blocks of a dataset to its closing tables, stats and pairs, and the record of how they came about.

What they hold is a function of the rows alone: not of how these are cut into files, nor of who computed them. They are written
as they grow, compressed, so that memory hardly grows with the number of cells.
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
from pcbench.dataset.seed_ranges import joined
from pcbench.runtime import provenance
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified

PROVENANCE = "provenance.json"
Key = tuple[str, int]  # a cell's
TOGETHER = 32  # cells whose rows are made at a time
FROM = b"pcbench.from"  # the key in a closing table's metadata: which blocks it was made of
EXACT = "exact"  # the kind of cells without runs


def close(
    target: storage.Target, owned: Owned, there: list[Block], about: dict[str, Any], begun: "Closing | None" = None
) -> None:
    """Write stats.parquet and pairs.parquet of these blocks, and provenance.json with what is said `about` the run.

    `begun` are tables that have grown while the blocks came, if they are of these.
    """
    mine = begun if begun and begun.made_of == {FROM: made_from(target, there)} else Closing(target, owned, there)
    stats, pairs = mine.content()
    storage.put(target, "stats.parquet", stats)
    storage.put(target, "pairs.parquet", pairs)
    study = {
        "schema": columns.SCHEMA,
        "study": owned.study.name,
        "study_sha256": digest(owned.study, owned.cells),
        "root_seed": owned.study.root_seed,
        "blocks": len(there),
        **({"excluded": owned.study.excluded} if owned.study.excluded else {}),
        **({"tuned": owned.study.tuned.model_dump()} if owned.study.tuned else {}),
    }
    digests = {"stats.parquet": digest_of(stats), "pairs.parquet": digest_of(pairs)}
    derived = {"certificates": mine.weakest, "flow": mine.ways, "digests": digests}
    record = provenance.describe() | study | about | derived
    storage.put_json(target, PROVENANCE, record | {"digest": _digest(record)})


def record(target: storage.Target) -> dict[str, Any] | None:
    """Return what provenance.json says; None where it is not there, or not as it was written."""
    said = storage.document(target, PROVENANCE)
    return said if said and said.get("digest") == _digest(said) else None


def _digest(record: dict[str, Any]) -> str:
    text = json.dumps({k: v for k, v in record.items() if k != "digest"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def digest_of(content: pa.Buffer) -> str:
    """Return the digest of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:32]


class Closing:
    """The closing tables as they grow, some cells at a time in the order of the study: while others are computed."""

    def __init__(
        self, target: storage.Target, owned: Owned, there: list[Block], lacking: dict[Key, int] | None = None
    ) -> None:
        """Begin with the blocks that are, or will be, `there`; cells still lack so many runs."""
        self.target, self.study, self.lacking = target, owned.study.name, dict(lacking or {})
        self.made_of = {FROM: made_from(target, there)}
        self.stats, self.pairs = GrowingTable(self.made_of), GrowingTable(self.made_of)
        self.exact = moments_tables.rows_by_cell(target)
        self.weakest: dict[str, dict[str, Any]] = {}  # certificates by scenario and observer
        self.ways: dict[str, dict[str, str]] = {}  # how observers went: lifted, stepped, or both
        self.left = deque(owned.cells)
        self.held: dict[Key, aggregate.Held] = {}  # of cells whose turn is still to come
        self.blocks = block_files.series(block_files.settled(there))

    def done(self, key: Key, runs: int, held: aggregate.Held) -> None:
        """Take in the cells whose turn it is, once these runs of one are there; `held` are blocks that they stand in."""
        if runs == self.lacking[key]:  # of a cell that comes in parts nothing is held
            self.held[key] = held
        self.lacking[key] -= runs
        while self.left and not any(self.lacking.get(c.key) for c in islice(self.left, TOGETHER)):
            self._add_some()

    def content(self) -> tuple[pa.Buffer, pa.Buffer]:
        """Return stats and pairs of all cells, in the order of the study, as the bytes of their files."""
        while self.left:
            self._add_some()
        return self.stats.content(), adjusted(self.pairs.content(), self.made_of)

    def _add_some(self) -> None:
        """Add the next TOGETHER cells, whatever is there of them: where a file's parts end depends on the study alone."""
        each = []
        for cell in [self.left.popleft() for _ in range(min(TOGETHER, len(self.left)))]:
            c = aggregate.of_cell(self.target, cell, self.blocks, self.held.pop(cell.key, aggregate.NONE))
            self._note(c)
            runs = aggregate.only_chunk(c) if c.blocks and cell.key not in self.exact else None
            if c.blocks or cell.key in self.exact:
                each.append(((runs and aggregate.kind(c, runs)) if c.blocks else EXACT, c, runs))
        for kind, group in groupby(each, key=itemgetter(0)):
            _, cells, runs_of_cells = zip(*group, strict=True)
            if kind is None:
                for c in cells:
                    self._add(*self._with_exact(c))
            elif kind == EXACT:
                rows = pa.concat_tables([self.exact[c.cell.key] for c in cells])
                self._add(rows, moments_tables.pairs(rows))
            else:
                self._add(*aggregate.rows_of_cells(self.study, list(cells), list(runs_of_cells)))

    def _add(self, stats: pa.Table, pairs: pa.Table) -> None:
        self.stats.add(stats)
        self.pairs.add(pairs)

    def _with_exact(self, c: aggregate.CellBlocks) -> tuple[pa.Table, pa.Table]:
        """The rows of a cell by itself, of which some observers may be exact: those of runs say why they are not."""
        stats, pairs = aggregate.rows_of(self.study, c)
        exact = self.exact.get(c.cell.key)
        if exact is None:
            return stats, pairs
        each = zip(*(exact[name].to_pylist() for name in ("observer", "metric", "reason")), strict=True)
        why = {observer: reason for observer, metric, reason in each if metric == "mse"}
        stats = parquet_io.with_column(stats, "reason", [why.get(name) for name in stats["observer"].to_pylist()])
        without = pa.array([name not in c.blocks for name in exact["observer"].to_pylist()])
        rows = pa.concat_tables([exact.filter(without), stats])
        place = {name: i for i, name in enumerate(c.cell.options)}
        order = np.argsort([place[name] for name in rows["observer"].to_pylist()], kind="stable")
        return rows.take(order), pa.concat_tables([pairs, moments_tables.pairs(exact)])

    def _note(self, c: aggregate.CellBlocks) -> None:
        """Note certificates and ways."""
        for name, about in c.about.items():
            mine = self.weakest.setdefault(c.cell.scenario.name, {})
            mine[name] = min(mine.get(name, about["certificate"]), about["certificate"], key=_strength)
            went, way = self.ways.setdefault(c.cell.scenario.name, {}), about["flow"]
            went[name] = way if went.get(name, way) == way else "both"


def adjusted(content: pa.Buffer, about: dict[bytes, bytes]) -> pa.Buffer:
    """Put Holm's adjusted p-values into the rows of pairs: one family a scenario, signal and metric.

    A whole table's are known only when its last row is.
    """
    file, out = parquet_io.opened(content), GrowingTable(about)
    table = file.read(["scenario", "signal", "metric", "p_value"], use_threads=False)
    family = np.zeros(len(table), int)
    for name in ("scenario", "signal", "metric"):
        words = table[name].combine_chunks().dictionary_encode()
        family = family * len(words.dictionary) + words.indices.to_numpy()
    order, p = np.argsort(family, kind="stable"), table["p_value"].to_numpy().copy()
    for rows in np.split(order, np.flatnonzero(np.diff(family[order])) + 1):
        p[rows] = statistics.holm(p[rows])
    start = 0
    for i in range(file.num_row_groups):
        part = file.read_row_group(i, use_threads=False)
        out.add(parquet_io.with_column(part, "p_holm", p[start : start + len(part)]))
        start += len(part)
    return out.content()


def _strength(certificate: dict[str, Any]) -> float:
    """What orders certificates: gains that nothing proves are weaker than all that something does."""
    margin = certificate["margin"]
    return -np.inf if is_certified(certificate) is False else np.inf if margin is None else margin


def made_from(target: storage.Target, there: list[Block]) -> bytes:
    """Return a digest of what closing tables are made of: which runs, however they are cut, and exact rows if there are any."""
    ranges = {
        key: joined(b.seeds for b in mine) for key, mine in block_files.series(block_files.settled(there)).items()
    }
    text = repr([(s, observer, cell, *seeds) for (s, cell, observer), each in ranges.items() for seeds in each])
    runs, exact = hashlib.sha256(text.encode()).hexdigest().encode(), storage.get(target, moments_tables.NAME)
    return runs if exact is None else runs + digest_of(exact).encode()


def damaged(target: storage.Target) -> list[str]:
    """Return the closing files that are there, but not as they were written."""
    said = record(target)
    if said is None:
        return [PROVENANCE] if storage.get(target, PROVENANCE) is not None else []
    return [name for name in said["digests"] if storage.get(target, name) is not None and table(target, name) is None]


def is_closed(target: storage.Target, there: list[Block]) -> bool:
    """Return whether the closing tables stand, and are of these blocks."""
    mark = made_from(target, there)
    every = [table(target, name) for name in ("stats.parquet", "pairs.parquet")]
    about = [{} if each is None else parquet_io.metadata(each) for each in every]
    return all(each.get(FROM) == mark and columns.has_schema(each) for each in about)


def table(target: storage.Target, name: str) -> pa.Table | None:
    """Return a closing table; None where it is not there, or not as it was written: every byte counts."""
    content, said = storage.get(target, name), record(target)
    if content is None or said is None or said["digests"].get(name) != digest_of(content):
        return None
    try:
        return parquet_io.parsed(content)
    except parquet_io.DAMAGE:
        return None
