"""Several datasets of one study, of other seeds or machines, made one. What two of them hold must be equal, row by row.

Rows that two engines computed are equal to 1e-11. Of rows that several datasets hold those of the first of them are kept.

The exact parts of several datasets of one study, made one: cells are numbered as in the first; what two hold must agree.

Exact numbers do not depend on seeds, so every part may have them all. Cells that shared a call with others may differ in their
last bits: more than rounding is refused.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from pcbench.dataset import block_files, close, manifest, moments_tables, parquet_io, run_missing, storage, stored_code
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import Owned
from pcbench.dataset.seed_ranges import Seeds, common, counted, gaps
from pcbench.dataset.table_diff import difference, of_one_run
from pcbench.errors import UserError
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.serialize import to_toml

ROUNDING, ZERO = 1e-9, 1e-11  # relative; absolute, in any unit
Moved = dict[tuple[str, int], int]  # by scenario and number in a part, the cell's number in the merged dataset
Holder = tuple[storage.Target, Owned, Moved, str]  # and the file's name there


def pieces(targets: list[storage.Target], holdings: list[Owned], whole: Owned) -> Iterator[tuple[str, pa.Table]]:
    """Yield the files of the merged exact part by name; raise UserError where one is damaged, or two parts disagree."""
    for name, holders in sorted(_holders(targets, holdings).items()):
        first, *others = holders
        table = _read(first, whole)
        for other in others:
            if not agree(table, _read(other, whole)):
                raise UserError(
                    f"{other[0].name}/{other[3]}: differs from {first[0].name}/{first[3]} by more than rounding, expected "
                    "equal numbers; run the study of one of them again with --overwrite."
                )
        yield name, table


def _holders(targets: list[storage.Target], holdings: list[Owned]) -> dict[str, list[Holder]]:
    """Return by name in the merged dataset who holds a file."""
    numbers = {(s, digest): number for (s, number), digest in manifest.digests(holdings[0]).items()}
    out: dict[str, list[Holder]] = {}
    for target, owned in zip(targets, holdings, strict=True):
        moved = {(s, n): numbers[s, digest] for (s, n), digest in manifest.digests(owned).items()}
        called = {moments_tables.place(s, n): moments_tables.place(s, to) for (s, n), to in moved.items()}
        called[moments_tables.NAME] = moments_tables.NAME
        for name in filter(called.__contains__, storage.names(target)):
            out.setdefault(called[name], []).append((target, owned, moved, name))
    return out


def _read(holder: Holder, whole: Owned) -> pa.Table:
    """Return the rows of a file as the merged dataset is to hold them."""
    target, owned, moved, name = holder
    content = storage.get(target, name)
    table = None if content is None else parquet_io.whole(content)
    if table is None:
        raise UserError(f"{target.name}/{name}: is damaged, expected a whole file; run its study again first.")
    if name != moments_tables.NAME:
        return table
    about: dict[Any, Any] = dict(table.schema.metadata or {})
    stands = about.pop(moments_tables.OF, b"") == moments_tables.of(owned)  # else the next run makes it anew
    about |= {moments_tables.OF: moments_tables.of(whole)} if stands else {}
    return parquet_io.sealed(_numbered(table, moved, whole).replace_schema_metadata(about))


def _numbered(table: pa.Table, moved: Moved, whole: Owned) -> pa.Table:
    """Return exact rows with their cells numbered, and in the order, of the merged dataset."""
    keys = list(zip(table["scenario"].to_pylist(), table["cell"].to_pylist(), strict=True))
    numbers = [moved[key] for key in keys]
    turn = {cell.key: i for i, cell in enumerate(whole.cells)}
    after = [turn[scenario, number] for (scenario, _), number in zip(keys, numbers, strict=True)]
    at = table.schema.get_field_index("cell")
    table = table.set_column(at, table.schema.field(at), pa.array(numbers, table.schema.field(at).type))
    return table.take(sorted(range(len(table)), key=after.__getitem__))


def agree(a: pa.Table, b: pa.Table) -> bool:
    """Return whether two tables hold the same but for rounding."""
    if a.schema.names != b.schema.names or len(a) != len(b):
        return False
    for x, y in zip(a.columns, b.columns, strict=True):
        if x.equals(y):
            continue
        if not pa.types.is_floating(x.type) or x.null_count != y.null_count:
            return False
        if not np.allclose(x.to_numpy(), y.to_numpy(), ROUNDING, ZERO, equal_nan=True):
            return False
    return True


BETWEEN_ENGINES = 1e-11  # by which rows that two engines computed may differ, see `of_one_run`


class Part(NamedTuple):
    """A block where it stands, and as it is called in the merged dataset."""

    target: storage.Target
    there: Block
    block: Block
    engine: str  # of its study


class MergeReport(NamedTuple):
    """What a merge made."""

    blocks: int
    doubled: int  # runs that more than one dataset held, all of them equal
    missing: int  # runs that no dataset held


def merge(given: Sequence[str | Path], out: str | Path, progress: Progress = SILENT) -> MergeReport:
    """Copy the blocks of several datasets of one study into a new one and close it; raise UserError where they disagree.

    Nothing is written before every overlap has been found equal.
    """
    if len(given) < 2:
        raise UserError(f"merge: got {len(given)} dataset, expected two or more; name them.")
    targets = [storage.target(each) for each in given]
    holdings = [manifest.opened(target) for target in targets]
    for target, owned in zip(targets[1:], holdings[1:], strict=True):
        if changed := [*manifest.differences(holdings[0], owned), *_asked(holdings[0], owned)]:
            raise UserError(
                f"{target.name}: is of another study than {targets[0].name} ({'; '.join(changed[:3])}), expected the same "
                "study with other seeds; merge datasets of one study."
            )
    into = storage.target(out)
    if found := storage.names(into):  # also what an interrupted merge left: whole blocks, to be removed by hand
        raise UserError(
            f"{into.name}: holds files already ({found[0]}), expected a new folder; give another with --out, or remove it."
        )
    parts = _parts(targets, holdings)
    progress.begin("merging", 2 * sum(map(len, parts.values())))
    for mine in parts.values():  # first look, then write
        for _ in _pieces(mine):
            progress.step(1)
    whole = _whole(holdings)
    for _ in pieces(targets, holdings, whole):
        pass
    manifest.begin(into, whole)
    for target in targets:
        stored_code.copy(target, into)
    doubled = 0
    for mine in parts.values():
        for name, content, twice in _pieces(mine):
            doubled += twice
            if content is not None:
                storage.put(into, name, content)
            progress.step(1)
    for name, table in pieces(targets, holdings, whole):
        storage.put_table(into, name, table)
    engines = sorted({str(owned.study.engine) for owned in holdings})
    return _closed(into, whole, targets, doubled, engines)


def _asked(a: Owned, b: Owned) -> Iterator[str]:
    """Yield what a study may change in its folder, but parts must share: how its numbers are found."""
    for name, one, other in (
        ("evaluation", a.study.evaluation, b.study.evaluation),
        ("schedules", a.study.schedules, b.study.schedules),
    ):
        if one != other:
            yield f"{name}: {one} there, {other} here"


def _parts(targets: list[storage.Target], holdings: list[Owned]) -> dict[tuple[str, int, str], list[Part]]:
    """Return the blocks of all datasets by scenario, cell and observer; cells are numbered as in the first."""
    first = holdings[0]
    numbers = {(s, digest): number for (s, number), digest in manifest.digests(first).items()}
    out: dict[tuple[str, int, str], list[Part]] = {}
    for target, owned in zip(targets, holdings, strict=True):
        digests = manifest.digests(owned)
        for b in sorted(block_files.present(target), key=lambda b: (b.seeds.first, -b.seeds.stop)):
            if wrong := block_files.damage(target, b, digests.get((b.scenario, b.cell), "")):
                raise UserError(
                    f"{target.name}/{b.name}: is damaged ({wrong}), expected a whole block; run its study again first."
                )
            number = numbers[b.scenario, digests[b.scenario, b.cell]]
            part = Part(target, b, b._replace(cell=number), str(owned.study.engine))
            out.setdefault((b.scenario, number, b.observer), []).append(part)
    return dict(sorted(out.items()))


def _pieces(parts: list[Part]) -> Iterator[tuple[str, pa.Buffer | None, int]]:
    """Yield for each part of one observer and cell its name, its bytes (None: all held already) and its runs held twice.

    A part of which earlier ones hold the middle is yielded as two.
    """
    seen: list[Part] = []
    held: list[Seeds] = []
    for part in parts:
        mine = part.block.seeds
        _equal(part, seen)
        left = gaps(held, mine, mine.stop)
        twice = mine.many - sum(each.many for each in left)
        seen.append(part)
        held += left
        if not left:
            yield part.block.name, None, twice
        for seeds in left:
            block = part.block._replace(seeds=seeds)
            yield block.name, _content(part, block), twice if seeds == left[0] else 0


def _content(part: Part, block: Block) -> pa.Buffer:
    """The bytes of a block of some seeds of a part; as they stand, if it is all of it."""
    if block != part.there:
        return parquet_io.encoded(cut(block_files.read(part.target, part.there), block))
    content = storage.get(part.target, block.name)
    if content is None:
        raise UserError(f"{part.target.name}/{block.name}: is gone, expected a dataset at rest; merge it again.")
    return content


def cut(table: pa.Table, block: Block) -> pa.Table:
    """Return the rows of a table that a block is to hold, with the cell numbered as the block says."""
    said = block_files.about(table)
    many = len(table) // (said["last"] - said["first"])
    rows = table.slice((block.seeds.first - said["first"]) * many, block.seeds.many * many)
    i = rows.schema.get_field_index("cell")
    rows = rows.set_column(i, rows.schema.field(i), pa.array([block.cell] * len(rows), pa.int64()))
    return block_files.sealed(rows, said | {"first": block.seeds.first, "last": block.seeds.stop})


def _equal(part: Part, seen: list[Part]) -> None:
    """Raise UserError where a part disagrees with one of those seen before that holds the same seeds."""
    for other in seen:
        both = common(part.block.seeds, other.block.seeds)
        if both.many:
            same = part.block._replace(seeds=both)
            a, b = (cut(block_files.read(p.target, p.there), same) for p in (other, part))
            if not a.equals(b):
                if _engine(part, b) != _engine(other, a) and of_one_run(a, b, BETWEEN_ENGINES):
                    continue
                apart = difference(a, b)
                how = "in more than numbers" if apart is None else f"by {apart.relative:.1e} of themselves"
                raise UserError(
                    f"{part.target.name}/{part.there.name}: its seeds {both.first} .. {both.stop - 1} differ {how} from those "
                    f"in {other.target.name}, expected equal rows; find out with pcbench verify which of them comes out again."
                )


def _engine(part: Part, table: pa.Table) -> tuple[str, str]:
    """What computed the rows of a block: the engine of its study, and how its observer went."""
    return part.engine, block_files.about(table)["flow"]


def _whole(holdings: list[Owned]) -> Owned:
    """The study over all seeds, with the cells as the first dataset numbers them."""
    studies = [c.study for c in holdings]
    each = [counted(s.first_seed, s.seeds) for s in studies]
    whole = Seeds(min(seeds.first for seeds in each), max(seeds.stop for seeds in each))
    study = studies[0].model_copy(update={"first_seed": whole.first, "seeds": whole.many})
    return Owned(study, holdings[0].cells, to_toml(study, holdings[0].cells))


def _closed(
    into: storage.Target, whole: Owned, targets: list[storage.Target], doubled: int, engines: list[str]
) -> MergeReport:
    """Close the merged dataset, where every observer has the same seeds."""
    there, lacking = block_files.present(into), run_missing.lacking(into, whole)
    if not lacking:
        close.close(into, whole, there, {"merged": [p.name for p in targets], "engines": engines})
    return MergeReport(len(there), doubled, lacking)
