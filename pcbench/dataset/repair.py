"""A study's text that is lost or damaged, made anew: every block says which cell and which options it is of."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from pcbench.dataset import block_files, store
from pcbench.dataset.block_files import Block
from pcbench.errors import UserError
from pcbench.study import Study, observers_of, options_of, scenarios_of
from pcbench.study.cells import Cell, cells_of, identity, told


def cells_of_blocks(target: store.Target, study: Study, blocks: list[Block]) -> list[Cell]:
    """Return the cells of the study that blocks are of, numbered as their names say, and its other cells after them.

    Raises UserError where a block is of another study: of other options, or of a cell that the study does not have.
    """
    with ThreadPoolExecutor() as pool:
        each = list(pool.map(lambda b: block_files.about_block(target, b), blocks))
    here = {s: [identity(c, study.root_seed) for c in cells_of(study) if c.scenario.name == s] for s in study.scenarios}
    for b, said in zip(blocks, each, strict=True):
        if wrong := next(_apart(study, here, b, said), None):
            raise UserError(
                f"{target.name}/study.toml: is gone or damaged, and {b.name} is not of the study given ({wrong}), expected the "
                "study that these blocks are of; run that, or give a new folder with --out."
            )
    numbers: dict[str, dict[int, str]] = {}
    for b, said in zip(blocks, each, strict=True):
        numbers.setdefault(b.scenario, {})[b.cell] = said["cell"]
    return cells_of(study, {s: _in_order(found, here[s]) for s, found in numbers.items()})


def _apart(study: Study, here: dict[str, list[str]], b: Block, said: dict[str, Any]) -> Iterator[str]:
    """Yield what tells a block from those of a study, a phrase each."""
    if not said:
        yield "it cannot be read"
        return
    for key, mine in (("study", study.name), ("root_seed", study.root_seed)):
        if said.get(key) != mine:
            yield f"{key}: {said.get(key)} there, {mine} here"
    if b.observer not in (observers_of(study, b.scenario) if b.scenario in here else []):
        yield f"{b.observer} in {b.scenario}"
        return
    if said.get("options") != told(options_of(study, scenarios_of(study)[b.scenario], b.observer)):
        yield f"options of {b.observer}"
    if said.get("cell") not in here[b.scenario] or b.cell >= len(here[b.scenario]):
        yield "axes"


def _in_order(numbered: dict[int, str], every: list[str]) -> list[str]:
    """The digests of cells in order of number, with those that have no block in the places that are free."""
    rest = iter(digest for digest in every if digest not in numbered.values())
    return [numbered.get(i) or next(rest) for i in range(max(numbered) + 1)]
