"""Are a user's functions pure, and do they keep float64? Read in the programs that jax makes of them."""

from collections.abc import Sequence
from typing import Any

import jax

from pcbench.checking.result import require
from pcbench.checking.tracing import Asked, Program, alike, inside, program
from pcbench.errors import UserError

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
        for eqn in (eqn for inner in inside(program(a, g).jaxpr) for eqn in inner.eqns):
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
