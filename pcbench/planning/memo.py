"""Nothing is computed twice: what a study's cells have in common is found once, and known by what it was found from.

A design is known by what it has looked at: a `DesignContext` that notes which of its fields are read is given to it, and a
later cell whose fields of those names hold the same has the same design. So gains that see no noise are found once for all
noises, and nobody has to say what an observer sees. Only pcbench's own designs are taken to be functions of what they read.
"""

import inspect
import os
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from functools import partial
from types import FunctionType
from typing import Any

import jax
import numpy as np

from pcbench.errors import UserError, is_ours, line_of, raised
from pcbench.observers import ObserverSpec
from pcbench.synthesis.certificate import Certificate, Design, DesignContext

ROOM = 256  # of each kind: as many schedules of 10,000 ticks are 100 MB,
DESIGNS = 4096  # and as many gains; with more of them the first are found again when their tasks are drawn
EXPECTED = "expected Design(gains, Certificate)"
Once = Callable[[str, Hashable, Callable[[], Any]], Any]  # (kind, what it is made from, how) -> what is made


def once() -> Once:
    """Return what makes things, and gives out what it has made before; of each kind the last used are kept."""
    kept: dict[str, OrderedDict[Hashable, Any]] = {}

    def ask(kind: str, key: Hashable, make: Callable[[], Any]) -> Any:
        mine = kept.setdefault(kind, OrderedDict())
        if key in mine:
            mine.move_to_end(key)
            return mine[key]
        found = mine[key] = make()
        if len(mine) > (DESIGNS if kind == "designs" else ROOM):
            mine.popitem(last=False)
        return found

    return ask


def anew(kind: str, key: Hashable, make: Callable[[], Any]) -> Any:
    """Make a thing, whatever was made before."""
    return make()


def designed(label: str, entry: ObserverSpec, known: DesignContext, options: Any) -> Design:
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
        raise UserError(f"observer {label}: design got {raised(error)}{place}, {EXPECTED}; mend that line.") from error
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(f"observer {label}: design returned {type(found).__name__}{where}, {EXPECTED}; mend it.")
    return found


class Watched(DesignContext):
    """A Setting that notes which of its fields are read; whoever takes it apart reads all. It must be one: designs ask."""

    def __getattribute__(self, name: str) -> Any:
        """Return what a Setting does."""
        if name in DesignContext._fields:
            tuple.__getattribute__(self, "__dict__").setdefault("read", set()).add(name)
        return tuple.__getattribute__(self, name)

    def __iter__(self) -> Iterator[Any]:
        """Return all fields in turn."""
        return iter([getattr(self, name) for name in DesignContext._fields])

    def __getitem__(self, at: Any) -> Any:
        """Return a field, or some, by number."""
        return tuple(self)[at]


def design(ask: Once, cell: Hashable, label: str, entry: ObserverSpec, known: DesignContext, options: Any) -> Design:
    """Return an observer's design for a setting; that of an earlier cell where this one differs in nothing it looked at."""
    who = label, entry.design, id(options)  # `fields` keeps them alive
    if not is_ours(entry.design):
        mine: Design = ask("designs", (*who, cell), lambda: (options, designed(label, entry, known, options)))[1]
        return mine
    _, fields = ask("fields", who, lambda: (options, set()))

    def make() -> Design:
        watched = Watched(*known)
        out = designed(label, entry, watched, options)
        fields.update(watched.__dict__.get("read", ()))
        return out

    before = frozenset(fields)
    key = _seen(known, before)
    out: Design = make() if key is None or not before else ask("designs", (*who, before, key), make)
    if (now := frozenset(fields)) != before and (key := _seen(known, now)) is not None:
        ask("designs", (*who, now, key), lambda: out)  # what looked at more is known by all of it
    return out


def _seen(known: DesignContext, fields: frozenset[str]) -> Hashable | None:
    """What a setting holds in some fields, as a key; None where it cannot be told."""
    try:
        return tuple(key_of(getattr(known, name)) for name in sorted(fields))
    except TypeError:
        return None


def key_of(what: Any) -> Hashable:
    """Return a key that equal numbers share, to the bit; raise TypeError for what has none."""
    if what is None or isinstance(what, bool | int | float | str):
        return type(what), repr(what)
    if isinstance(what, np.ndarray | np.generic | jax.Array):
        numbers = np.asarray(what)
        return numbers.dtype.str, numbers.shape, numbers.tobytes()
    if isinstance(what, tuple | list):
        return type(what), *map(key_of, what)
    if isinstance(what, dict):
        return dict, *((key_of(name), key_of(value)) for name, value in what.items())
    if isinstance(what, partial):
        return type(what), key_of(what.func), key_of(what.args), key_of(what.keywords)
    if isinstance(what, FunctionType):
        return what
    raise TypeError(f"{type(what).__name__} has no key")
