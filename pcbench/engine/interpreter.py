"""Carry a function written for one lane over many: its jaxpr is evaluated entry by entry.

`jax.vmap` puts the batch axis of small vectors first and stacks what it computes; the compiled loop then transposes and
copies. Here XLA sees nothing but elementwise arithmetic on arrays [L]. Measured on the cart with two observers, one core, 1024
lanes: 59 M lane-ticks/s with vmap(-1, -1) over stacked vectors, 110 M so. One row of a table (`lax.dynamic_slice`,
`lax.dynamic_update_slice` along the first axis, at an index that all lanes share) is read and written in place.
Large products and unusual primitives fall back on vmap, lanes last; results are the same.
"""

import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from pcbench.engine import batching_rules, jaxpr_compat
from pcbench.engine.jaxpr_compat import CALLS, ELEMENTWISE, STRUCTURAL, ClosedJaxpr, Eqn, Jaxpr, Literal, jaxpr_as_fun
from pcbench.engine.lane_array import (
    FORMS_ONLY,
    LaneArray,
    broadcast_table,
    entries,
    forms_of,
    infer_batched,
    is_lanes,
    join,
    join_table,
    lanes_of,
    match_form,
    split,
    table,
)
from pcbench.protocols import TOGETHER

MANY = 32  # rows, from which on they are kept together


