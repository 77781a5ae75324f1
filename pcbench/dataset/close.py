"""The closing tables of a dataset, stats and pairs, and the record of their computation.

Their content depends only on the rows of the blocks, and not on the size of the blocks or on the machine. They are
written in compressed parts, so the memory hardly grows with the number of cells.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from pcbench import statistics
from pcbench.dataset import aggregate, block_files, columns, moments_tables, parquet_io, storage
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.parquet_io import GrowingTable
from pcbench.dataset.seed_ranges import merge_ranges
from pcbench.runtime import provenance
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import is_certified

PROVENANCE = "provenance.json"
Key = tuple[str, int]  # a cell's
ByObserver = dict[str, dict[str, storage.Json]]  # a record by scenario and observer
BATCH = 32  # cells whose rows are computed at a time
FROM = b"pcbench.from"  # key of the `input_digest` in a closing table's metadata
EXACT = "exact"  # the kind of cells without runs


class ClosingTables(NamedTuple):
    """The tables that follow from the blocks of a dataset."""

    blocks: int
    stats: pa.Buffer  # the bytes of their files
    pairs: pa.Buffer
    certificates: ByObserver  # the weakest, by scenario and observer


def close(target: storage.Target, claim: StudyClaim, tables: ClosingTables, about: Mapping[str, object]) -> None:
    """Write stats.parquet, pairs.parquet, and provenance.json with the facts `about` the run."""
    storage.write_file(target, "stats.parquet", tables.stats)
    storage.write_file(target, "pairs.parquet", tables.pairs)
    study = {
        "schema": columns.SCHEMA,
        "study": claim.study.name,
        "study_sha256": digest(claim.study, claim.cells),
        "root_seed": claim.study.root_seed,
        "engines": sorted({cell.engine for cell in claim.cells}),
        "blocks": tables.blocks,
        **({"excluded": claim.study.excluded} if claim.study.excluded else {}),
        **({"tuned": claim.study.tuned.model_dump()} if claim.study.tuned else {}),
    }
    digests = {"stats.parquet": digest_of(tables.stats), "pairs.parquet": digest_of(tables.pairs)}
    derived = {"certificates": tables.certificates, "digests": digests}
    record = provenance.describe() | study | dict(about) | derived
    storage.write_json(target, PROVENANCE, record | {"digest": _digest(record)})


def closing_tables(target: storage.Target, claim: StudyClaim, blocks: list[Block]) -> ClosingTables:
    """Return the tables of all cells in the order of the study, whose parts end at places that only the study decides."""
    mark = {FROM: input_digest(target, blocks)}
    stats, pairs = GrowingTable(mark), GrowingTable(mark)
    exact, by_cell = moments_tables.rows_by_cell(target), block_files.series(block_files.drop_overlaps(blocks))
    weakest: ByObserver = {}
    for first in range(0, len(claim.cells), BATCH):
        cells = [aggregate.of_cell(target, cell, by_cell) for cell in claim.cells[first : first + BATCH]]
        for c in cells:
            for name, about in c.about.items():
                certificate: storage.Json = about["certificate"]
                certificates = weakest.setdefault(c.cell.scenario.name, {})
                certificates[name] = min(certificates.get(name, certificate), certificate, key=_strength)
        for some_stats, some_pairs in _rows(claim.study.name, cells, exact):
            stats.add(some_stats)
            pairs.add(some_pairs)
    return ClosingTables(len(blocks), stats.content(), adjust_pairs(pairs.content(), mark), weakest)


def _rows(
    study: str, cells: list[aggregate.CellBlocks], exact: dict[Key, pa.Table]
) -> Iterator[tuple[pa.Table, pa.Table]]:
    """Yield the rows of stats and pairs of some cells; consecutive cells of one kind are computed together."""
    entries = []
    for c in cells:
        runs = aggregate.only_chunk(c) if c.blocks and c.cell.key not in exact else None
        if c.blocks or c.cell.key in exact:
            entries.append(((runs and aggregate.kind(c, runs)) if c.blocks else EXACT, c, runs))
    for kind, group in groupby(entries, key=itemgetter(0)):
        _, members, runs_of_cells = zip(*group, strict=True)
        if kind is None:
            yield from (_with_exact(study, c, exact.get(c.cell.key)) for c in members)
        elif kind == EXACT:
            rows = pa.concat_tables([exact[c.cell.key] for c in members])
            yield rows, moments_tables.pairs(rows)
        else:
            yield aggregate.rows_of_cells(study, list(members), list(runs_of_cells))


def _with_exact(study: str, c: aggregate.CellBlocks, exact: pa.Table | None) -> tuple[pa.Table, pa.Table]:
    """The rows of one cell whose observers may be exact; rows of runs contain the reason why they are not."""
    stats, pairs = aggregate.rows_of(study, c)
    if exact is None:
        return stats, pairs
    keys = zip(*(exact[name].to_pylist() for name in ("observer", "metric", "reason")), strict=True)
    reasons = {observer: reason for observer, metric, reason in keys if metric == "mse"}
    stats = parquet_io.with_column(stats, "reason", [reasons.get(name) for name in stats["observer"].to_pylist()])
    without_runs = pa.array([name not in c.blocks for name in exact["observer"].to_pylist()])
    rows = pa.concat_tables([exact.filter(without_runs), stats])
    rank = {name: i for i, name in enumerate(c.cell.options)}
    order = np.argsort([rank[name] for name in rows["observer"].to_pylist()], kind="stable")
    return rows.take(order), pa.concat_tables([pairs, moments_tables.pairs(exact)])


def record(target: storage.Target) -> storage.Json | None:
    """Return the content of provenance.json; None if it is missing or changed."""
    document = storage.read_json(target, PROVENANCE)
    return document if document and document.get("digest") == _digest(document) else None


def _digest(record: storage.Json) -> str:
    text = json.dumps({k: v for k, v in record.items() if k != "digest"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def digest_of(content: pa.Buffer) -> str:
    """Return the digest of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:32]


