"""`observers = "all"`: every observer of pcbench that can run in all cells of a study, and why each of the others cannot.

An observer is tried as a run would plan it, with its gains. What is refused in one cell is excluded from the study.
"""

from typing import Any

from pcbench.errors import UserError
from pcbench.machine import process
from pcbench.observers import OBSERVERS
from pcbench.planning.arrays import draft
from pcbench.study import read
from pcbench.study.cells import Grid
from pcbench.study.raw import Described, raw_of, where_of
from pcbench.study.read import ALL, FROM_HERE


def grid_of(study: Described, changes: dict[str, Any], overrides: list[str]) -> Grid:
    """Return a study with its cells, as `read.grid_of`; "all" among its observers becomes those that can run."""
    raw = raw_of(study, overrides, FROM_HERE)
    where = where_of(study, raw)
    raw |= {key: value for key, value in changes.items() if value is not None}
    return read.grid(resolved(raw, where), where, FROM_HERE)


def resolved(raw: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a raw study with every observer that can run in place of "all", and with the reasons of the others."""
    given = raw.get("observers")
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or ALL not in names:
        return raw
    kept, excluded = [name for name in names if name != ALL], {}
    labels = [*OBSERVERS, *(label for label in raw.get("options") or {} if label not in ("scenario", "target"))]
    for label in dict.fromkeys(labels):
        if label in kept:
            continue
        try:
            with process.float64():
                for cell in read.grid(raw | {"observers": [label]}, where, FROM_HERE).cells:
                    draft(cell, cell.options)
        except UserError as error:
            excluded[label] = str(error)
        else:
            kept.append(label)
    if not kept:
        label, reason = next(iter(excluded.items()))
        raise UserError(f"{where}: observers: no observer can run; the first, {label}, is refused: {reason}")
    return raw | {"observers": kept, "excluded": excluded or None}


def sentences(excluded: dict[str, str] | None) -> list[str]:
    """Return one sentence per excluded observer with its reason."""
    return [f"{label} is left out of all observers: {reason}" for label, reason in (excluded or {}).items()]
