"""The programs that jax makes of a user's functions, and the numbers written into them.

Are a user's functions pure, and do they keep float64? Read in the programs that jax makes of them.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.checking.targets import require
from pcbench.engine.jaxpr_compat import ClosedJaxpr, Literal, inner
from pcbench.errors import UserError


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


NARROW = ("float32", "float16", "bfloat16", "complex64")


def purity(every: Sequence[Asked], g: Any) -> str:
    """The same input gives the same output; nothing is kept outside, no argument is changed."""
    for a in every:
        require(
            alike(_leakless(a, g), _leakless(a, g)),
            f"purity: got two programs when {a.name} was traced twice, expected one; take out counters and random numbers of "
            "Python.",
        )
        require(
            not _changed(a, g),
            f"purity: got arguments that {a.name} has changed, expected them as they were; return new ones "
            "(x._replace, or {**x, ...}).",
        )
    return "same input, same output; nothing kept outside, no argument changed"


def float64(every: Sequence[Asked], g: Any) -> str:
    """No number is rounded to fewer bits than it came with."""
    for a in every:
        for eqn in (eqn for part in inside(program(a, g).jaxpr) for eqn in part.eqns):
            narrow = [v.aval.dtype for v in eqn.outvars if str(getattr(v.aval, "dtype", "")) in NARROW]
            require(
                not narrow,
                f"float64: got {narrow[0] if narrow else ''} in {a.name} ({eqn.primitive.name}), expected float64 throughout; "
                "leave out dtypes, or write float.",
            )
    return "float64 in, float64 throughout"


def _leakless(a: Asked, g: Any) -> Program:
    """Trace a function; raise UserError where it keeps what it was traced with."""
    try:
        with jax.checking_leaks():
            return program(a, g)
    except Exception as error:
        if "eak" not in str(error):
            raise
        raise UserError(
            f"purity: got a traced value that {a.name} leaves behind outside itself, expected none; return what is to be "
            "kept."
        ) from None


def _changed(a: Asked, g: Any) -> bool:
    """Whether a function changes its arguments while it is traced."""
    found: list[bool] = []

    def traced(g: Any) -> Any:
        before, form = jax.tree.flatten(g)
        out = a.f(g)
        after, same = jax.tree.flatten(g)
        found.append(str(form) != str(same) or any(x is not y for x, y in zip(before, after, strict=True)))
        return out

    jax.eval_shape(traced, g)
    return found[0]
