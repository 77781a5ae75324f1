"""Merge of several datasets of one study, with different seeds or from different machines.

Rows that two of them contain must be equal; the merge keeps those of the first dataset. Rows of two engines are equal
to 1e-11. Exact numbers do not depend on seeds, so all parts may contain them. Cells that were computed in one call with
others may differ in their last bits. A difference above rounding is refused. Cells are numbered as in the first
dataset.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from pcbench.dataset import block_files, close, manifest, moments_tables, parquet_io, run_missing, storage, stored_code
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.seed_ranges import Seeds, common, gaps, seed_range
from pcbench.dataset.table_diff import agree, difference, of_one_run
from pcbench.errors import UserError
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.serialize import to_toml

BETWEEN_ENGINES = 1e-11  # by which rows that two engines computed may differ, see `of_one_run`


class Part(NamedTuple):
    """A block with its dataset, and its name in the merged dataset."""

    target: storage.Target
    source: Block
    block: Block


class ExactFile(NamedTuple):
    """A file of exact numbers with its dataset."""

    target: storage.Target
    claim: StudyClaim
    name: str


class MergeReport(NamedTuple):
    """The result of a merge."""

    blocks: int
    duplicates: int  # runs that more than one dataset held, all of them equal
    missing: int  # runs that no dataset held


def merge(folders: Sequence[str | Path], out: str | Path, progress: Progress = SILENT) -> MergeReport:
    """Copy the blocks of several datasets of one study into a new one and close it; raise UserError if they disagree.

    Nothing is written before all overlaps are compared.
    """
    if len(folders) < 2:
        raise UserError(f"merge: got {len(folders)} dataset, expected two or more; name them.")
    targets = [storage.target(folder) for folder in folders]
    claims = [manifest.load_manifest(target) for target in targets]
    for target, claim in zip(targets[1:], claims[1:], strict=True):
        if differences := [*manifest.differences(claims[0], claim), *_evaluation_differences(claims[0], claim)]:
            raise UserError(
                f"{target.name}: is of another study than {targets[0].name} ({'; '.join(differences[:3])}), expected the same "
                "study with other seeds; merge datasets of one study."
            )
    into = storage.target(out)
    if files := storage.file_names(into):  # also what an interrupted merge left: whole blocks, to be removed by hand
        raise UserError(
            f"{into.name}: contains files already ({files[0]}), expected a new folder; give another with --out, or remove it."
        )
    union = _over_all_seeds(claims)
    parts, exact = _parts(targets, claims, union), _exact_files(targets, claims, union)
    progress.begin("merging", 2 * sum(map(len, parts.values())))
    for group in parts.values():  # all comparisons before the first file is written
        for i, part in enumerate(group):
            for other in group[:i]:
                _require_equal(part, other)
            progress.step(1)
    for first, *rest in exact.values():
        table = _exact_rows(first, union)
        for file in rest:
            if not agree(table, _exact_rows(file, union)):
                raise UserError(
                    f"{file.target.name}/{file.name}: differs from {first.target.name}/{first.name} by more than rounding, "
                    "expected equal numbers; run the study of one of them again with --overwrite."
                )
    manifest.begin(into, union)
    for target in targets:
        stored_code.copy(target, into)
    n_duplicates = 0
    for group in parts.values():
        ranges: list[Seeds] = []
        for part in group:
            new_ranges = gaps(ranges, part.block.seeds, part.block.seeds.stop)  # two, if earlier parts hold its middle
            n_duplicates += part.block.seeds.many - sum(seeds.many for seeds in new_ranges)
            ranges += new_ranges
            for block in (part.block._replace(seeds=seeds) for seeds in new_ranges):
                storage.write_file(into, block.name, _content(part, block))
            progress.step(1)
    for name, (first, *_) in exact.items():
        storage.write_table(into, name, _exact_rows(first, union))
    blocks, n_missing = block_files.present(into), run_missing.count_missing(into, union)
    if not n_missing:  # every observer has the same seeds
        engines = sorted({cell.engine for claim in claims for cell in claim.cells})
        about = {"merged": [target.name for target in targets], "engines": engines}
        close.close(into, union, close.closing_tables(into, union, blocks), about)
    return MergeReport(len(blocks), n_duplicates, n_missing)


def _evaluation_differences(a: StudyClaim, b: StudyClaim) -> Iterator[str]:
    """Yield differences in the evaluation, which a study may change in its folder, but which parts must share."""
    for name in ("evaluation", "schedules"):
        if (old := getattr(a.study, name)) != (new := getattr(b.study, name)):
            yield f"{name}: {old} there, {new} here"


def _over_all_seeds(claims: list[StudyClaim]) -> StudyClaim:
    """The study over all seeds, with cells numbered as in the first dataset."""
    study, cells = claims[0].study, claims[0].cells
    ranges = [seed_range(claim.study.first_seed, claim.study.seeds) for claim in claims]
    span = Seeds(min(seeds.first for seeds in ranges), max(seeds.stop for seeds in ranges))
    study = study.model_copy(update={"first_seed": span.first, "seeds": span.many})
    return StudyClaim(study, cells, to_toml(study, cells))


def _numbers(claim: StudyClaim, union: StudyClaim) -> dict[tuple[str, int], int]:
    """The cell's number in the merged dataset, by scenario and number in a part."""
    numbers = {(s, digest): number for (s, number), digest in manifest.digests(union).items()}
    return {(s, n): numbers[s, digest] for (s, n), digest in manifest.digests(claim).items()}


