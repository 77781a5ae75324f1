"""Carry a function written for one lane over many: its jaxpr is evaluated entry by entry.

`jax.vmap` puts the batch axis of small vectors first and stacks what it computes; the compiled loop then transposes and
copies. Here XLA sees nothing but elementwise arithmetic on arrays [L]. Measured on the cart with two observers, one core, 1024
lanes: 59 M lane-ticks/s with vmap(-1, -1) over stacked vectors, 110 M so. One row of a table (`lax.dynamic_slice`,
`lax.dynamic_update_slice` along the first axis, at an index that all lanes share) is read and written in place.
Large products and unusual primitives fall back on vmap, lanes last; results are the same.
"""

import itertools
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.simulation.lanes import (
    Lanes,
    entries,
    is_lanes,
    join,
    lanes_of,
    like,
    primitives,
    settle,
    split,
    spread_table,
    table,
)
from pcbench.simulation.lanes.primitives import CALLS, ELEMENTWISE, STRUCTURAL, ClosedJaxpr, Literal, jaxpr_as_fun

FOLDS = dict(
    zip(
        primitives.FOLDS,
        (jnp.add, jnp.maximum, jnp.minimum, jnp.multiply, jnp.logical_and, jnp.logical_or),
        strict=True,
    )
)
WRITTEN_OUT = 128  # products in one dot_general; above, vmap of the dot compiles faster and runs no slower


def over(f: Any) -> Any:
    """Return `f` with any array in its arguments' pytrees allowed to be a Lanes; what depends on one comes out as one."""

    def mapped(*args: Any) -> Any:
        flat, tree = jax.tree.flatten(args, is_leaf=is_lanes)
        one = [jax.ShapeDtypeStruct(x.shape, x.dtype) if is_lanes(x) else x for x in flat]
        jaxpr, shape = jax.make_jaxpr(lambda *a: f(*jax.tree.unflatten(tree, a)), return_shape=True)(*one)
        return jax.tree.unflatten(jax.tree.structure(shape), _evaluate(jaxpr.jaxpr, jaxpr.consts, flat))

    return mapped


def _evaluate(jaxpr: Any, consts: Any, args: Any) -> list[Any]:
    env = dict(zip(itertools.chain(jaxpr.constvars, jaxpr.invars), itertools.chain(consts, args), strict=True))

    def read(v: Any) -> Any:
        return v.val if isinstance(v, Literal) else env[v]

    for eqn in jaxpr.eqns:
        args = [read(v) for v in eqn.invars]
        env.update(zip(eqn.outvars, _apply(jaxpr, eqn, args), strict=True))
    return [read(v) for v in jaxpr.outvars]


def _apply(jaxpr: Any, eqn: Any, args: list[Any]) -> list[Any]:
    name, differs = eqn.primitive.name, any(map(is_lanes, args))
    if differs and name in CALLS:
        closed = primitives.called(eqn.params)
        return _evaluate(closed.jaxpr, closed.consts, args)
    if name in ROWS and differs and _one_row(eqn, args):
        return [ROWS[name](eqn, args)]
    if differs and name == "scan" and primitives.scan(eqn.params).length:
        return _scan(eqn, args)
    if differs and name == "while" and (found := _while(eqn, args)) is not None:
        return found
    args = [entries(a) for a in args]
    if differs and name == "gather" and _takes_rows(eqn, args):
        return [_rows_of_table(eqn, args)]
    if differs and name in _RULES and not (name == "dot_general" and _products(eqn) > WRITTEN_OUT):
        return [_RULES[name](eqn, args)]
    return _fallback(jaxpr, eqn, args)


