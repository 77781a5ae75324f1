"""Pytrees as structs of C: a field for each array, named by its path, row after row."""

import keyword
import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.export.terms import Entries, Term, kind_of, known, scalar, stored, written

RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if int long register return
    short signed sizeof static struct switch union unsigned void volatile while real""".split()  # noqa: SIM905
)


class Field(NamedTuple):
    """One array of a struct."""

    name: str
    kind: str
    shape: tuple[int, ...]
    says: str = ""

    @property
    def size(self) -> int:
        """How many numbers it has; 0: C has no such field."""
        return int(np.prod(self.shape))


def fields(tree: Any, alone: str) -> list[Field]:
    """Return the fields of a pytree of arrays, in the order of its leaves; a tree that is one array is called `alone`."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    out: list[Field] = []
    for path, leaf in leaves:
        name = "_".join(filter(None, (re.sub(r"\W", "", _word(key)) for key in path))) or alone
        name = f"{name}_" if name in RESERVED or keyword.iskeyword(name) or name[0].isdigit() else name
        while any(name == f.name for f in out):
            name += "_"
        out.append(Field(name, kind_of(leaf.dtype), tuple(leaf.shape)))
    return out


def _word(key: Any) -> str:
    return str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key))))


def entries(pointer: str, given: Iterable[Field]) -> list[Entries]:
    """Return the entries of a struct's fields behind a pointer."""
    out = []
    for f in given:
        text = f"{pointer}->{f.name}"
        out.append(stored(text, f.shape) if f.shape else scalar(Term(text)))
    return out


def declared(name: str, given: Iterable[Field]) -> list[str]:
    """Return the lines that declare a struct; C has no empty one."""
    lines = ["typedef struct {"]
    for f in given:
        if f.size:
            shape = "" if len(f.shape) < 2 else f"{list(f.shape)}, row after row"
            about = "; ".join(filter(None, (f.says, shape)))
            array = f"[{f.size}]" if f.shape else ""
            lines.append(f"    {f.kind} {f.name}{array};{f' /* {about} */' if about else ''}")
    if len(lines) == 1:
        lines.append("    char nothing;")
    return [*lines, f"}} {name};"]


def initialiser(given: Iterable[Field], values: Iterable[Any]) -> list[str]:
    """Return the lines of an initialiser, field by field, eight numbers a line."""
    lines = []
    for f, value in zip(given, values, strict=True):
        if not f.size:
            continue
        each = [written(x) for x in known(value).flat]
        rows = [", ".join(each[i : i + 8]) for i in range(0, len(each), 8)]
        if f.shape:
            lines += [f"    .{f.name} = {{", *(f"        {row}," for row in rows), "    },"]
        else:
            lines.append(f"    .{f.name} = {each[0]},")
    return lines or ["    .nothing = 0,"]
