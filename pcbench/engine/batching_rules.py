"""Batching rules of single primitives: elementwise, structural, reductions, products, rows of a table."""

from functools import cache, partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat, kernels
from pcbench.engine.jaxpr_compat import Eqn
from pcbench.engine.lane_array import LaneArray, is_lanes, lanes_of

Known = np.ndarray | None  # known entries of a value, as in `known_entries`

OPERATIONS = (lax.add, lax.max, lax.min, lax.mul, lax.bitwise_and, lax.bitwise_or)
# the operand b that leaves a in a op b unchanged
NEUTRAL = {"mul": 1.0, "div": 1.0, "add": 0.0, "add_any": 0.0, "sub": 0.0}
FOLD_OPERATIONS = dict(zip(jaxpr_compat.FOLDS, OPERATIONS, strict=True))


def entries_of(x: PyTree, shape: tuple[int, ...]) -> np.ndarray:
    """Return the entries of an operand broadcast to `shape`; an ordinary array is split into its entries."""
    if not is_lanes(x):
        flat = jax.lax.reshape(jnp.asarray(x), (np.size(x),))
        x = lanes_of(np.shape(x), [jax.lax.index_in_dim(flat, i, keepdims=False) for i in range(np.size(x))])
    return np.broadcast_to(x.parts, shape)


def known_array(known: Known, shape: tuple[int, ...]) -> np.ndarray:
    """Return the known entries of an operand broadcast to `shape`, NaN where an entry is not known."""
    return np.broadcast_to(np.nan if known is None else known, shape)


def elementwise(eqn: Eqn, args: list[PyTree], known: list[Known], known_result: Known) -> LaneArray:
    """Apply a primitive to each number whose result is not known."""
    name, shape, dtype = eqn.primitive.name, eqn.outvars[0].aval.shape, eqn.outvars[0].aval.dtype
    parts, known_parts = [entries_of(a, shape) for a in args], [known_array(k, shape) for k in known]
    results, out = known_array(known_result, shape), np.empty(shape, object)
    for i in np.ndindex(shape):
        entries = [p[i] for p in parts]
        lane_shape = next((jnp.shape(e) for e in entries if jnp.ndim(e)), ())
        if not np.isnan(results[i]):
            out[i] = jnp.full(lane_shape, results[i], dtype)
        elif (unchanged := _unchanged_operand(name, [k[i] for k in known_parts])) is not None:
            out[i] = jnp.broadcast_to(entries[unchanged], lane_shape)
        else:
            # a choice common to all lanes stays a scalar
            first = entries[:1] if name == "select_n" and not jnp.ndim(entries[0]) else []
            others = (jnp.broadcast_to(e, lane_shape) for e in entries[len(first) :])
            out[i] = kernels.function_of(eqn)(*first, *others)
    return LaneArray(out)


def _unchanged_operand(name: str, known: list[np.ndarray]) -> int | None:
    """Return the index of the operand that equals the result, such as x in x + 0 and 1 x; None if there is none."""
    if name not in NEUTRAL:
        return None
    if known[1] == NEUTRAL[name]:
        return 0
    return 1 if known[0] == NEUTRAL[name] and name not in ("sub", "div") else None


def structural(eqn: Eqn, args: list[PyTree]) -> list[PyTree]:
    """Apply a primitive that moves numbers to the positions of the entries."""
    shapes = [a.parts.shape if is_lanes(a) else np.shape(a) for a in args]
    entries = [e for a, s in zip(args, shapes, strict=True) for e in entries_of(a, s).flat]
    lane_shape = next((jnp.shape(e) for e in entries if jnp.ndim(e)), ())
    sources = source_indices(eqn.primitive, jaxpr_compat.parameter_items(eqn), tuple(shapes))
    return [
        lanes_of(index.shape, [jnp.broadcast_to(entries[i], lane_shape) for i in index.flat])
        if index.size
        else jnp.zeros(index.shape, v.aval.dtype)  # an empty result cannot differ between lanes
        for index, v in zip(sources, eqn.outvars, strict=True)
    ]


