"""The rows of stats and pairs of cells, from their blocks, which are read chunk by chunk."""

from collections.abc import Hashable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench import statistics
from pcbench.dataset import block_files, columns, storage, table_builder
from pcbench.dataset.block_files import Block
from pcbench.dataset.seed_ranges import Seeds, common
from pcbench.dataset.table_builder import Frame
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import is_certified

FEW = 1024  # runs of a cell whose rows are made together with those of others: of more, most of the time is theirs
Chunk = dict[str, statistics.Results]  # by observer


class Runs(NamedTuple):
    """What a block holds."""

    about: dict[str, Any]  # what it says of itself
    results: statistics.Results


Held = Mapping[str, Runs]  # blocks by name
NONE: Held = MappingProxyType({})


class ObserverRuns(NamedTuple):
    """The runs of one observer in one cell."""

    blocks: list[Block]
    about: dict[str, Any]  # what its first block says of itself
    held: Held = NONE  # of these blocks, what is at hand


Found = dict[str, ObserverRuns]  # what there is of a cell, by observer


class CellRuns(NamedTuple):
    """A cell with all of its runs, which are few."""

    cell: Cell
    found: Found
    runs: Chunk


def observed(
    target: storage.Target, cell: Cell, blocks: dict[tuple[str, int, str], list[Block]], held: Held = NONE
) -> Found:
    """Return what there is of a cell, by observer; blocks that are `held` are not read again."""
    out = {}
    for name in cell.options:
        if mine := blocks.get((*cell.key, name)):
            first = held.get(mine[0].name)
            about = block_files.about_block(target, mine[0]) if first is None else first.about
            out[name] = ObserverRuns(mine, about, held)
    return out


def rows_of(
    target: storage.Target, study: str, cell: Cell, found: Found, within: Seeds | None = None
) -> tuple[Frame, Frame]:
    """Return the rows of stats and of pairs of one cell, over all seeds or those `within` a range."""
    described, compared = statistics.summary(lambda: chunks(target, found, within), _bounds(cell, found), _sizes(cell))
    return _frames(study, [cell], [found], described, compared)


def rows_of_cells(study: str, cells: list[CellRuns]) -> tuple[Frame, Frame]:
    """Return the same of several cells of one `kind`: the same bits, in a part of the time."""
    bounds = {o: np.full((len(cells), len(_sizes(cells[0].cell))), np.nan) for o in cells[0].found}
    for i, c in enumerate(cells):
        for o, bound in _bounds(c.cell, c.found).items():
            bounds[o][i, : 0 if bound is None else len(bound)] = np.nan if bound is None else bound
    described, compared = statistics.summary_of_cells([c.runs for c in cells], dict(bounds), _sizes(cells[0].cell))
    return _frames(study, [c.cell for c in cells], [c.found for c in cells], described, compared)


def kind(c: CellRuns) -> Hashable:
    """Return what cells have in common whose rows can be made together; None where a run diverged."""
    if any(results["diverged"].any() for results in c.runs.values()):
        return None
    rows = tuple((o, tuple((m, len(v)) for m, v in results.items())) for o, results in c.runs.items())
    return c.cell.scenario.name, _sizes(c.cell), tuple(c.cell.values), rows


def few(target: storage.Target, cell: Cell, found: Found) -> CellRuns | None:
    """Return a cell with its runs, where there are no more than FEW a chunk, and one chunk; else None."""
    spans = {(each.blocks[0].seeds.first, each.blocks[-1].seeds.stop) for each in found.values()}
    first, stop = min(spans)
    if len(spans) > 1 or stop - first > FEW or first // statistics.CHUNK != (stop - 1) // statistics.CHUNK:
        return None
    return CellRuns(cell, found, next(chunks(target, found)))


def _frames(
    study: str,
    cells: list[Cell],
    found: list[Found],
    described: dict[str, statistics.Described],
    compared: dict[statistics.Pair, statistics.Judged],
) -> tuple[Frame, Frame]:
    plant, signals = cells[0].scenario.plant, signals_of(cells[0].scenario)
    heads = [columns.keys(study, cell) | {"plant": plant, "method": "runs", "reason": None} for cell in cells]
    known = [{o: _known(each.about) for o, each in f.items()} for f in found]
    stats = table_builder.of_stats(heads, known, signals, described)
    pairs = table_builder.of_pairs([head | {"p_holm": np.nan} for head in heads], known, signals, compared)
    return stats, pairs


def _known(about: dict[str, Any]) -> dict[str, bool | None]:
    return {"predicts_unknown_input": about["predicts_unknown_input"], "certified": is_certified(about["certificate"])}


def _bounds(cell: Cell, found: Found) -> dict[str, statistics.Values | None]:
    return {name: seen_bound(each.about["bound"], cell.scenario.belief.prior_std) for name, each in found.items()}


def _sizes(cell: Cell) -> tuple[float, ...]:
    return cell.scenario.belief.prior_std + cell.scenario.belief.unknown_std


def seen_bound(bound: list[float] | None, prior: tuple[float, ...]) -> statistics.Values | None:
    """Return the bound, NaN where it is so small a part of the prior that it is zero for every purpose."""
    if bound is None:
        return None
    return np.array([b if b >= statistics.SEEN * p else np.nan for b, p in zip(bound, prior, strict=False)])


def chunks(target: storage.Target, found: dict[str, ObserverRuns], within: Seeds | None = None) -> Iterator[Chunk]:
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


def _by_chunk(target: storage.Target, mine: ObserverRuns, within: Seeds | None) -> Iterator[statistics.Results]:
    """Yield one observer's runs, cut at multiples of a chunk."""
    held: list[statistics.Results] = []
    at = None
    for block in mine.blocks:
        start, stop = block.seeds if within is None else common(block.seeds, within)
        if start >= stop:
            continue
        there = mine.held.get(block.name)
        results = results_of(block_files.read(target, block)) if there is None else there.results
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
