"""Checks of a user's functions: on their traced programs, and on batches of runs.

They test whether the functions are pure, keep float64, and give the same results for a batch as for single runs.
Batches are computed in the way of pcbench and by `jax.vmap`.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.jaxpr_compat import ClosedJaxpr, Literal, inner_programs
from pcbench.engine.lane_array import is_lanes, join, split
from pcbench.errors import UserError, brief_repr, describe_exception

NARROW = ("float32", "float16", "bfloat16", "complex64")
WIDTH, CLOSE = 3, 1e-11  # lanes; sums over lanes may be in another order

Functions = Mapping[str, Callable[[Any], PyTree]]  # a user's, by name, each of a pytree of all that it takes


class Program(NamedTuple):
    """A traced function: its text without memory addresses, and the constants in it."""

    text: str
    numbers: tuple[np.ndarray, ...]
    jaxpr: Any


def program(f: Callable[[Any], PyTree], args: PyTree) -> Program:
    """Trace a function again, without jax's cache."""
    closed_jaxpr = jax.make_jaxpr(lambda g: f(g))(args)
    literals: list[Any] = []
    for part in _parts(closed_jaxpr.jaxpr):
        for eqn in part.eqns:
            literals += [v.val for v in eqn.invars if isinstance(v, Literal)]
            literals += [const for p in inner_programs(eqn.params) if isinstance(p, ClosedJaxpr) for const in p.consts]
    numbers = tuple(np.asarray(x) for x in (*closed_jaxpr.consts, *literals) if np.size(x))
    return Program(re.sub(r"0x[0-9a-f]+", "", str(closed_jaxpr.jaxpr)), numbers, closed_jaxpr.jaxpr)


def _parts(jaxpr: Any) -> Iterator[Any]:
    """Yield a program and all programs inside it."""
    yield jaxpr
    for eqn in jaxpr.eqns:
        for inner_jaxpr in inner_programs(eqn.params):
            yield from _parts(getattr(inner_jaxpr, "jaxpr", inner_jaxpr))


def is_same_program(a: Program, b: Program) -> bool:
    """Return whether two programs are equal, including their constants."""
    return (
        a.text == b.text
        and len(a.numbers) == len(b.numbers)
        and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a.numbers, b.numbers, strict=True))
    )


def arrays(params: PyTree) -> PyTree:
    """Return the result of `prepare` as jax arrays; raise UserError for a leaf that is not a number."""
    for leaf in jax.tree.leaves(params):
        if not is_number(leaf):
            raise UserError(
                f"numbers: got {brief_repr(leaf)} in the result of prepare, expected arrays of numbers only; remove texts and "
                "functions."
            )
    return jax.tree.map(jnp.asarray, params)


def is_number(leaf: object) -> bool:
    """Return whether a leaf of gains or parameters is an array or a number."""
    return isinstance(leaf, np.ndarray | jax.Array | np.generic | float | int)


def purity(functions: Functions, args: PyTree) -> str:
    """Check that equal inputs give equal outputs, that no state is stored outside, and that no argument is changed."""
    for name, f in functions.items():
        try:
            with jax.checking_leaks():
                first, second = program(f, args), program(f, args)
        except Exception as error:
            if "eak" not in str(error):
                raise
            raise UserError(
                f"purity: got a traced value that {name} stores outside itself, expected none; return it instead."
            ) from None
        if not is_same_program(first, second):
            raise UserError(
                f"purity: got two programs when {name} was traced twice, expected one; remove Python's counters and random "
                "numbers."
            )
        if _changes_its_arguments(f, args):
            raise UserError(
                f"purity: got changed arguments from {name}, expected unchanged ones; return new ones "
                "(x._replace, or {**x, ...})."
            )
    return "equal inputs give equal outputs; no state outside, no argument changed"


def _changes_its_arguments(f: Callable[[Any], PyTree], args: PyTree) -> bool:
    changes: list[bool] = []

    def trace(g: PyTree) -> PyTree:
        leaves, form = jax.tree.flatten(g)
        out = f(g)
        new_leaves, new_form = jax.tree.flatten(g)
        changes.append(str(form) != str(new_form) or any(x is not y for x, y in zip(leaves, new_leaves, strict=True)))
        return out

    jax.eval_shape(trace, args)
    return changes[0]


def float64(functions: Functions, args: PyTree) -> str:
    """Check that no function rounds a number to fewer bits than its arguments have."""
    for name, f in functions.items():
        for eqn in (eqn for part in _parts(program(f, args).jaxpr) for eqn in part.eqns):
            for dtype in (str(getattr(v.aval, "dtype", "")) for v in eqn.outvars):
                if dtype in NARROW:
                    raise UserError(
                        f"float64: got {dtype} in {name} ({eqn.primitive.name}), expected float64 throughout; leave out "
                        "dtypes, or write float."
                    )
    return "float64 in, float64 throughout"


def lanes(functions: Functions, rows: Sequence[PyTree], arguments_of: Callable[[Any], PyTree]) -> str:
    """Check that each run of a batch gives the results that it gives alone.

    `rows` has the arguments that differ between runs. `arguments_of` adds the others.
    """
    batch_args = jax.tree.map(lambda *a: jnp.stack(a, -1), *rows)

    def by_name(subset: Functions) -> Callable[[PyTree], PyTree]:
        return lambda row: {name: f(arguments_of(row)) for name, f in subset.items()}

    def entrywise(subset: Functions) -> PyTree:
        def run(rows: PyTree) -> PyTree:
            lane = jax.tree.map(lambda a: split(a) if a.size else a[..., 0], rows)  # what is empty differs in none
            return _join_lanes(vmap_entrywise(by_name(subset))(lane))

        return jax.jit(run)(batch_args)

    ways: dict[str, Callable[[Functions], PyTree]] = {
        "vmap over the last axis": lambda subset: jax.jit(jax.vmap(by_name(subset), -1, -1))(batch_args),
        "pcbench's batches": entrywise,
    }
    expected = jax.tree.map(lambda *a: jnp.stack(a, -1), *map(jax.jit(by_name(functions)), rows))
    for batching, run in ways.items():
        try:
            batch = run(functions)
        except Exception:
            for name, f in functions.items():  # which of them is it?
                try:
                    run({name: f})
                except Exception as error:
                    raise UserError(
                        f"many runs: {name} in {batching}: got {describe_exception(error)}, expected a batch of runs; write "
                        "it in jax.numpy, without callbacks into Python."
                    ) from None
            raise
        for name, single in expected.items():
            pairs = zip(jax.tree.leaves(batch[name]), jax.tree.leaves(single), strict=True)
            if not all(a.shape == b.shape and np.allclose(a, b, CLOSE, CLOSE, equal_nan=True) for a, b in pairs):
                raise UserError(
                    f"many runs: {name} in {batching}: got other numbers than one run at a time gives, expected the same to "
                    f"{CLOSE:g}; make each run independent of the others, and use gains of a moderate size."
                )
    return f"{len(rows)} runs at once are the same as one at a time"


def _join_lanes(tree: PyTree) -> PyTree:
    """Stack the runs on the last axis; a value that is equal in all runs is repeated."""

    def join_leaf(x: Any) -> jax.Array:
        return join(x) if is_lanes(x) else jnp.broadcast_to(jnp.asarray(x)[..., None], (*jnp.shape(x), WIDTH))

    return jax.tree.map(join_leaf, tree, is_leaf=is_lanes)


def perturb_lane(tree: PyTree, lane: int) -> PyTree:
    """Return a pytree for another run of the batch: its real numbers differ."""
    return jax.tree.map(lambda a: a * (1 + lane / 8) + lane / 16 if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)