@cache
def source_indices(
    primitive: PyTree, params: tuple[tuple[str, PyTree], ...], shapes: tuple[tuple[int, ...], ...]
) -> list[np.ndarray]:
    """Return the source entry of each entry of each result: the primitive applied to the entries' indices."""
    sizes = [int(np.prod(s)) for s in shapes]
    indices = [
        o + np.arange(size).reshape(s) for o, size, s in zip(np.cumsum([0, *sizes]), sizes, shapes, strict=False)
    ]
    if (sources := jaxpr_compat.rearrange(primitive.name, dict(params), indices)) is not None:
        return sources
    with jax.ensure_compile_time_eval():
        results = primitive.bind(*map(jnp.asarray, indices), **dict(params))
    return [np.asarray(result) for result in (results if primitive.multiple_results else [results])]


def fold(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    """Reduce numbers over axes."""
    parts, axes = args[0].parts, jaxpr_compat.fold_axes(eqn.params)
    free = tuple(i for i in range(parts.ndim) if i not in axes)
    flat = parts.transpose(*free, *axes).reshape(*(parts.shape[i] for i in free), -1)
    shape = flat.shape[:-1]
    return lanes_of(shape, [reduce(FOLD_OPERATIONS[eqn.primitive.name], flat[i]) for i in np.ndindex(shape)])


def dot(eqn: Eqn, args: list[PyTree], known: list[Known]) -> LaneArray:
    """Write a matrix product as products and sums, without the products that are known to be zero."""
    (ca, cb), (ba, bb) = jaxpr_compat.dot_axes(eqn.params)
    shapes = [a.parts.shape if is_lanes(a) else np.shape(a) for a in args]
    lhs, rhs = (entries_of(a, s) for a, s in zip(args, shapes, strict=True))
    a, b = as_matrices(lhs, ba, ca), as_matrices(rhs, bb, cb)
    known_a, known_b = (
        as_matrices(known_array(k, s), batch, contract)
        for k, s, batch, contract in zip(known, shapes, (ba, bb), (ca, cb), strict=True)
    )
    width = next(jnp.shape(e)[0] for e in (*lhs.flat, *rhs.flat) if jnp.ndim(e))
    zero = jnp.zeros(width, eqn.outvars[0].aval.dtype)

    def term(k: int, i: int, j: int, c: int) -> PyTree:
        if known_a[k, i, c] == 1:
            return b[k, j, c]
        return a[k, i, c] if known_b[k, j, c] == 1 else _pairwise(kernels.product, a[k, i, c], b[k, j, c])

    def entry(k: int, i: int, j: int) -> PyTree:
        terms = [term(k, i, j, c) for c in range(a.shape[2]) if known_a[k, i, c] != 0 and known_b[k, j, c] != 0]
        return jnp.broadcast_to(reduce(partial(_pairwise, lax.add), terms), (width,)) if terms else zero

    return lanes_of(
        eqn.outvars[0].aval.shape,
        [entry(k, i, j) for k in range(a.shape[0]) for i in range(a.shape[1]) for j in range(b.shape[1])],
    )


def as_matrices(p: np.ndarray, batch: PyTree, contract: PyTree) -> np.ndarray:
    """Return the entries of an operand of a product, [batch, free, contract], each flattened."""
    free = [i for i in range(p.ndim) if i not in (*batch, *contract)]
    sizes = [int(np.prod([p.shape[i] for i in axes])) for axes in (batch, free, contract)]
    return p.transpose(*batch, *free, *contract).reshape(sizes)


def _pairwise(apply: Any, a: PyTree, b: PyTree) -> PyTree:
    """Apply a primitive to two entries, of which one may be common to all lanes."""
    lane_shape = jnp.broadcast_shapes(jnp.shape(a), jnp.shape(b))
    return apply(jnp.broadcast_to(a, lane_shape), jnp.broadcast_to(b, lane_shape))


def rows_of_table(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    """Gather whole rows from a table common to all lanes, each lane its own rows, in one gather."""
    table, index = jnp.asarray(args[0]), args[1].parts[..., 0]
    columns = table.reshape(table.shape[0], -1).T
    gather = columns.at[:, jnp.stack(list(index.flat))]
    rows = gather.get(mode="clip", wrap_negative_indices=False)  # [entries, rows, L]; -1 is not the last row
    shape = eqn.outvars[0].aval.shape
    return lanes_of(shape, [rows[e, r] for r in range(index.size) for e in range(columns.shape[0])])


def takes_rows(eqn: Eqn, args: list[PyTree]) -> bool:
    """Return whether a gather takes whole rows of one table."""
    if is_lanes(args[0]) or not is_lanes(args[1]):
        return False
    return jaxpr_compat.takes_rows(eqn.params, eqn.invars[0].aval.shape, len(args[1].shape))
