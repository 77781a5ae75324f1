"""The programs that jax makes of a user's functions, and the numbers written into them."""

import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.engine.jaxpr_compat import ClosedJaxpr, Literal, inner


class Asked(NamedTuple):
    """A function of a user's, as f(given), a pytree of all that it takes."""

    name: str
    f: Callable[[Any], Any]


class Program(NamedTuple):
    """A traced function: its text without addresses, and the numbers written into it."""

    text: str
    numbers: tuple[np.ndarray, ...]
    jaxpr: Any


def program(a: Asked, g: Any) -> Program:
    """Trace a function anew."""
    closed = jax.make_jaxpr(lambda g: a.f(g))(g)
    numbers = tuple(np.asarray(x) for x in (*closed.consts, *_literals(closed.jaxpr)) if np.size(x))
    return Program(re.sub(r"0x[0-9a-f]+", "", str(closed.jaxpr)), numbers, closed.jaxpr)


def alike(a: Program, b: Program) -> bool:
    """Say whether two programs are the same, numbers included."""
    pairs = zip(a.numbers, b.numbers, strict=False)
    return (
        a.text == b.text
        and len(a.numbers) == len(b.numbers)
        and all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)
    )


def inside(jaxpr: Any) -> Iterator[Any]:
    """Yield a program and every program in it."""
    yield jaxpr
    for eqn in jaxpr.eqns:
        for each in inner(eqn.params):
            yield from inside(getattr(each, "jaxpr", each))


def _literals(jaxpr: Any) -> Iterator[Any]:
    for program in inside(jaxpr):
        for eqn in program.eqns:
            yield from (v.val for v in eqn.invars if isinstance(v, Literal))
            for each in inner(eqn.params):
                yield from each.consts if isinstance(each, ClosedJaxpr) else ()
