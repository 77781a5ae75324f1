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

OPERATIONS = (lax.add, lax.max, lax.min, lax.mul, lax.bitwise_and, lax.bitwise_or)
FOLD_OPERATIONS = dict(zip(jaxpr_compat.FOLDS, OPERATIONS, strict=True))


def entries_of(x: PyTree, shape: tuple[int, ...]) -> np.ndarray:
    """Return the entries of an operand broadcast to `shape`; an ordinary array is split into its entries."""
    if not is_lanes(x):
        flat = jax.lax.reshape(jnp.asarray(x), (np.size(x),))
        x = lanes_of(np.shape(x), [jax.lax.index_in_dim(flat, i, keepdims=False) for i in range(np.size(x))])
    return np.broadcast_to(x.parts, shape)


def elementwise(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    """Apply a primitive to each number."""
    shape = eqn.outvars[0].aval.shape
    parts = [entries_of(a, shape) for a in args]
    out = np.empty(shape, object)
    for i in np.ndindex(shape):
        entries = [p[i] for p in parts]
        lane_shape = next((jnp.shape(e) for e in entries if jnp.ndim(e)), ())
        # a choice common to all lanes stays a scalar
        is_common_choice = eqn.primitive.name == "select_n" and not jnp.ndim(entries[0])
        first = entries[:1] if is_common_choice else []
        out[i] = kernels.function_of(eqn)(*first, *(jnp.broadcast_to(e, lane_shape) for e in entries[len(first) :]))
    return LaneArray(out)


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
    offsets = np.cumsum([0, *(int(np.prod(s)) for s in shapes)])
    with jax.ensure_compile_time_eval():
        indices = [
            jnp.asarray(o + np.arange(int(np.prod(s))).reshape(s)) for o, s in zip(offsets, shapes, strict=False)
        ]
        results = primitive.bind(*indices, **dict(params))
    return [np.asarray(result) for result in (results if primitive.multiple_results else [results])]


def fold(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    """Reduce numbers over axes."""
    parts, axes = args[0].parts, jaxpr_compat.fold_axes(eqn.params)
    free = tuple(i for i in range(parts.ndim) if i not in axes)
    flat = parts.transpose(*free, *axes).reshape(*(parts.shape[i] for i in free), -1)
    shape = flat.shape[:-1]
    return lanes_of(shape, [reduce(FOLD_OPERATIONS[eqn.primitive.name], flat[i]) for i in np.ndindex(shape)])


def dot(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    """Write a matrix product as products and sums."""
    (ca, cb), (ba, bb) = jaxpr_compat.dot_axes(eqn.params)
    shapes = [a.parts.shape if is_lanes(a) else np.shape(a) for a in args]
    shape = eqn.outvars[0].aval.shape
    inner = int(np.prod([shapes[0][i] for i in ca]))
    lhs, rhs = (entries_of(a, s) for a, s in zip(args, shapes, strict=True))

    def to_matrices(p: np.ndarray, batch: PyTree, contract: PyTree) -> np.ndarray:  # [batch, free, contract], flattened
        free = [i for i in range(p.ndim) if i not in (*batch, *contract)]
        sizes = [int(np.prod([p.shape[i] for i in axes])) for axes in (batch, free, contract)]
        return p.transpose(*batch, *free, *contract).reshape(sizes)

    a, b = to_matrices(lhs, ba, ca), to_matrices(rhs, bb, cb)
    sums = [
        reduce(partial(_pairwise, lax.add), (_pairwise(kernels.product, a[k, i, c], b[k, j, c]) for c in range(inner)))
        for k in range(a.shape[0])
        for i in range(a.shape[1])
        for j in range(b.shape[1])
    ]
    return lanes_of(shape, sums)


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
