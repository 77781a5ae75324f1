"""What a study's cells have in common is computed once, and known by what it was computed from.

A design belongs to its cell. What is expensive in one is remembered by the numbers that it is computed from
(`synthesis.solvers.solve_or_load`, `synthesis.riccati.multirate`), so that cells which differ in nothing it reads share it.
"""

import inspect
import os
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel

from pcbench.errors import UserError, describe_exception, is_ours, line_of
from pcbench.observers import ObserverSpec
from pcbench.synthesis.certificate import Certificate, Design, DesignContext

ROOM = 256  # of each kind: as many schedules of 10,000 ticks are 100 MB,
DESIGNS = 4096  # and as many gains; with more of them the first are found again when their tasks are drawn
EXPECTED = "expected Design(gains, Certificate)"
T = TypeVar("T")


class Once(Protocol):
    """A function that makes things, each once."""

    def __call__(self, kind: str, key: Hashable, make: Callable[[], T], /) -> T:
        """Return what `make` makes; `key` says from what it is made, among things of one kind."""


def once() -> Once:
    """Return what makes things, and gives out what it has made before; of each kind the last used are kept."""
    kept: dict[str, OrderedDict[Hashable, Any]] = {}

    def ask(kind: str, key: Hashable, make: Callable[[], T]) -> T:
        mine: OrderedDict[Hashable, T] = kept.setdefault(kind, OrderedDict())
        if key not in mine:
            mine[key] = make()
        mine.move_to_end(key)
        if len(mine) > (DESIGNS if kind == "designs" else ROOM):
            mine.popitem(last=False)
        return mine[key]

    return ask


def anew(kind: str, key: Hashable, make: Callable[[], T]) -> T:
    """Make a thing, whatever was made before."""
    return make()


def run_design(label: str, entry: ObserverSpec, known: DesignContext, options: BaseModel) -> Design:
    """Return an observer's gains with their certificate; raise UserError where its design refuses, or is not as it must be."""
    code = getattr(inspect.unwrap(entry.design), "__code__", None)
    where = f", {os.path.basename(code.co_filename)} line {code.co_firstlineno}" if code else ""
    try:
        found = entry.design(known, options)
    except UserError:
        raise
    except Exception as error:
        if is_ours(entry.design):
            raise
        place = "" if line_of(error) else where
        raise UserError(
            f"observer {label}: design got {describe_exception(error)}{place}, {EXPECTED}; correct that line."
        ) from error
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(f"observer {label}: design returned {type(found).__name__}{where}, {EXPECTED}; correct it.")
    return found
