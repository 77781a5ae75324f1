"""The study of a folder: a dataset belongs to one study, may be extended, and refuses another study.

A study may be extended by seeds, axis values, scenarios and observers. Everything that determines a number is fixed.
Cells keep their numbers, and new ones follow. If study.toml is missing or damaged, it is restored from the blocks,
whose metadata identify their cell and options.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

from pcbench import toml_text
from pcbench.dataset import block_files, storage, stored_code
from pcbench.dataset.block_files import Block
from pcbench.dataset.seed_ranges import Seeds, common, seed_range
from pcbench.dataset.study_diff import changes
from pcbench.errors import UserError
from pcbench.study import Study, parse
from pcbench.study.grid import Cell, Grid, axes_with_lists, command_columns, number_cells, with_engine
from pcbench.study.serialize import to_toml
from pcbench.toml_text import TomlTable

TEXT = "study.toml"
CLOSING = ("stats.parquet", "pairs.parquet", "provenance.json")  # written last: if they exist, the study is complete
KNOWN_FILES = ("tuning/", "training/", "draws/")  # tuned gains, and noise for external programs: before the runs begin
EXACT = ("exact.parquet", "moments/")  # exact numbers, and exact moments over time
OUTPUT_FILES = ("report.html", "fair.parquet", "examples/")  # what other commands write into a dataset by default
MAX_SHOWN = 3  # differences in an error message


class StudyClaim(NamedTuple):
    """A study with its numbered cells in a folder."""

    study: Study
    cells: list[Cell]
    text: str  # of study.toml
    overwrite: bool = False  # remove the files of an older run at the beginning


def claim(target: storage.Target, grid: Grid, overwrite: bool = False) -> StudyClaim:
    """Return the study with cells numbered as in the target; raise UserError if it holds another study.

    Writes nothing. With `overwrite`, an existing study will be removed.
    """
    text, blocks = storage.read_bytes(target, TEXT), block_files.present(target)
    table = None if text is None else _parse_manifest(text)
    engine = None if overwrite or table is None else table.get("engine")
    if engine is None and blocks and not overwrite:  # its text is lost
        engine = block_files.about_block(target, blocks[0]).get("engine")
    study, cells = grid = with_engine(grid, engine)
    if overwrite and (blocks or text is not None):
        if text is not None and not blocks:
            read_text(target, text)
            _require_ours(target, (TEXT, *CLOSING, *EXACT, *OUTPUT_FILES, "code/"))
        stored_code.copies(target)
    elif text is None and not blocks:
        _require_ours(target)
    elif table is None and blocks:
        cells = _cells_of_blocks(target, grid, blocks)
    elif text is not None:
        table = read_text(target, text)
        cells = number_cells(cells, table["resolved"]["cells"])
        if blocks:  # seeds of a stopped run that have no block may change
            block_seeds = Seeds(min(b.seeds.first for b in blocks), max(b.seeds.stop for b in blocks))
            seeds = common(seed_range(table["first_seed"], table["seeds"]), block_seeds)
            table |= {"first_seed": seeds.first, "seeds": seeds.many}
        files = stored_code.files_in(target, table), stored_code.files_of(study)
        phrases = [
            *changes(table, toml_text.parse(to_toml(study, cells)), files),
            *_shape_changes(target, table, study),
        ]
        if phrases and blocks:
            more = f" and {len(phrases) - MAX_SHOWN} more" if len(phrases) > MAX_SHOWN else ""
            raise UserError(
                f"{target.name}: contains the results of another study ({'; '.join(phrases[:MAX_SHOWN])}{more}), expected the "
                "same one, or one with more seeds, cells or observers; give a new folder with --out, or start over with "
                "--overwrite."
            )
        if phrases:  # nothing was finished there
            cells = grid.cells
    return StudyClaim(study, cells, to_toml(study, cells), overwrite and bool(blocks or text is not None))


def _cells_of_blocks(target: storage.Target, grid: Grid, blocks: list[Block]) -> list[Cell]:
    """Return the study's cells; those with blocks are numbered as in the blocks' names, and others get free numbers.

    Raises UserError if a block belongs to another study: to other options, or to a cell that the study does not have.
    """
    study, numbers = grid.study, {name: dict[int, str]() for name in grid.study.scenarios}
    for b in blocks:
        about, cells = block_files.about_block(target, b), [c for c in grid.cells if c.scenario.name == b.scenario]
        options = {label: digest for c in cells[:1] for label, digest in c.options_digests.items()}
        root_seed = about.get("root_seed")
        conflicts = {
            "it cannot be read": not about,
            f"study: {about.get('study')} there, {study.name} here": about.get("study") != study.name,
            f"root_seed: {root_seed} there, {study.root_seed} here": root_seed != study.root_seed,
            f"{b.observer} in {b.scenario}": b.observer not in options,
            f"options of {b.observer}": about.get("options") != options.get(b.observer),
            "axes": about.get("cell") not in [c.digest for c in cells] or b.cell >= len(cells),
        }
        if any(conflicts.values()):
            first = next(phrase for phrase, applies in conflicts.items() if applies)
            raise UserError(
                f"{target.name}/study.toml: is missing or damaged, and {b.name} is not of the study given ({first}); run "
                "the study that these blocks are of, or give a new folder with --out."
            )
        numbers[b.scenario][b.cell] = about["cell"]
    order = {}
    for scenario, digests in numbers.items():
        unused = (c.digest for c in grid.cells if c.scenario.name == scenario and c.digest not in digests.values())
        order[scenario] = [digests.get(i) or next(unused) for i in range(max(digests, default=-1) + 1)]
    return number_cells(grid.cells, order)


def _require_ours(target: storage.Target, prefixes: tuple[str, ...] = ()) -> None:
    """Raise UserError if a target without blocks has a file that is not a dataset's and begins with none of `prefixes`."""
    for name in storage.file_names(target):
        if not name.startswith((*KNOWN_FILES, *prefixes)):
            raise UserError(
                f"{target.name}: contains other files ({name}), expected a new or empty folder; give another one with --out."
            )


