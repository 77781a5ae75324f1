"""The rows of stats and pairs of one cell, from its blocks, which are read chunk by chunk."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench import statistics
from pcbench.dataset import block_files, columns, store
from pcbench.dataset.block_files import Block
from pcbench.dataset.seeds import Seeds, common
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.study.cells import Cell
from pcbench.synthesis.certificate import is_certified

Tables = Mapping[str, pa.Table]  # blocks by name
Chunk = dict[str, statistics.Results]  # by observer
NONE: Tables = MappingProxyType({})


class ObserverRuns(NamedTuple):
    """The runs of one observer in one cell."""

    blocks: list[Block]
    about: dict[str, Any]  # what its first block says of itself
    held: Tables = NONE  # of these blocks, what is at hand


def observed(
    target: store.Target, cell: Cell, blocks: dict[tuple[str, int, str], list[Block]], held: Tables = NONE
) -> dict[str, ObserverRuns]:
    """Return what there is of a cell, by observer; blocks that are `held` are not read again."""
    out = {}
    for name in cell.options:
        if mine := blocks.get((*cell.key, name)):
            first = held.get(mine[0].name)
            about = block_files.about_block(target, mine[0]) if first is None else block_files.about(first)
            out[name] = ObserverRuns(mine, about, held)
    return out


def rows_of(
    target: store.Target, study: str, cell: Cell, found: dict[str, ObserverRuns], within: Seeds | None = None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of stats and of pairs of one cell, over all seeds or those `within` a range."""
    s, signals = cell.scenario, signals_of(cell.scenario)
    names, units = [name for name, _ in signals], dict(signals)
    head = columns.keys(study, cell) | {"plant": s.plant}
    known = {
        name: {"carries_input": each.about["carries_input"], "certified": is_certified(each.about["certificate"])}
        for name, each in found.items()
    }
    bounds = {name: seen_bound(each.about["bound"], s.belief.prior_std) for name, each in found.items()}
    described, compared = statistics.summarise(
        lambda: chunks(target, found, within), bounds, names, s.belief.prior_std + s.belief.unknown_std
    )
    stats: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    for name, rows in described.items():
        for row in rows:
            signal, unit = signals[row["signal"]]
            about = {"observer": name, "unit": columns.unit_of(row["metric"], unit), "signal": signal}
            stats.append(head | row | known[name] | about | {"method": "runs", "reason": None})
    for row in compared:
        of_both = {f"{what}_{side}": said for side in "ab" for what, said in known[row[f"observer_{side}"]].items()}
        unit = columns.unit_of(row["metric"], units[row["signal"]])
        pairs.append(head | of_both | {"unit": unit, "method": "runs", "p_holm": np.nan} | row)
    return stats, pairs


def seen_bound(bound: list[float] | None, prior: tuple[float, ...]) -> statistics.Values | None:
    """Return the bound, NaN where it is so small a part of the prior that it is zero for every purpose."""
    if bound is None:
        return None
    return np.array([b if b >= statistics.SEEN * p else np.nan for b, p in zip(bound, prior, strict=False)])


def chunks(target: store.Target, found: dict[str, ObserverRuns], within: Seeds | None = None) -> Iterator[Chunk]:
    """Yield the runs of a cell by observer, the seeds of one chunk after the other."""
    readers = {name: _by_chunk(target, each, within) for name, each in found.items()}
    while True:
        each = {name: next(reader, None) for name, reader in readers.items()}
        if all(results is None for results in each.values()):
            return
        many = {name: 0 if results is None else len(results["diverged"]) for name, results in each.items()}
        if len(set(many.values())) > 1:
            raise UserError(
                f"{target.name}: observers of a cell have different seeds ({many}), expected the same; run the study again."
            )
        yield {name: results for name, results in each.items() if results is not None}


def _by_chunk(target: store.Target, mine: ObserverRuns, within: Seeds | None) -> Iterator[statistics.Results]:
    """Yield one observer's runs, cut at multiples of a chunk."""
    held: list[statistics.Results] = []
    at = None
    for block in mine.blocks:
        start, stop = block.seeds if within is None else common(block.seeds, within)
        if start >= stop:
            continue
        table = mine.held.get(block.name)
        results = results_of(block_files.read(target, block) if table is None else table)
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

    def square(name: str) -> NDArray[Any]:
        return table[name].to_numpy().reshape(runs, -1).T

    out = {m: square(m)[:many] for m, many in said["metrics"].items()}
    return out | {"diverged": square("diverged")[0].astype(bool), "unsettled": square("status") == "unsettled"}
