"""From the blocks of a dataset to its closing tables: stats and pairs, read cell by cell, chunk by chunk.

What they hold is a function of the rows alone: not of how these are cut into files, nor of who computed them.
"""

import hashlib
import json
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from pcbench import statistics
from pcbench.dataset import block_files, columns, parquet, store
from pcbench.dataset.block_files import Block
from pcbench.dataset.ownership import Claim
from pcbench.dataset.seeds import Seeds, common, joined
from pcbench.dataset.summary_parts import Gathered, adjusted
from pcbench.errors import UserError
from pcbench.machine import provenance
from pcbench.plants import signals_of
from pcbench.study import observers_of
from pcbench.study.cells import Cell, digest

PROVENANCE = "provenance.json"
FROM = b"pcbench.from"  # the key in a closing table's metadata: which blocks it was made of


class Observed(NamedTuple):
    """The runs of one observer in one cell."""

    blocks: list[Block]
    about: dict[str, Any]  # what its first block says of itself


def close(place: store.Target, claimed: Claim, there: list[Block], about: dict[str, Any]) -> None:
    """Write stats.parquet and pairs.parquet of the blocks that are there, and provenance.json with what is said `about` it."""
    stats, pairs, weakest = closing_tables(place, claimed, there)
    store.put(place, "stats.parquet", stats)
    store.put(place, "pairs.parquet", pairs)
    digests = {"stats.parquet": digest_of(stats), "pairs.parquet": digest_of(pairs)}
    study = {
        "schema": columns.SCHEMA,
        "study": claimed.study.name,
        "study_sha256": digest(claimed.study),
        "root_seed": claimed.study.root_seed,
        "blocks": len(there),
    }
    said = provenance.describe() | study | about | {"certificates": weakest, "digests": digests}
    store.put_json(place, PROVENANCE, said | {"digest": _digest(said)})


def record(place: store.Target) -> dict[str, Any] | None:
    """Return what provenance.json says; None where it is not there, or not as it was written."""
    said = store.document(place, PROVENANCE)
    return said if said and said.get("digest") == _digest(said) else None


