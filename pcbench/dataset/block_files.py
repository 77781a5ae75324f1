"""The blocks of a dataset: which exist, which are valid, which are missing. No jax.

A block contains the runs of one observer in one cell over a range of seeds. It is one file, whose name identifies it.
No other record exists: the files on disk are the finished blocks. The ranges may differ in size, because the missing
seeds follow from the files.
"""

import json
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple
from urllib.parse import quote, unquote

import pyarrow as pa

from pcbench.dataset import columns, parquet_io, storage
from pcbench.dataset.seed_ranges import Seeds
from pcbench.errors import UserError

ABOUT = b"pcbench.block"  # the key in a file's metadata
NAME = re.compile(r"runs/scenario=([^/]+)/observer=([^/]+)/cell-(\d+)-seeds-(\d+)-(\d+)\.parquet")
DIGITS = 12  # of a seed or a cell's number; all that a study may ask for has fewer
OTHER_SCHEMA = "it is of another version of the tables"


class Block(NamedTuple):
    """The runs of one observer in one cell over a range of seeds."""

    scenario: str
    observer: str
    cell: int
    seeds: Seeds

    @property
    def name(self) -> str:
        """Return its file's name, relative to the dataset's folder."""
        folder = f"runs/scenario={quote(self.scenario, safe='')}/observer={quote(self.observer, safe='')}"
        return f"{folder}/cell-{self.cell:05d}-seeds-{self.seeds.first:010d}-{self.seeds.stop - 1:010d}.parquet"


Series = dict[tuple[str, int, str], list[Block]]  # blocks by scenario, cell and observer


def block_of(name: str) -> Block | None:
    """Return the block that a file's name identifies; None for any other name."""
    match = NAME.fullmatch(name)
    if not match:
        return None
    scenario, observer, cell, first, last = match.groups()
    if max(len(cell), len(first), len(last)) > DIGITS or int(last) < int(first):
        return None
    return Block(unquote(scenario), unquote(observer), int(cell), Seeds(int(first), int(last) + 1))


def present(target: storage.Target) -> list[Block]:
    """Return the blocks with a file, sorted; raise UserError for a file that is not a block."""
    out = []
    for name in storage.file_names(target, "runs"):
        block = block_of(name)
        if block is None:
            raise UserError(
                f"{target.name}/{name}: is no block of a study, expected cell-*-seeds-*.parquet; move it away."
            )
        out.append(block)
    return sorted(out)


def read_block(target: storage.Target, block: Block) -> pa.Table:
    """Return a block's rows, with every page checked; raise UserError with the file's name if it is damaged."""
    table = _table(target, block)
    if isinstance(table, str):
        raise UserError(
            f"{target.name}/{block.name}: is damaged ({table}), expected a complete block; run the study again to recompute it."
        )
    return table


def _table(target: storage.Target, block: Block) -> pa.Table | str:
    """Return a block's rows, or the reason why they cannot be read."""
    content = storage.read_buffer(target, block.name)
    if content is None:
        return "it is missing"
    try:
        return parquet_io.parse_table(content)
    except parquet_io.DAMAGE as error:
        return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")


def about(table: pa.Table) -> storage.Json:
    """Return a block's metadata; empty if they cannot be read."""
    return _about(table.schema.metadata)


def about_block(target: storage.Target, block: Block) -> storage.Json:
    """Return a block's metadata from the footer of its file alone."""
    footer = storage.read_footer(target, block.name)
    return _about(footer.metadata) if footer else {}


def _about(metadata: Mapping[bytes, bytes] | None) -> storage.Json:
    try:
        return dict(json.loads((metadata or {}).get(ABOUT, b"{}")))
    except ValueError:
        return {}


def seal_block(table: pa.Table, about: Mapping[str, object]) -> pa.Table:
    """Return rows with the block's metadata and their digest."""
    text = {**about, "rows": len(table)}
    text["digest"] = digest(table, text)
    return parquet_io.with_metadata(table, {ABOUT: json.dumps(text, sort_keys=True).encode()})


def digest(table: pa.Table, about: Mapping[str, object]) -> str:
    """Return the digest of a block's metadata and of the bits of its numbers; texts are covered by page checksums."""
    text = json.dumps({k: v for k, v in about.items() if k != "digest"}, sort_keys=True)
    return parquet_io.digest(table, text.encode(), texts=False)


def damage(target: storage.Target, block: Block, cell_digest: str) -> str | None:
    """Return what is wrong with a block's file; None if it is valid and of the cell with this digest."""
    table = _table(target, block)
    if isinstance(table, str):
        return table
    metadata = about(table)
    if not columns.has_schema(parquet_io.metadata(table)):
        return OTHER_SCHEMA
    if metadata.get("cell") != cell_digest:
        return "it is of another cell"
    if (metadata.get("observer"), metadata.get("first"), metadata.get("last")) != (block.observer, *block.seeds):
        return "its name belongs to another block"
    if len(table) != metadata.get("rows") or len(table) % block.seeds.many:
        return f"it has {len(table)} rows, expected {metadata.get('rows')}"
    if digest(table, metadata) != metadata.get("digest"):
        return "its rows are not those that were written"
    return None


def series(blocks: Iterable[Block]) -> Series:
    """Return blocks by scenario, cell and observer, in their order."""
    out: Series = {}
    for b in blocks:
        out.setdefault((b.scenario, b.cell, b.observer), []).append(b)
    return out


def drop_overlaps(blocks: Iterable[Block]) -> list[Block]:
    """Return all blocks except those that would duplicate a row, sorted."""
    out: list[Block] = []
    for group in series(sorted(blocks, key=lambda b: (b.seeds.first, -b.seeds.stop))).values():
        stop = -1
        for block in group:
            if block.seeds.first >= stop:
                out.append(block)
                stop = block.seeds.stop
    return sorted(out)