def load_manifest(target: storage.Target, run: bool = False) -> StudyClaim:
    """Return the study of a target with its cells; raise UserError if there is none.

    The code of user-defined observers is loaded from the dataset's copy if it will be `run`, and otherwise not at all.
    """
    text = storage.read_bytes(target, TEXT)
    if text is None:
        raise UserError(
            f"{target.name}: contains no study.toml, or does not exist; give a folder that pcbench run has written."
        )
    table = read_text(target, text)
    study, cells = parse.grid(_drop_resolved(table), f"{target.name}/{TEXT}", stored_code.gate(target, table, run))
    return StudyClaim(study, number_cells(cells, table["resolved"]["cells"]), text.decode())


def digests(claim: StudyClaim) -> dict[tuple[str, int], str]:
    """Return the digest of each cell by its key."""
    return {c.key: c.digest for c in claim.cells}


def differences(a: StudyClaim, b: StudyClaim) -> list[str]:
    """Return the differences of two studies, except seeds, engine and the order of cells, one phrase each."""
    old, new = (toml_text.parse(t.text) for t in (a, b))
    for t in (old, new):
        t |= {"first_seed": 0, "seeds": 1, "engine": ""}
        t["resolved"]["cells"] = {s: sorted(digests) for s, digests in t["resolved"]["cells"].items()}
    reverse = [re.sub(r": (.*) there, (.*) here$", r": \2 there, \1 here", change) for change in changes(new, old)]
    return list(dict.fromkeys([*changes(old, new), *reverse]))


def begin(target: storage.Target, claim: StudyClaim) -> None:
    """Delete the closing tables of an earlier run (with `overwrite` its blocks too), then write study.toml."""
    storage.create_folder(target)
    for name in CLOSING:
        storage.remove(target, name)
    if claim.overwrite:
        for name in storage.file_names(target, "runs"):
            if block_files.block_of(name):
                storage.remove(target, name)
        for name in stored_code.copies(target):
            storage.remove(target, name)
    renew(target, claim)
    stored_code.store_code(target, claim.study)


def renew(target: storage.Target, claim: StudyClaim) -> None:
    """Write the study's text, unless it is already there."""
    if storage.read_bytes(target, TEXT) != claim.text.encode():
        storage.write_file(target, TEXT, claim.text.encode())


def _drop_resolved(table: TomlTable) -> TomlTable:
    return {k: v for k, v in table.items() if k != "resolved"}


def _shape_changes(target: storage.Target, table: TomlTable, study: Study) -> Iterator[str]:
    """Yield the axes whose column would change between numbers and lists."""
    where, gate = f"{target.name}/{TEXT}", stored_code.gate(target, table, False)
    old = parse.build_study(_drop_resolved(table) | {"seeds": 1}, where, gate)
    for name in sorted(axes_with_lists(old) ^ axes_with_lists(study)):
        yield f"axes.{name}: a number for all channels, and a list with one for each, there and here"
    for name in sorted(command_columns(old) ^ command_columns(study)):
        yield f"{name}: no scenario has a controller, and one has, there and here"


def read_text(target: storage.Target, text: bytes) -> TomlTable:
    """Return the parsed content of study.toml; raise UserError if it is damaged."""
    if (table := _parse_manifest(text)) is not None:
        return table
    n_blocks = len(block_files.present(target))
    remedy = (
        f"run its study again with --out {target.name} to write it again: its {n_blocks} blocks are kept."
        if n_blocks
        else "move it away, or give a new folder with --out."
    )
    raise UserError(f"{target.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; {remedy}")


def _parse_manifest(text: bytes) -> TomlTable | None:
    """The parsed content of study.toml; None if its entries have wrong types."""
    try:
        table = toml_text.parse(text)
        resolved = table["resolved"]
        has_numbers = isinstance(table["seeds"], int) and isinstance(table["first_seed"], int)
        has_tables = all(isinstance(v, dict) for k in ("options", "scenarios") for v in resolved[k].values())
        has_lists = all(isinstance(v, list) for k in ("observers", "cells") for v in resolved[k].values())
        return table if has_numbers and has_lists and has_tables and isinstance(table.get("axes", {}), dict) else None
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