def adjust_pairs(content: pa.Buffer, about: dict[bytes, bytes]) -> pa.Buffer:
    """Write Holm's adjusted p-values into the rows of pairs; a family is one scenario, signal and metric.

    The p-values of a table are known only after its last row.
    """
    file, out = parquet_io.open_parquet(content), GrowingTable(about)
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


def _strength(certificate: storage.Json) -> float:
    """The sort key of certificates: gains without a certificate are weaker than all others."""
    margin = certificate["margin"]
    return -np.inf if is_certified(certificate) is False else np.inf if margin is None else margin


def input_digest(target: storage.Target, blocks: list[Block]) -> bytes:
    """Return a digest of the inputs of closing tables: the runs, however they are cut into blocks, and exact rows."""
    ranges = {
        key: merge_ranges(b.seeds for b in group)
        for key, group in block_files.series(block_files.drop_overlaps(blocks)).items()
    }
    text = repr([(s, observer, cell, *seeds) for (s, cell, observer), group in ranges.items() for seeds in group])
    runs, exact = hashlib.sha256(text.encode()).hexdigest().encode(), storage.read_buffer(target, moments_tables.NAME)
    return runs if exact is None else runs + digest_of(exact).encode()


def damaged_files(target: storage.Target) -> list[str]:
    """Return the closing files that differ from what was written."""
    document = record(target)
    if document is None:
        return [PROVENANCE] if storage.read_buffer(target, PROVENANCE) is not None else []
    return [
        name
        for name in document["digests"]
        if storage.read_buffer(target, name) is not None and table(target, name) is None
    ]


def is_closed(target: storage.Target, blocks: list[Block]) -> bool:
    """Return whether the closing tables exist and belong to these blocks."""
    mark = input_digest(target, blocks)
    tables = [table(target, name) for name in ("stats.parquet", "pairs.parquet")]
    metadata = [{} if t is None else parquet_io.metadata(t) for t in tables]
    return all(t.get(FROM) == mark and columns.has_schema(t) for t in metadata)


def table(target: storage.Target, name: str) -> pa.Table | None:
    """Return a closing table; None if it is missing or any of its bytes has changed."""
    content, document = storage.read_buffer(target, name), record(target)
    if content is None or document is None or document["digests"].get(name) != digest_of(content):
        return None
    try:
        return parquet_io.parse_table(content)
    except parquet_io.DAMAGE:
        return None