def vmap_entrywise(f: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Return `f` with any array in its arguments' pytrees allowed to be a LaneArray; what depends on one comes out as one."""

    def mapped(*args: PyTree) -> PyTree:
        flat, tree = jax.tree.flatten(args, is_leaf=is_lanes)
        one = [jax.ShapeDtypeStruct(x.shape, x.dtype) if is_lanes(x) else x for x in flat]
        jaxpr, shape = jax.make_jaxpr(lambda *a: f(*jax.tree.unflatten(tree, a)), return_shape=True)(*one)
        return jax.tree.unflatten(jax.tree.structure(shape), _evaluate(jaxpr.jaxpr, jaxpr.consts, flat))

    return mapped


def _evaluate(jaxpr: Jaxpr, consts: list[PyTree], args: list[PyTree]) -> list[PyTree]:
    env = dict(zip(itertools.chain(jaxpr.constvars, jaxpr.invars), itertools.chain(consts, args), strict=True))

    def read(v: PyTree) -> PyTree:
        return v.val if isinstance(v, Literal) else env[v]

    for eqn in jaxpr.eqns:
        args = [read(v) for v in eqn.invars]
        env.update(zip(eqn.outvars, _apply(jaxpr, eqn, args), strict=True))
    return [read(v) for v in jaxpr.outvars]


def _apply(jaxpr: Jaxpr, eqn: Eqn, args: list[PyTree]) -> list[PyTree]:
    name, differs = eqn.primitive.name, any(map(is_lanes, args))
    if differs and name in CALLS and jaxpr_compat.callee_name(eqn.params) == TOGETHER:
        return _apply_vmap(eqn, args)
    if differs and name in CALLS:
        closed = jaxpr_compat.callee(eqn.params)
        return _evaluate(closed.jaxpr, closed.consts, args)
    if name in ROWS and differs and _one_row(eqn, args):
        return [ROWS[name](eqn, args)]
    if differs and name == "scan" and jaxpr_compat.scan(eqn.params).length:
        return _scan(eqn, args)
    if differs and name == "while" and (found := _while(eqn, args)) is not None:
        return found
    if differs and FORMS_ONLY.get():
        return [_form(v.aval, args, name) for v in eqn.outvars]
    args = [entries(a) for a in args]
    if differs and name == "gather" and batching_rules.takes_rows(eqn, args):
        return [batching_rules.rows_of_table(eqn, args)]
    if differs and name in STRUCTURAL:
        return batching_rules.structural(eqn, args)
    if (
        differs
        and name in _RULES
        and not (name == "dot_general" and batching_rules.products(eqn) > batching_rules.WRITTEN_OUT)
    ):
        return [_RULES[name](eqn, args)]
    return _fallback(jaxpr, eqn, args)


def _apply_vmap(eqn: Eqn, args: list[PyTree]) -> list[PyTree]:
    """Apply a function in one piece, by vmap; what is the same in all lanes stays so, what is long becomes a table."""
    closed = jaxpr_compat.callee(eqn.params)

    def alone(*args: PyTree) -> list[PyTree]:
        return _evaluate(closed.jaxpr, closed.consts, list(args))

    differs = [is_lanes(x) for x in forms_of(alone, *args)]
    if FORMS_ONLY.get():
        forms = [_form(v.aval, args, eqn.primitive.name) for v in eqn.outvars]
        shapes = [jnp.zeros(v.aval.shape, v.aval.dtype) for v in eqn.outvars]
        return [_long(x) if d else same for x, same, d in zip(forms, shapes, differs, strict=True)]
    axes = [-1 if is_lanes(a) else None for a in args]
    apply = jax.vmap(jaxpr_as_fun(closed), axes, [-1 if d else None for d in differs])
    found = apply(*(join_table(a) if is_lanes(a) else a for a in args))
    return [_split_table(x) if d else x for x, d in zip(found, differs, strict=True)]


def _long(x: PyTree) -> PyTree:
    """A form, as a table where it has many rows."""
    if not is_lanes(x) or not x.shape or x.shape[0] < MANY:
        return x
    rows = x.shape[0]
    return lanes_of(x.shape[1:], [np.zeros((rows, *jnp.shape(a)), a.dtype) for a in x.parts.reshape(rows, -1)[0]], rows)


def _split_table(x: jax.Array) -> PyTree:
    """A LaneArray from an array [*shape, L], a table where it has many rows."""
    if x.ndim < 2 or x.shape[0] < MANY:
        return split(x) if x.size else jnp.zeros(x.shape[:-1], x.dtype)
    return lanes_of(x.shape[1:-1], [x[:, *i] for i in np.ndindex(x.shape[1:-1])], x.shape[0])


def _form(aval: PyTree, args: list[PyTree], name: str) -> PyTree:
    """What a primitive makes of LaneArrays, without its numbers."""
    size = int(np.prod(aval.shape))
    if not size and name in STRUCTURAL:
        return jnp.zeros(aval.shape, aval.dtype)
    width = next((jnp.shape(leaf)[-1] for a in args if is_lanes(a) for leaf in jax.tree.leaves(a)), 0)
    return lanes_of(aval.shape, [np.zeros(width, aval.dtype)] * size)


def _scan(eqn: Eqn, args: list[PyTree]) -> list[PyTree]:
    """Apply a scan by a scan over the same rows, its body evaluated entry by entry."""
    body, consts, carry, length, how = jaxpr_compat.scan(eqn.params)
    width = next(jnp.shape(leaf)[-1] for a in args if is_lanes(a) for leaf in jax.tree.leaves(a))
    rows = [_without_rows(table(a)) for a in args[consts + carry :]]

    def step(state: list[PyTree], row: list[PyTree]) -> tuple[list[PyTree], list[PyTree]]:
        out = _evaluate(body.jaxpr, body.consts, [*args[:consts], *state, *row])
        return match_form(out[:carry], state, width), out[carry:]

    first = jax.tree.map(lambda a: a[0], rows)
    start = [entries(a) if is_lanes(a) else jnp.asarray(a) for a in args[consts : consts + carry]]
    start = infer_batched(lambda state: step(state, first)[0], start, width)
    end, out = jax.lax.scan(step, start, rows, **how)
    return [*end, *(LaneArray(a.parts, length) if is_lanes(a) else a for a in out)]


def _while(eqn: Eqn, args: list[PyTree]) -> list[PyTree] | None:
    """Apply a while loop that ends for all lanes at once by one loop, its body evaluated entry by entry; else None."""
    cond, body, first, second = jaxpr_compat.while_(eqn.params)
    asked, given, state = args[:first], args[first : first + second], args[first + second :]
    width = next(jnp.shape(leaf)[-1] for a in args if is_lanes(a) for leaf in jax.tree.leaves(a))

    def step(state: list[PyTree]) -> list[PyTree]:
        return match_form(_evaluate(body.jaxpr, body.consts, [*given, *state]), state, width)

    def goes_on(state: list[PyTree]) -> PyTree:
        return _evaluate(cond.jaxpr, cond.consts, [*asked, *state])[0]

    start = [entries(a) if is_lanes(a) else jnp.asarray(a) for a in state]
    start = infer_batched(lambda s: _evaluate(body.jaxpr, body.consts, [*given, *s]), start, width)
    if is_lanes(jax.eval_shape(goes_on, start)):
        return None
    return jax.lax.while_loop(goes_on, step, start)


def _without_rows(x: PyTree) -> PyTree:
    """A table as a scan goes over it: what it takes of it is one row, an array for each entry."""
    return LaneArray(x.parts) if is_lanes(x) else x


def _one_row(eqn: Eqn, args: list[PyTree]) -> bool:
    """Whether a slice is one whole row at an index that all lanes share."""
    update = eqn.primitive.name == "dynamic_update_slice"
    shape = eqn.invars[0].aval.shape
    size = eqn.invars[1].aval.shape if update else jaxpr_compat.slice_sizes(eqn.params)
    return size == (1, *shape[1:]) and not any(map(is_lanes, args[1 + update :]))


def _read_row(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    x, row = table(args[0]), args[1]
    return lanes_of((1, *x.parts.shape), [jax.lax.dynamic_index_in_dim(a, row, 0, False) for a in x.parts.flat])


def _write_row(eqn: Eqn, args: list[PyTree]) -> LaneArray:
    new, row = entries(args[1]), args[2]
    width = next(jnp.shape(a)[-1] for x in args[:2] if is_lanes(x) for a in x.parts.flat)
    old = table(args[0]) if is_lanes(args[0]) else broadcast_table(jnp.asarray(args[0]), width)
    each = batching_rules.entries_of(new, np.shape(new) if not is_lanes(new) else new.shape).flat
    written = [
        jax.lax.dynamic_update_index_in_dim(a, jnp.broadcast_to(b, (width,)), row, 0)
        for a, b in zip(old.parts.flat, each, strict=True)
    ]
    return lanes_of(old.parts.shape, written, old.rows)


ROWS = {"dynamic_slice": _read_row, "dynamic_update_slice": _write_row}


def _fallback(jaxpr: Jaxpr, eqn: Eqn, args: list[PyTree]) -> list[PyTree]:
    """Apply any primitive: as it is where nothing differs between lanes, else by vmap over the joined arrays."""
    if eqn.primitive.name in _RULES.keys() | STRUCTURAL and not any(map(is_lanes, args)):
        found = eqn.primitive.bind(*args, **eqn.params)
        return list(found) if eqn.primitive.multiple_results else [found]
    given = {v: a for v, a in zip(eqn.invars, args, strict=True) if not isinstance(v, Literal)}
    alone = jaxpr.replace(constvars=(), invars=list(given), outvars=eqn.outvars, eqns=[eqn], effects=eqn.effects)
    apply = jaxpr_as_fun(ClosedJaxpr(alone, ()))
    values = list(given.values())
    if not any(map(is_lanes, values)):
        return apply(*values)
    axes = [-1 if is_lanes(a) else None for a in values]
    whole = [join(a) if is_lanes(a) else a for a in values]
    return [split(out) for out in jax.vmap(apply, axes, -1)(*whole)]


_RULES = (
    dict.fromkeys(ELEMENTWISE, batching_rules.elementwise)
    | dict.fromkeys(batching_rules.FOLDS, batching_rules.fold)
    | {"dot_general": batching_rules.dot}
)
