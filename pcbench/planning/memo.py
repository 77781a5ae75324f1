"""Cache of values that the grid points of a study share, and the design of an observer's gains.

Each grid point has its own design. The expensive parts of a design are cached by the numbers they depend on
(`synthesis.solvers.solve_or_load`, `synthesis.riccati.multirate`), so that grid points with the same numbers share them.
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

ROOM = 256  # entries of each kind: this many schedules of 10,000 ticks take 100 MB
DESIGNS = 4096  # entries of designs; if a study has more, the oldest are recomputed when their tasks are drafted
EXPECTED = "expected Design(gains, Certificate)"
T = TypeVar("T")


class Cache(Protocol):
    """A function that returns a cached value or computes it."""

    def __call__(self, kind: str, key: Hashable, make: Callable[[], T], /) -> T:
        """Return the value of `make()`; `key` has everything it depends on, among values of one `kind`."""


def new_cache() -> Cache:
    """Return a cache that keeps the most recently used values of each kind."""
    by_kind: dict[str, OrderedDict[Hashable, Any]] = {}

    def cache(kind: str, key: Hashable, make: Callable[[], T]) -> T:
        entries: OrderedDict[Hashable, T] = by_kind.setdefault(kind, OrderedDict())
        if key not in entries:
            entries[key] = make()
        entries.move_to_end(key)
        if len(entries) > (DESIGNS if kind == "designs" else ROOM):
            entries.popitem(last=False)
        return entries[key]

    return cache


def no_cache(kind: str, key: Hashable, make: Callable[[], T]) -> T:
    """Compute the value without a cache."""
    return make()


def run_design(label: str, entry: ObserverSpec, context: DesignContext, options: BaseModel) -> Design:
    """Return an observer's gains with their certificate; raise UserError if the design fails or does not return a Design."""
    code = getattr(inspect.unwrap(entry.design), "__code__", None)
    where = f", {os.path.basename(code.co_filename)} line {code.co_firstlineno}" if code else ""
    try:
        design = entry.design(context, options)
    except UserError:
        raise
    except Exception as error:
        if is_ours(entry.design):
            raise
        place = "" if line_of(error) else where
        raise UserError(
            f"observer {label}: design got {describe_exception(error)}{place}, {EXPECTED}; correct that line."
        ) from error
    if not isinstance(design, Design) or not isinstance(design.certificate, Certificate):
        raise UserError(f"observer {label}: design returned {type(design).__name__}{where}, {EXPECTED}; correct it.")
    return design
