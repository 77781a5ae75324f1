"""The rows of stats and pairs of cells, computed from their blocks, which are read in chunks."""

from collections.abc import Hashable, Iterator
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench import statistics
from pcbench.dataset import block_files, columns, storage, table_builder
from pcbench.dataset.block_files import Block, Series
from pcbench.dataset.seed_ranges import Seeds, common
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import is_certified

FEW = 1024  # runs of a cell that is aggregated together with others; for more runs, this saves no time
Chunk = dict[str, statistics.Results]  # by observer


class CellBlocks(NamedTuple):
    """The blocks of a cell by observer, with the metadata of the first one of each."""

    target: storage.Target
    cell: Cell
    blocks: dict[str, list[Block]]
    about: dict[str, storage.Json]

    @property
    def bounds(self) -> dict[str, statistics.Values | None]:
        """Return by observer the least possible error of each signal."""
        prior = self.cell.scenario.belief.prior_std
        return {name: resolvable_bound(about["bound"], prior) for name, about in self.about.items()}

    @property
    def sizes(self) -> tuple[float, ...]:
        """Return the typical sizes of the signals; for user-defined errors their settling bands."""
        belief, band = self.cell.scenario.belief, self.cell.scenario.scoring.settle_band
        std = belief.prior_std + belief.unknown_std
        return std + band[len(std) :]


def of_cell(target: storage.Target, cell: Cell, blocks: Series) -> CellBlocks:
    """Return the blocks of a cell."""
    by_observer = {name: blocks[*cell.key, name] for name in cell.options if blocks.get((*cell.key, name))}
    about = {name: block_files.about_block(target, series[0]) for name, series in by_observer.items()}
    return CellBlocks(target, cell, by_observer, about)


def rows_of(study: str, c: CellBlocks, within: Seeds | None = None) -> tuple[pa.Table, pa.Table]:
    """Return the rows of stats and of pairs of one cell, over all seeds or those `within` a range."""
    return _tables(study, [c], *statistics.summary(lambda: chunks(c, within), c.bounds, c.sizes))


def rows_of_cells(study: str, cells: list[CellBlocks], runs: list[Chunk]) -> tuple[pa.Table, pa.Table]:
    """Return the rows of several cells of one `kind` with one chunk each: the same bits as cell by cell, but faster."""
    bounds: dict[str, statistics.Values | None] = {}
    for o in cells[0].blocks:
        cell_bounds = np.full((len(cells), len(cells[0].sizes)), np.nan)
        for row, bound in zip(cell_bounds, (c.bounds[o] for c in cells), strict=True):
            if bound is not None:
                row[: len(bound)] = bound
        bounds[o] = cell_bounds
    return _tables(study, cells, *statistics.summary_of_cells(runs, bounds, cells[0].sizes))


def _tables(
    study: str,
    cells: list[CellBlocks],
    summaries: dict[str, statistics.ObserverSummary],
    comparisons: dict[statistics.Pair, statistics.PairResult],
) -> tuple[pa.Table, pa.Table]:
    cell = cells[0].cell
    about = {"plant": cell.scenario.plant, "method": "runs", "reason": None, "p_holm": np.nan}
    heads = [columns.keys(study, c.cell) | about for c in cells]
    facts = [{o: _facts(about) for o, about in c.about.items()} for c in cells]
    signals = signals_of(cell.scenario)
    stats = table_builder.stats_table(heads, facts, signals, summaries)
    return stats, table_builder.pairs_table(heads, facts, signals, comparisons)


def _facts(about: storage.Json) -> dict[str, bool | None]:
    return {"predicts_unknown_input": about["predicts_unknown_input"], "certified": is_certified(about["certificate"])}


def kind(c: CellBlocks, runs: Chunk) -> Hashable:
    """Return what cells must have in common to be aggregated together; None if a run diverged."""
    if any(results["diverged"].any() for results in runs.values()):
        return None
    rows = tuple((o, tuple((m, len(v)) for m, v in results.items())) for o, results in runs.items())
    return c.cell.scenario.name, c.sizes, tuple(c.cell.values), rows


def only_chunk(c: CellBlocks) -> Chunk | None:
    """Return a cell's runs if they are one chunk of at most FEW; otherwise None."""
    spans = {(blocks[0].seeds.first, blocks[-1].seeds.stop) for blocks in c.blocks.values()}
    first, stop = min(spans)
    if len(spans) > 1 or stop - first > FEW or first // statistics.CHUNK != (stop - 1) // statistics.CHUNK:
        return None
    return next(chunks(c))


def resolvable_bound(bound: list[float] | None, prior: tuple[float, ...]) -> statistics.Values | None:
    """Return the bound; NaN if it is negligible relative to the prior."""
    if bound is None:
        return None
    return np.array([b if b >= statistics.ZERO_BOUND * p else np.nan for b, p in zip(bound, prior, strict=False)])


def chunks(c: CellBlocks, within: Seeds | None = None) -> Iterator[Chunk]:
    """Yield the runs of a cell by observer, in chunks of seeds."""
    readers = {name: _by_chunk(c, blocks, within) for name, blocks in c.blocks.items()}
    while chunk := {name: results for name, reader in readers.items() if (results := next(reader, None)) is not None}:
        counts = {name: len(chunk[name]["diverged"]) if name in chunk else 0 for name in readers}
        if len(set(counts.values())) > 1:
            raise UserError(
                f"{c.target.name}: observers of a cell have different seeds ({counts}), expected the same; run the study again."
            )
        yield chunk


def _by_chunk(c: CellBlocks, blocks: list[Block], within: Seeds | None) -> Iterator[statistics.Results]:
    """Yield one observer's runs, cut at multiples of a chunk."""
    parts: list[statistics.Results] = []
    current = None
    for block in blocks:
        start, stop = block.seeds if within is None else common(block.seeds, within)
        if start >= stop:
            continue
        results = results_of(block_files.read_block(c.target, block))
        while start < stop:
            chunk = start // statistics.CHUNK
            if parts and chunk != current:
                yield _concat_results(parts)
                parts = []
            current, end = chunk, min(stop, (chunk + 1) * statistics.CHUNK)
            parts.append({m: v[..., start - block.seeds.first : end - block.seeds.first] for m, v in results.items()})
            start = end
    if parts:
        yield _concat_results(parts)


def _concat_results(parts: list[statistics.Results]) -> statistics.Results:
    return {m: np.concatenate([p[m] for p in parts], -1) for m in parts[0]} if len(parts) > 1 else parts[0]


def results_of(table: pa.Table) -> statistics.Results:
    """Return the metrics of a block, [signals that the observer estimates, seeds], and `diverged` [seeds]."""
    about = block_files.about(table)

    def by_signal(name: str) -> NDArray[np.generic]:
        return table[name].to_numpy().reshape(about["last"] - about["first"], -1).T

    out = {m: by_signal(m)[:n] for m, n in about["metrics"].items()}
    return out | {"diverged": by_signal("diverged")[0].astype(bool), "unsettled": by_signal("status") == "unsettled"}