def _parts(
    targets: list[storage.Target], claims: list[StudyClaim], union: StudyClaim
) -> dict[tuple[str, int, str], list[Part]]:
    """Return the blocks of all datasets by scenario, cell and observer, numbered as in the merged dataset."""
    out: dict[tuple[str, int, str], list[Part]] = {}
    for target, claim in zip(targets, claims, strict=True):
        digests, numbers = manifest.digests(claim), _numbers(claim, union)
        for b in sorted(block_files.present(target), key=lambda b: (b.seeds.first, -b.seeds.stop)):
            if reason := block_files.damage(target, b, digests.get((b.scenario, b.cell), "")):
                raise UserError(
                    f"{target.name}/{b.name}: is damaged ({reason}), expected a complete block; run its study again first."
                )
            block = b._replace(cell=numbers[b.scenario, b.cell])
            out.setdefault((b.scenario, block.cell, b.observer), []).append(Part(target, b, block))
    return dict(sorted(out.items()))


def _content(part: Part, block: Block) -> pa.Buffer:
    """The bytes of a part's block for some seeds; if these are all its seeds, the bytes of its file."""
    if block != part.source:
        return parquet_io.encode_table(_cut(block_files.read_block(part.target, part.source), block))
    content = storage.read_buffer(part.target, block.name)
    if content is None:
        raise UserError(
            f"{part.target.name}/{block.name}: is missing, expected a dataset that no other process changes; merge it again."
        )
    return content


def _cut(table: pa.Table, block: Block) -> pa.Table:
    """Return the rows of a table for a block, with the block's cell number."""
    about = block_files.about(table)
    rows_per_seed = len(table) // (about["last"] - about["first"])
    rows = table.slice((block.seeds.first - about["first"]) * rows_per_seed, block.seeds.many * rows_per_seed)
    rows = parquet_io.with_column(rows, "cell", [block.cell] * len(rows))
    return block_files.seal_block(rows, about | {"first": block.seeds.first, "last": block.seeds.stop})


def _require_equal(part: Part, other: Part) -> None:
    """Raise UserError if a part disagrees with an earlier one on their common seeds."""
    common_seeds = common(part.block.seeds, other.block.seeds)
    if not common_seeds.many:
        return
    a, b = (
        _cut(block_files.read_block(p.target, p.source), part.block._replace(seeds=common_seeds)) for p in (other, part)
    )
    if a.equals(b):
        return
    if block_files.about(a)["engine"] == block_files.about(b)["engine"] or not of_one_run(a, b, BETWEEN_ENGINES):
        deviation = difference(a, b)
        size = "in more than numbers" if deviation is None else f"by {deviation.relative:.1e} of themselves"
        raise UserError(
            f"{part.target.name}/{part.source.name}: its seeds {common_seeds.first} .. {common_seeds.stop - 1} differ "
            f"{size} from those in {other.target.name}, expected equal rows; find out with pcbench verify which of them is "
            "reproduced."
        )


def _exact_files(
    targets: list[storage.Target], claims: list[StudyClaim], union: StudyClaim
) -> dict[str, list[ExactFile]]:
    """Return the files of exact numbers by their name in the merged dataset."""
    out: dict[str, list[ExactFile]] = {}
    for target, claim in zip(targets, claims, strict=True):
        file, numbers = moments_tables.moments_file, _numbers(claim, union)
        names = {file(s, n): file(s, number) for (s, n), number in numbers.items()}
        names[moments_tables.NAME] = moments_tables.NAME
        for name in filter(names.__contains__, storage.file_names(target)):
            out.setdefault(names[name], []).append(ExactFile(target, claim, name))
    return dict(sorted(out.items()))


def _exact_rows(file: ExactFile, union: StudyClaim) -> pa.Table:
    """Return the rows of a file for the merged dataset."""
    table = parquet_io.unseal_table(storage.read_buffer(file.target, file.name))
    if table is None:
        raise UserError(
            f"{file.target.name}/{file.name}: is damaged, expected a complete file; run its study again first."
        )
    if file.name != moments_tables.NAME:
        return table
    numbers, order = _numbers(file.claim, union), {cell.key: i for i, cell in enumerate(union.cells)}
    keys = [(s, numbers[s, n]) for s, n in zip(table["scenario"].to_pylist(), table["cell"].to_pylist(), strict=True)]
    rows = parquet_io.with_column(table, "cell", [number for _, number in keys])
    rows = rows.take(np.argsort([order[key] for key in keys], kind="stable"))
    mark = parquet_io.metadata(table).get(moments_tables.OF)
    if mark == moments_tables.mark_of(file.claim):  # else the next run computes it again
        mark = moments_tables.mark_of(union)
    return parquet_io.seal_table(parquet_io.with_metadata(rows, {moments_tables.OF: mark} if mark else {}))
