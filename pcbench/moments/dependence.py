"""Find which arguments each result of a function depends on, from its jaxpr.

Equations that apply a program are resolved. For any other equation, every result depends on every operand. So a dependence may
be reported that does not exist, but none is missed.
"""

from collections.abc import Callable

import jax
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import CALLS, Eqn, Jaxpr, Literal

ArgIndices = frozenset[int]  # indices of flattened arguments
NONE: ArgIndices = frozenset()


def argument_dependence(f: Callable[..., PyTree], *args: PyTree) -> PyTree:
    """Return for each result the arguments it depends on, in the structure of the results of f.

    Arguments are arrays or their shapes. Both are indexed as by `jax.tree.leaves`.
    """
    program, shape = jax.make_jaxpr(f, return_shape=True)(*args)
    dependence = _dependence(program.jaxpr, [frozenset([i]) for i in range(len(program.jaxpr.invars))])
    return jax.tree.unflatten(jax.tree.structure(shape), dependence)


def _dependence(jaxpr: Jaxpr, args: list[ArgIndices]) -> list[ArgIndices]:
    by_variable: dict[PyTree, ArgIndices] = dict(zip(jaxpr.invars, args, strict=True))

    def of(v: PyTree) -> ArgIndices:
        return NONE if isinstance(v, Literal) else by_variable.get(v, NONE)

    for eqn in jaxpr.eqns:
        by_variable.update(zip(eqn.outvars, _apply_equation(eqn, [of(v) for v in eqn.invars]), strict=True))
    return [of(v) for v in jaxpr.outvars]


def _apply_equation(eqn: Eqn, args: list[ArgIndices]) -> list[ArgIndices]:
    name = eqn.primitive.name
    if name in CALLS:
        return _dependence(jaxpr_compat.callee(eqn.params).jaxpr, args)
    if name == "cond":
        branches = [_dependence(branch.jaxpr, args[1:]) for branch in jaxpr_compat.branches(eqn.params)]
        return [args[0].union(*sets) for sets in zip(*branches, strict=True)]
    if name == "scan":
        s = jaxpr_compat.scan(eqn.params)
        consts, carry, rows = args[: s.consts], args[s.consts : s.consts + s.carry], args[s.consts + s.carry :]
        return _to_fixed_point(lambda c: _dependence(s.body.jaxpr, [*consts, *c, *rows]), carry)
    return [NONE.union(*args)] * len(eqn.outvars)


def _to_fixed_point(body: Callable[[list[ArgIndices]], list[ArgIndices]], carry: list[ArgIndices]) -> list[ArgIndices]:
    """Return the results of a body applied to its own first results until a fixed point is reached."""
    while True:
        out = body(carry)
        wider = [a | b for a, b in zip(carry, out, strict=False)]
        if wider == carry:
            return [*wider, *out[len(carry) :]]
        carry = wider