def _scan(eqn: Any, args: list[Any]) -> list[Any]:
    """Apply a scan by a scan over the same rows, its body evaluated entry by entry."""
    body, consts, carry, length, how = primitives.scan(eqn.params)
    width = next(jnp.shape(leaf)[-1] for a in args if is_lanes(a) for leaf in jax.tree.leaves(a))
    rows = [_without_rows(table(a)) for a in args[consts + carry :]]

    def step(state: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
        out = _evaluate(body.jaxpr, body.consts, [*args[:consts], *state, *row])
        return like(out[:carry], state, width), out[carry:]

    first = jax.tree.map(lambda a: a[0], rows)
    start = [entries(a) if is_lanes(a) else jnp.asarray(a) for a in args[consts : consts + carry]]
    start = settle(lambda state: step(state, first)[0], start, width)
    end, out = jax.lax.scan(step, start, rows, **how)
    return [*end, *(Lanes(a.parts, length) if is_lanes(a) else a for a in out)]


def _while(eqn: Any, args: list[Any]) -> list[Any] | None:
    """Apply a while loop that ends for all lanes at once by one loop, its body evaluated entry by entry; else None."""
    cond, body, first, second = primitives.while_(eqn.params)
    asked, given, state = args[:first], args[first : first + second], args[first + second :]
    width = next(jnp.shape(leaf)[-1] for a in args if is_lanes(a) for leaf in jax.tree.leaves(a))

    def step(state: list[Any]) -> list[Any]:
        return like(_evaluate(body.jaxpr, body.consts, [*given, *state]), state, width)

    def goes_on(state: list[Any]) -> Any:
        return _evaluate(cond.jaxpr, cond.consts, [*asked, *state])[0]

    start = [entries(a) if is_lanes(a) else jnp.asarray(a) for a in state]
    start = settle(lambda s: _evaluate(body.jaxpr, body.consts, [*given, *s]), start, width)
    if is_lanes(jax.eval_shape(goes_on, start)):
        return None
    return jax.lax.while_loop(goes_on, step, start)


def _without_rows(x: Any) -> Any:
    """A table as a scan goes over it: what it takes of it is one row, an array for each entry."""
    return Lanes(x.parts) if is_lanes(x) else x


def _one_row(eqn: Any, args: list[Any]) -> bool:
    """Whether a slice is one whole row at an index that all lanes share."""
    update = eqn.primitive.name == "dynamic_update_slice"
    shape = eqn.invars[0].aval.shape
    size = eqn.invars[1].aval.shape if update else primitives.slice_sizes(eqn.params)
    return size == (1, *shape[1:]) and not any(map(is_lanes, args[1 + update :]))


def _read_row(eqn: Any, args: list[Any]) -> Lanes:
    x, row = table(args[0]), args[1]
    return lanes_of((1, *x.parts.shape), [jax.lax.dynamic_index_in_dim(a, row, 0, False) for a in x.parts.flat])


def _write_row(eqn: Any, args: list[Any]) -> Lanes:
    new, row = entries(args[1]), args[2]
    width = next(jnp.shape(a)[-1] for x in args[:2] if is_lanes(x) for a in x.parts.flat)
    old = table(args[0]) if is_lanes(args[0]) else spread_table(jnp.asarray(args[0]), width)
    each = _parts(new, np.shape(new) if not is_lanes(new) else new.shape).flat
    written = [
        jax.lax.dynamic_update_index_in_dim(a, jnp.broadcast_to(b, (width,)), row, 0)
        for a, b in zip(old.parts.flat, each, strict=True)
    ]
    return lanes_of(old.parts.shape, written, old.rows)


ROWS = {"dynamic_slice": _read_row, "dynamic_update_slice": _write_row}


def _fallback(jaxpr: Any, eqn: Any, args: list[Any]) -> list[Any]:
    """Apply any primitive: as it is where nothing differs between lanes, else by vmap over the joined arrays."""
    if eqn.primitive.name in _RULES and not any(map(is_lanes, args)):
        return [eqn.primitive.bind(*args, **eqn.params)]
    given = {v: a for v, a in zip(eqn.invars, args, strict=True) if not isinstance(v, Literal)}
    alone = jaxpr.replace(constvars=(), invars=list(given), outvars=eqn.outvars, eqns=[eqn], effects=eqn.effects)
    apply = jaxpr_as_fun(ClosedJaxpr(alone, ()))
    values = list(given.values())
    if not any(map(is_lanes, values)):
        return apply(*values)
    axes = [-1 if is_lanes(a) else None for a in values]
    whole = [join(a) if is_lanes(a) else a for a in values]
    return [split(out) for out in jax.vmap(apply, axes, -1)(*whole)]


def _parts(x: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The entries of an operand, an ordinary array's taken out one by one, broadcast to `shape`."""
    if not is_lanes(x):
        flat = jax.lax.reshape(jnp.asarray(x), (np.size(x),))
        x = lanes_of(np.shape(x), [jax.lax.index_in_dim(flat, i, keepdims=False) for i in range(np.size(x))])
    return np.broadcast_to(x.parts, shape)


def _elementwise(eqn: Any, args: list[Any]) -> Lanes:
    shape = eqn.outvars[0].aval.shape
    parts = [_parts(a, shape) for a in args]
    out = np.empty(shape, object)
    for i in np.ndindex(shape):
        entries = [p[i] for p in parts]
        width = next((jnp.shape(e) for e in entries if jnp.ndim(e)), ())
        keep = eqn.primitive.name == "select_n" and not jnp.ndim(entries[0])  # a shared choice stays one scalar
        first = entries[:1] if keep else []
        out[i] = eqn.primitive.bind(*first, *(jnp.broadcast_to(e, width) for e in entries[len(first) :]), **eqn.params)
    return Lanes(out)


def _structural(eqn: Any, args: list[Any]) -> Any:
    shapes = [a.parts.shape if is_lanes(a) else np.shape(a) for a in args]
    entries = [e for a, s in zip(args, shapes, strict=True) for e in _parts(a, s).flat]
    offsets = np.cumsum([0, *(int(np.prod(s)) for s in shapes)])
    with jax.ensure_compile_time_eval():  # where each entry goes: the primitive applied to the entries' numbers
        numbers = [
            jnp.asarray(o + np.arange(int(np.prod(s))).reshape(s)) for o, s in zip(offsets, shapes, strict=False)
        ]
        places = np.asarray(eqn.primitive.bind(*numbers, **eqn.params))
    if not places.size:  # nothing is left that could differ
        return jnp.zeros(places.shape, eqn.outvars[0].aval.dtype)
    width = next(jnp.shape(e) for e in entries if jnp.ndim(e))
    return lanes_of(places.shape, [jnp.broadcast_to(entries[p], width) for p in places.flat])


def _fold(eqn: Any, args: list[Any]) -> Lanes:
    parts, axes = args[0].parts, primitives.fold_axes(eqn.params)
    rest = tuple(i for i in range(parts.ndim) if i not in axes)
    flat = parts.transpose(*rest, *axes).reshape(*(parts.shape[i] for i in rest), -1)
    shape = flat.shape[:-1]
    return lanes_of(shape, [reduce(FOLDS[eqn.primitive.name], flat[i]) for i in np.ndindex(shape)])


def _products(eqn: Any) -> int:
    (contract, _), _ = primitives.products_of(eqn.params)
    return int(np.prod(eqn.outvars[0].aval.shape) * np.prod([eqn.invars[0].aval.shape[i] for i in contract]))


def _dot(eqn: Any, args: list[Any]) -> Lanes:
    (ca, cb), (ba, bb) = primitives.products_of(eqn.params)
    shapes = [a.parts.shape if is_lanes(a) else np.shape(a) for a in args]
    out = eqn.outvars[0].aval.shape
    inner = int(np.prod([shapes[0][i] for i in ca]))
    lhs, rhs = (_parts(a, s) for a, s in zip(args, shapes, strict=True))

    def arranged(p: np.ndarray, batch: Any, contract: Any) -> np.ndarray:  # -> [batch, free, contract], flattened
        free = [i for i in range(p.ndim) if i not in (*batch, *contract)]
        sizes = [int(np.prod([p.shape[i] for i in axes])) for axes in (batch, free, contract)]
        return p.transpose(*batch, *free, *contract).reshape(sizes)

    a, b = arranged(lhs, ba, ca), arranged(rhs, bb, cb)
    sums = [
        reduce(jnp.add, (a[k, i, c] * b[k, j, c] for c in range(inner)))
        for k in range(a.shape[0])
        for i in range(a.shape[1])
        for j in range(b.shape[1])
    ]
    return lanes_of(out, sums)


def _rows_of_table(eqn: Any, args: list[Any]) -> Lanes:
    """A gather of whole rows from a table that all lanes share, each lane's own rows, in one gather."""
    table, own = jnp.asarray(args[0]), args[1].parts[..., 0]
    columns = table.reshape(table.shape[0], -1).T
    each = columns.at[:, jnp.stack(list(own.flat))]
    found = each.get(mode="clip", wrap_negative_indices=False)  # [entries, rows, L]; -1 is no last row
    shape = eqn.outvars[0].aval.shape
    return lanes_of(shape, [found[e, r] for r in range(own.size) for e in range(columns.shape[0])])


def _takes_rows(eqn: Any, args: list[Any]) -> bool:
    if is_lanes(args[0]) or not is_lanes(args[1]):
        return False
    return primitives.takes_rows(eqn.params, eqn.invars[0].aval.shape, len(args[1].shape))


_RULES = (
    dict.fromkeys(ELEMENTWISE, _elementwise)
    | dict.fromkeys(STRUCTURAL, _structural)
    | dict.fromkeys(FOLDS, _fold)
    | {"dot_general": _dot}
)
