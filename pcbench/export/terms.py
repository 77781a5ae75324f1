"""Numbers of a program in C: how each is written, and the lines that compute them.

An array is a NumPy object array. Its entries are known numbers or `Term`s. NumPy moves entries here, so such operations
produce no code.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

Entry: TypeAlias = Any  # a Term, or a number that is known, NumPy's or Python's
Entries = np.ndarray[Any, Any]  # of object: each an Entry
LONG = 2**31  # an integer from here on is written as a long one
KINDS = {"float64": "real", "float32": "real", "bool": "bool"} | {
    f"{sign}int{bits}": f"{sign}int{bits}_t" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


class Term(NamedTuple):
    """One number that is not known before the program runs."""

    text: str  # how it is read: a name, or an entry of an array
    store: str = ""  # the array that contains it,
    base: str = ""  # behind an index that is computed,
    place: int = 0  # so many entries


class Writer:
    """The lines of one function during translation, and the multiplications of floats in them."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.depth = 1
        self.products = 0
        self.checks = 0  # lines that set `outside`
        self._names = count(1)

    def say(self, line: str) -> None:
        """Write one line."""
        self.lines.append("    " * self.depth + line)

    def name(self, letter: str) -> str:
        """Return an unused name."""
        return f"{letter}{next(self._names)}"

    def let(self, kind: str, expression: str, products: int = 0) -> Term:
        """Write a variable with this value, and return it."""
        name = self.name("t")
        self.products += products
        self.say(f"const {kind} {name} = {expression};")
        return Term(name)

    def check(self, within: Entries) -> None:
        """Write a test that records an index beyond the room unless all of these conditions are true."""
        conditions = {as_c(x) for x in within.flat} - {"true"}
        self.checks += len(conditions)
        for text in sorted(conditions):
            self.say(f"outside = outside || !{text};")

    def array(self, kind: str, values: Entries) -> Entries:
        """Write an array with these entries, and return its entries."""
        name, texts = self.name("a"), [as_c(x) for x in values.flat]
        qualifier = "static const " if not any(isinstance(x, Term) for x in values.flat) else ""
        self.say(f"{qualifier}{kind} {name}[{values.size}] = {{{', '.join(texts)}}};")
        return array_entries(name, values.shape)

    def room(self, kind: str, shape: tuple[int, ...]) -> Entries:
        """Write an uninitialised array, and return its entries; a scalar is a plain variable."""
        name, size = self.name("v"), int(np.prod(shape))
        if size:
            self.say(f"{kind} {name}{f'[{size}]' if shape else ''};")
        return array_entries(name, shape) if shape else scalar(Term(name))

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """Write the lines inside as a block, whose multiplications are counted separately."""
        self.say(head + " {")
        before, self.products = self.products, 0
        self.depth += 1
        yield
        self.count()
        self.depth -= 1
        self.products = before
        self.say("}")

    def count(self) -> None:
        """Write the count of multiplications of this block, once its lines are complete."""
        if self.products:
            self.say(f"PRODUCTS({self.products});")
        self.products = 0


def scalar(x: Entry) -> Entries:
    """Return one entry as an array without axes."""
    out = np.empty((), object)
    out[()] = x
    return out


def number_entries(value: ArrayLike) -> Entries:
    """Return the entries of an array of numbers."""
    array = np.asarray(value)
    out = np.empty(array.shape, object)
    for i in np.ndindex(array.shape):
        out[i] = array[i]
    return out


def is_known(*arrays: Entries) -> bool:
    """Return whether no entry is a Term."""
    return not any(isinstance(x, Term) for a in arrays for x in a.flat)


def array_entries(name: str, shape: tuple[int, ...], base: str = "", first: int = 0) -> Entries:
    """Return the entries of a C array, from the index `base` plus `first` on."""
    out = np.empty(int(np.prod(shape)), object)
    for i in range(out.size):
        index = first + i
        out[i] = Term(f"{name}[{f'{base} + {index}' if base and index else base or index}]", name, base, index)
    return out.reshape(shape)


def place_of(values: Entries) -> Term | None:
    """Return the first entry if all entries are consecutive in one C array; otherwise None."""
    terms = list(values.flat)
    first = terms[0] if terms else None
    if not isinstance(first, Term) or not first.store:
        return None
    for i, x in enumerate(terms):
        if not isinstance(x, Term) or (x.store, x.base, x.place) != (first.store, first.base, first.place + i):
            return None
    return first


def kind_of(dtype: DTypeLike) -> str:
    """Return the name of a type in C."""
    return KINDS[str(np.dtype(dtype))]


def as_c(x: Entry) -> str:
    """Return an entry as an expression of C."""
    if isinstance(x, Term):
        return x.text
    if isinstance(x, bool | np.bool_):
        return "true" if x else "false"
    if np.issubdtype(np.asarray(x).dtype, np.integer):
        return _format_integer(int(x))
    value = float(x)
    if np.isnan(value):
        return "(real)NAN"
    if np.isinf(value):
        return "(real)INFINITY" if value > 0 else "(-(real)INFINITY)"
    return f"R({value!r})" if value >= 0 and not np.signbit(value) else f"(-R({-value!r}))"


def _format_integer(value: int) -> str:
    if value == -(2**63):
        return "INT64_MIN"
    text = str(abs(value)) + ("LL" if abs(value) >= LONG else "")
    return text if value >= 0 else f"(-{text})"
