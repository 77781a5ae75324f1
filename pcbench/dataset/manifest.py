"""Whose folder it is: a dataset belongs to one study, may grow with it, and refuses another.

A study may grow: more seeds, more values of its axes, more scenarios, more observers. What decides a number may not change.
Cells keep their numbers; new ones follow. Where the study's text is lost or damaged, the blocks say whose they are.

A study's lost or damaged text made anew: every block says of which cell and options it is.
"""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

from pcbench import toml_text
from pcbench.dataset import block_files, storage, stored_code
from pcbench.dataset.block_files import Block
from pcbench.dataset.seed_ranges import Seeds, common, counted
from pcbench.dataset.study_diff import changes
from pcbench.errors import UserError
from pcbench.study import Study, parse
from pcbench.study.grid import Cell, Grid, channels_apart, numbered, with_engine
from pcbench.study.serialize import to_toml


def cells_of_blocks(target: storage.Target, grid: Grid, blocks: list[Block]) -> list[Cell]:
    """Return the study's cells: those with blocks numbered as the blocks' names say, the others after them.

    Raises UserError where a block is of another study: of other options, or of a cell that the study does not have.
    """
    with ThreadPoolExecutor() as pool:
        each = list(pool.map(lambda b: block_files.about_block(target, b), blocks))
    here: dict[str, list[Cell]] = {}
    for cell in grid.cells:
        here.setdefault(cell.scenario.name, []).append(cell)
    for b, said in zip(blocks, each, strict=True):
        if wrong := next(_apart(grid.study, here, b, said), None):
            raise UserError(
                f"{target.name}/study.toml: is gone or damaged, and {b.name} is not of the study given ({wrong}), expected the "
                "study that these blocks are of; run that, or give a new folder with --out."
            )
    numbers: dict[str, dict[int, str]] = {}
    for b, said in zip(blocks, each, strict=True):
        numbers.setdefault(b.scenario, {})[b.cell] = said["cell"]
    return numbered(grid.cells, {s: _in_order(found, [c.digest for c in here[s]]) for s, found in numbers.items()})


def _apart(study: Study, here: dict[str, list[Cell]], b: Block, said: dict[str, Any]) -> Iterator[str]:
    """Yield what tells a block from those of a study, a phrase each."""
    if not said:
        yield "it cannot be read"
        return
    for key, ours in (("study", study.name), ("root_seed", study.root_seed)):
        if said.get(key) != ours:
            yield f"{key}: {said.get(key)} there, {ours} here"
    mine = here.get(b.scenario)
    if not mine or b.observer not in mine[0].told:
        yield f"{b.observer} in {b.scenario}"
        return
    if said.get("options") != mine[0].told[b.observer]:
        yield f"options of {b.observer}"
    if said.get("cell") not in [c.digest for c in mine] or b.cell >= len(mine):
        yield "axes"


def _in_order(numbered: dict[int, str], every: list[str]) -> list[str]:
    """The digests of cells in order of number, with those that have no block under the numbers that are free."""
    rest = iter(digest for digest in every if digest not in numbered.values())
    return [numbered.get(i) or next(rest) for i in range(max(numbered) + 1)]


TEXT = "study.toml"
CLOSING = ("stats.parquet", "pairs.parquet", "provenance.json")  # written last: they say that a run is whole
BESIDE = ("tuning/", "training/", "draws/")  # tuned gains, and draws for guests: made before its own runs begin
EXACT = ("exact.parquet", "moments/")  # exact numbers, and how they go over time
WRITTEN = ("report.html", "fair.parquet", "examples/")  # what other commands write into a dataset by default
KEPT = ("options", "scenarios", "observers", "cells")  # under [resolved]
NOT_TOML_EITHER = (ValueError, KeyError, TypeError, AttributeError)
SHOWN = 3  # differences that a refusal names


class Owned(NamedTuple):
    """A study and the cells it has in its folder."""

    study: Study
    cells: list[Cell]
    text: str  # of study.toml
    overwrite: bool = False  # what an older run left goes when this one begins


def claim(target: storage.Target, grid: Grid, overwrite: bool = False) -> Owned:
    """Return the study with its cells numbered as in a target; raise UserError where that holds another study. Writes nothing.

    With `overwrite` a study that stands there is to be removed.
    """
    said = storage.text(target, TEXT)
    blocks = block_files.present(target)
    begun = toml_text.parse(said).get("engine") if said is not None and _readable(said) and not overwrite else None
    if begun is None and blocks and not overwrite:  # its text is lost
        begun = {"defined": "definition", "lifted": "products"}.get(
            block_files.about_block(target, blocks[0]).get("flow", "")
        )
    study, every = grid = with_engine(grid, begun)
    if overwrite and (blocks or said is not None):
        if said is not None and not blocks:
            read_text(target, said)
            _require_ours(target, (TEXT, *CLOSING, *EXACT, *WRITTEN, "code/"))
        stored_code.copies(target)
        return Owned(study, every, to_toml(study, every), True)
    if blocks and (said is None or not _readable(said)):
        every = cells_of_blocks(target, grid, blocks)
        return Owned(study, every, to_toml(study, every))
    if said is None:
        _require_ours(target)
        return Owned(study, every, to_toml(study, every))
    there = read_text(target, said)
    every = numbered(every, there["resolved"]["cells"])
    _only_what_stands(there, blocks)
    files = stored_code.files_in(target, there), stored_code.files_of(study)
    changed = [*changes(there, toml_text.parse(to_toml(study, every)), files), *_reshaped(target, there, study)]
    if changed and blocks:
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        raise UserError(
            f"{target.name}: holds the results of another study ({'; '.join(changed[:SHOWN])}{more}), expected the same one, "
            "or one with more seeds, cells or observers; give a new folder with --out, or start over with --overwrite."
        )
    if changed:  # nothing was finished there
        every = grid.cells
    return Owned(study, every, to_toml(study, every))


