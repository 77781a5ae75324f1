"""A study's lost or damaged text made anew: every block says of which cell and options it is."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from pcbench.dataset import block_files, storage
from pcbench.dataset.block_files import Block
from pcbench.errors import UserError
from pcbench.study import Study
from pcbench.study.grid import Cell, Grid, numbered


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