def _digest(said: dict[str, Any]) -> str:
    text = json.dumps({k: v for k, v in said.items() if k != "digest"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def digest_of(content: Any) -> str:
    """Return the digest of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:32]


def closing_tables(
    place: store.Target, claimed: Claim, there: list[Block]
) -> tuple[pa.Buffer, pa.Buffer, dict[str, dict[str, Any]]]:
    """Return stats and pairs as the bytes of their files, and the weakest certificates.

    Cells are taken in the order of the study, those without runs left out.
    """
    made_of = {FROM: fingerprint(there)}
    stats, pairs, there = Gathered(made_of), Gathered(made_of), block_files.settled(there)
    weakest: dict[str, dict[str, Any]] = {}
    blocks: dict[tuple[str, int, str], list[Block]] = {}
    for b in sorted(there):
        blocks.setdefault((b.scenario, b.cell, b.observer), []).append(b)
    for cell in claimed.cells:
        found = observed(place, claimed, cell, blocks)
        if not found:
            continue
        rows, compared = summary(place, claimed.study.name, cell, found)
        axes = columns.axes_of(rows[0])
        stats.add(columns.rows_table(rows, columns.stats_order(axes)))
        pairs.add(columns.rows_table(compared, columns.pairs_order(axes)))
        mine = weakest.setdefault(cell.scenario.name, {})
        for name, each in found.items():
            c = each.about["certificate"]
            mine[name] = min(mine.get(name, c), c, key=lambda c: np.inf if c["margin"] is None else c["margin"])
    return stats.content(), adjusted(pairs.content(), made_of), weakest


def fingerprint(there: list[Block]) -> bytes:
    """Return the digest of which runs there are, however they are cut into blocks."""
    ranges: dict[tuple[str, str, int], list[Seeds]] = {}
    for b in block_files.settled(there):
        ranges.setdefault(b[:3], []).append(b.seeds)
    whole = [(*key, *seeds) for key, each in ranges.items() for seeds in joined(each)]
    return hashlib.sha256(repr(whole).encode()).hexdigest().encode()


def damaged(place: store.Target) -> list[str]:
    """Return the closing files that stand and are not as they were written."""
    said = record(place)
    if said is None:
        return [PROVENANCE] if store.get(place, PROVENANCE) is not None else []
    return [name for name in said["digests"] if store.get(place, name) is not None and table(place, name) is None]


def is_closed(place: store.Target, there: list[Block]) -> bool:
    """Return whether the closing tables stand, and are of these blocks."""
    for name in ("stats.parquet", "pairs.parquet"):
        found = table(place, name)
        said = {} if found is None else found.schema.metadata or {}
        if said.get(FROM) != fingerprint(there) or said.get(b"pcbench.schema") != columns.SCHEMA.encode():
            return False
    return True


def table(place: store.Target, name: str) -> pa.Table | None:
    """Return a closing table; None where it is not there, or not as it was written: every byte counts."""
    content, said = store.get(place, name), record(place)
    if content is None or said is None or said["digests"].get(name) != digest_of(content):
        return None
    try:
        return parquet.parsed(content)
    except (pa.ArrowException, OSError, ValueError):
        return None


def observed(
    place: store.Target, claimed: Claim, cell: Cell, blocks: dict[tuple[str, int, str], list[Block]]
) -> dict[str, Observed]:
    """Return what there is of a cell, by observer."""
    out = {}
    for name in observers_of(claimed.study, cell.scenario.name):
        if mine := blocks.get((*cell.key, name)):
            out[name] = Observed(mine, block_files.about_block(place, mine[0]))
    return out


def summary(
    place: store.Target, study: str, cell: Cell, found: dict[str, Observed], within: Seeds | None = None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of stats and of pairs of one cell, over the seeds `within` a range where it is given."""
    s, signals = cell.scenario, signals_of(cell.scenario)
    names, units = [name for name, _ in signals], dict(signals)
    head = columns.keys(study, cell) | {"plant": s.plant}
    carries = {name: each.about["carries_input"] for name, each in found.items()}
    bounds = {name: _seen(each.about["bound"], s.prior_std) for name, each in found.items()}
    described, compared = statistics.summarise(
        lambda: chunks(place, found, within), bounds, names, s.prior_std + s.unknown_std
    )
    stats, pairs = [], []
    for name, rows in described.items():
        for row in rows:
            signal, unit = signals[row["signal"]]
            about = {"observer": name, "carries_input": carries[name], "unit": columns.unit_of(row["metric"], unit)}
            stats.append(head | row | about | {"signal": signal})
    for row in compared:
        about = {"unit": columns.unit_of(row["metric"], units[row["signal"]]), "p_holm": np.nan}
        about |= {f"carries_input_{side}": carries[row[f"observer_{side}"]] for side in "ab"}
        pairs.append(head | about | row)
    return stats, pairs


def _seen(bound: list[float] | None, prior: tuple[float, ...]) -> Any:
    """The bound where it is one: below a part of the prior it is zero for every purpose."""
    if bound is None:
        return None
    return np.array([b if b >= statistics.SEEN * p else np.nan for b, p in zip(bound, prior, strict=False)])


def chunks(
    place: store.Target, found: dict[str, Observed], within: Seeds | None = None
) -> Iterator[dict[str, statistics.Results]]:
    """Yield the runs of a cell by observer, the seeds of one chunk after the other."""
    readers = {name: _by_chunk(place, each.blocks, within) for name, each in found.items()}
    while True:
        each = {name: next(reader, None) for name, reader in readers.items()}
        if all(results is None for results in each.values()):
            return
        many = {name: 0 if results is None else len(results["diverged"]) for name, results in each.items()}
        if len(set(many.values())) > 1:
            raise UserError(
                f"{place.name}: observers of a cell have different seeds ({many}), expected the same; run the study again."
            )
        yield {name: results for name, results in each.items() if results is not None}


def _by_chunk(place: store.Target, blocks: list[Block], within: Seeds | None) -> Iterator[statistics.Results]:
    """Yield one observer's runs, cut at multiples of a chunk."""
    held: list[statistics.Results] = []
    at = None
    for block in blocks:
        start, stop = block.seeds if within is None else common(block.seeds, within)
        if start >= stop:
            continue
        results = results_of(block_files.read(place, block))
        while start < stop:
            chunk = start // statistics.CHUNK
            if held and chunk != at:
                yield _joined(held)
                held = []
            at, end = chunk, min(stop, (chunk + 1) * statistics.CHUNK)
            held.append({m: v[..., start - block.seeds.first : end - block.seeds.first] for m, v in results.items()})
            start = end
    if held:
        yield _joined(held)


def _joined(parts: list[statistics.Results]) -> statistics.Results:
    return {m: np.concatenate([p[m] for p in parts], -1) for m in parts[0]} if len(parts) > 1 else parts[0]


def results_of(table: pa.Table) -> statistics.Results:
    """Return the metrics that a block holds, [what the observer estimates, seeds]; `diverged` [seeds]."""
    said = block_files.about(table)
    runs = said["last"] - said["first"]

    def square(name: str) -> Any:
        return table[name].to_numpy().reshape(runs, -1).T

    out = {m: square(m)[:many] for m, many in said["metrics"].items()}
    return out | {"diverged": square("diverged")[0].astype(bool), "unsettled": square("status") == "unsettled"}