def _require_ours(target: storage.Target, ours: tuple[str, ...] = ()) -> None:
    """Raise UserError where a target without blocks holds other files than `ours` and what stands beside runs."""
    for name in storage.names(target):
        if not name.startswith((*BESIDE, *ours)):
            raise UserError(
                f"{target.name}: holds other files ({name}), expected a new or empty folder; give another one with --out."
            )


def opened(target: storage.Target, run: bool = False) -> Owned:
    """Return the study that stands in a target, with its cells; raise UserError where there is none.

    The code of a user's own observers is loaded from the dataset's copy where it is to be `run`, and else left alone.
    """
    said = storage.text(target, TEXT)
    if said is None:
        raise UserError(
            f"{target.name}: holds no study.toml, expected a folder that pcbench run has made; name that one."
        )
    there = read_text(target, said)
    study, every = parse.grid(_said(there), f"{target.name}/{TEXT}", stored_code.gate(target, there, run))
    return Owned(study, numbered(every, there["resolved"]["cells"]), said.decode())


def digests(owned: Owned) -> dict[tuple[str, int], str]:
    """Return by key what tells each cell of a study from all others."""
    return {c.key: c.digest for c in owned.cells}


def differences(a: Owned, b: Owned) -> list[str]:
    """Return what differs between two studies besides their seeds, engine and the order of their cells, a phrase each."""
    old, new = (toml_text.parse(each.text) for each in (a, b))
    for each in (old, new):
        each.update(first_seed=0, seeds=1, engine="")
        each["resolved"]["cells"] = {s: sorted(found) for s, found in each["resolved"]["cells"].items()}
    return list(dict.fromkeys([*changes(old, new), *map(_mirrored, changes(new, old))]))


def _mirrored(change: str) -> str:
    """Return a phrase of `changes(b, a)` as `changes(a, b)` would put it."""
    return re.sub(r": (.*) there, (.*) here$", r": \2 there, \1 here", change)


def begin(target: storage.Target, owned: Owned) -> None:
    """Delete the closing tables of an earlier run (with `overwrite` its blocks too), then write study.toml."""
    storage.make(target)
    for name in CLOSING:
        storage.remove(target, name)
    if owned.overwrite:
        for name in storage.names(target, "runs"):
            if block_files.block_of(name):
                storage.remove(target, name)
        for name in stored_code.copies(target):
            storage.remove(target, name)
    renew(target, owned)
    stored_code.keep(target, owned.study)


def renew(target: storage.Target, owned: Owned) -> None:
    """Write the study's text, unless it stands there already."""
    if storage.text(target, TEXT) != owned.text.encode():
        storage.put(target, TEXT, owned.text.encode())


def _study(target: storage.Target, there: dict[str, Any]) -> Study:
    where, gate = f"{target.name}/{TEXT}", stored_code.gate(target, there, False)
    return parse.described(_said(there) | {"seeds": 1}, where, gate)


def _said(there: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in there.items() if k != "resolved"}


def _only_what_stands(there: dict[str, Any], blocks: list[block_files.Block]) -> None:
    """Leave out the seeds that have no block: those of a run that was stopped bind nobody."""
    if blocks:
        standing = Seeds(min(b.seeds.first for b in blocks), max(b.seeds.stop for b in blocks))
        left = common(counted(there["first_seed"], there["seeds"]), standing)
        there.update(first_seed=left.first, seeds=left.many)


def _reshaped(target: storage.Target, there: dict[str, Any], study: Study) -> Iterator[str]:
    """Yield the axes whose column would hold lists where it holds numbers, or the other way about."""
    for name in sorted(channels_apart(_study(target, there)) ^ channels_apart(study)):
        yield f"axes.{name}: a number for all channels, and a list with one for each, there and here"


def _readable(said: bytes) -> bool:
    """Whether a study's text is as it was written."""
    try:
        _parts(said)
    except NOT_TOML_EITHER:
        return False
    return True


def read_text(target: storage.Target, said: bytes) -> dict[str, Any]:
    """Return what a study's text says; raise UserError where it is damaged."""
    try:
        return _parts(said)
    except NOT_TOML_EITHER:
        if many := len(block_files.present(target)):
            raise UserError(
                f"{target.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; run its study again "
                f"with --out {target.name} to have it written anew: the {many} blocks that stand are kept."
            ) from None
        raise UserError(
            f"{target.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; move it away, or give "
            "a new folder with --out."
        ) from None


def _parts(said: bytes) -> dict[str, Any]:
    """What a study's text says; raise one of NOT_TOML_EITHER where that is not what is written."""
    there = toml_text.parse(said)
    resolved = there["resolved"]
    numbers = isinstance(there["seeds"], int) and isinstance(there["first_seed"], int)
    parts = all(isinstance(v, dict) for k in KEPT[:2] for v in resolved[k].values())
    lists = all(isinstance(v, list) for k in KEPT[2:] for v in resolved[k].values())
    if not (numbers and lists and parts and isinstance(there.get("axes", {}), dict)):
        raise ValueError("not of the kinds that are written")
    return there
