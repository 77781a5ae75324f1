"""Whose folder it is: a dataset belongs to one study, may grow with it, and refuses another.

A study may grow: more seeds, more values of its axes, more scenarios, more observers. What decides a number may not change.
Cells keep their numbers; new ones follow. Where the study's text is lost or damaged, the blocks say whose they are (`repair`).
"""

import tomllib
from typing import Any, NamedTuple

from pcbench.dataset import block_files, repair, store
from pcbench.dataset.changes import changes
from pcbench.dataset.seeds import Seeds, common, counted
from pcbench.errors import UserError
from pcbench.study import Study
from pcbench.study.cells import Cell, cells_of, channels_apart, identity, to_toml
from pcbench.study.read import NOT_TOML, parse

TEXT = "study.toml"
CLOSING = ("stats.parquet", "pairs.parquet", "provenance.json")  # written last: they say that a run is whole
BESIDE = ("tuning/", "training/")  # of a study whose gains are tuned: made before its own runs begin
KEPT = ("options", "scenarios", "observers", "cells")  # under [resolved]
NOT_TOML_EITHER = (*NOT_TOML, KeyError, TypeError, AttributeError)
SHOWN = 3  # differences that a refusal names


class Claim(NamedTuple):
    """A study and the cells it has in its folder."""

    study: Study
    cells: list[Cell]
    text: str  # of study.toml
    fresh: bool = False  # what an older run left goes when this one begins


def claim(place: store.Target, study: Study, fresh: bool = False) -> Claim:
    """Return the study with its cells as numbered in a place; raise UserError where that belongs to another. Writes nothing.

    With `fresh` a study of pcbench's own that stands there is to go.
    """
    said = store.text(place, TEXT)
    blocks = block_files.present(place)
    if fresh and (blocks or said is not None):
        if said is not None and not blocks:
            _read(place, said)
        every = cells_of(study)
        return Claim(study, every, to_toml(study, every), True)
    if blocks and (said is None or not _readable(said)):
        every = repair.cells_of_blocks(place, study, blocks)
        return Claim(study, every, to_toml(study, every))
    if said is None:
        others = [name for name in store.names(place) if not name.startswith(BESIDE)]
        if others:
            raise UserError(
                f"{place.name}: holds other files ({others[0]}), expected a new or empty folder; give another one with --out."
            )
        every = cells_of(study)
        return Claim(study, every, to_toml(study, every))
    there = _read(place, said)
    every = cells_of(study, there["resolved"]["cells"])
    _only_what_stands(there, blocks)
    changed = [*changes(there, tomllib.loads(to_toml(study, every))), *_reshaped(place, there, study)]
    if changed and blocks:
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        raise UserError(
            f"{place.name}: holds the results of another study ({'; '.join(changed[:SHOWN])}{more}), expected the same one, or "
            "one with more seeds, cells or observers; give a new folder with --out, or start over with --fresh."
        )
    if changed:  # nothing was finished there
        every = cells_of(study)
    return Claim(study, every, to_toml(study, every))


def opened(place: store.Target) -> Claim:
    """Return the study that stands in a place, with its cells; raise UserError where there is none."""
    said = store.text(place, TEXT)
    if said is None:
        raise UserError(
            f"{place.name}: holds no study.toml, expected a folder that pcbench run has made; name that one."
        )
    there = _read(place, said)
    study = _study(place, there)
    return Claim(study, cells_of(study, there["resolved"]["cells"]), said.decode())


def digests(claimed: Claim) -> dict[tuple[str, int], str]:
    """Return by key what tells each cell of a study from all others."""
    return {c.key: identity(c, claimed.study.root_seed) for c in claimed.cells}


def differences(a: Claim, b: Claim) -> list[str]:
    """Return what differs between two studies besides their seeds and the order of their cells, a phrase each."""
    old, new = (tomllib.loads(each.text) for each in (a, b))
    for each in (old, new):
        each.update(first_seed=0, seeds=1)
        each["resolved"]["cells"] = {s: sorted(found) for s, found in each["resolved"]["cells"].items()}
    return list(dict.fromkeys([*changes(old, new), *changes(new, old)]))


def numbers_in(claimed: Claim) -> dict[str, list[str]]:
    """Return by scenario the digests of the cells in order of number, as a study's text says."""
    return dict(tomllib.loads(claimed.text)["resolved"]["cells"])


def begin(place: store.Target, claimed: Claim) -> None:
    """Make the place the study's own, before anything is written there; what closes an older run goes."""
    store.make(place)
    for name in CLOSING:
        store.remove(place, name)
    if claimed.fresh:
        for name in store.names(place, "runs"):
            if block_files.block_of(name):
                store.remove(place, name)
    renew(place, claimed)


def renew(place: store.Target, claimed: Claim) -> None:
    """Put the study's text into its place, where it says something else."""
    if store.text(place, TEXT) != claimed.text.encode():
        store.put(place, TEXT, claimed.text.encode())


def _study(place: store.Target, there: dict[str, Any]) -> Study:
    return parse({k: v for k, v in there.items() if k != "resolved"}, f"{place.name}/{TEXT}")


def _only_what_stands(there: dict[str, Any], blocks: list[block_files.Block]) -> None:
    """Take the seeds of a study that have no block for not yet asked: a run with more that was stopped binds nobody."""
    if blocks:
        standing = Seeds(min(b.seeds.first for b in blocks), max(b.seeds.stop for b in blocks))
        left = common(counted(there["first_seed"], there["seeds"]), standing)
        there.update(first_seed=left.first, seeds=left.many)


def _reshaped(place: store.Target, there: dict[str, Any], study: Study) -> Any:
    """Yield the axes whose column would hold lists where it holds numbers, or the other way about."""
    for name in sorted(channels_apart(_study(place, there | {"seeds": 1})) ^ channels_apart(study)):
        yield f"axes.{name}: a number for all channels, and a list with one for each, there and here"


def _readable(said: bytes) -> bool:
    """Whether a study's text is as it was written."""
    try:
        _parts(said)
    except NOT_TOML_EITHER:
        return False
    return True


def _read(place: store.Target, said: bytes) -> dict[str, Any]:
    """Return what a study's text says; raise UserError where it is damaged."""
    try:
        return _parts(said)
    except NOT_TOML_EITHER:
        if many := len(block_files.present(place)):
            raise UserError(
                f"{place.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; run its study again "
                f"with --out {place.name} to have it written anew: the {many} blocks that stand are kept."
            ) from None
        raise UserError(
            f"{place.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; move it away, or give "
            "a new folder with --out."
        ) from None


def _parts(said: bytes) -> dict[str, Any]:
    """What a study's text says; raise one of NOT_TOML_EITHER where that is not what is written."""
    there = tomllib.loads(said.decode())
    resolved = there["resolved"]
    numbers = isinstance(there["seeds"], int) and isinstance(there["first_seed"], int)
    parts = all(isinstance(v, dict) for k in KEPT[:2] for v in resolved[k].values())
    lists = all(isinstance(v, list) for k in KEPT[2:] for v in resolved[k].values())
    if not (numbers and lists and parts and isinstance(there.get("axes", {}), dict)):
        raise ValueError("not of the kinds that are written")
    return there
