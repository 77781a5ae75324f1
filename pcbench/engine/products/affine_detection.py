"""What goes by products, the plant and each observer by itself: asked of their functions, by what depends on what.

Let z be the numbers of plant and memory that a tick moves, or that the error depends on. A tick is affine in z exactly where
its derivative along a direction does not depend on z. This is read from the derivative's own equations: so it is proven, and
holds for a user's observer as for ours. Stepped is what is not affine, and what depends on a counter or a flag that a memory
keeps (an observer with a schedule of its own). Whether an observer is stepped depends on itself and its plant, not on others.

Which arguments each result of a function depends on, read from its jaxpr.

An equation that applies a program is looked into; of any other every result depends on every operand. So what is found may be
too much, never too little.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat, lane_array
from pcbench.engine.jaxpr_compat import CALLS, Eqn, Jaxpr, Literal
from pcbench.simulation.schedule.common_times import Schedule
from pcbench.simulation.types import GridPointParams, Layout, State, present, truth

Found = frozenset[int]  # numbers of arguments, as flattened
NONE: Found = frozenset()


def reach(f: Callable[..., PyTree], *args: PyTree) -> tuple[PyTree, list[bool]]:
    """Return by result, in the form of what f returns, the arguments it depends on; and of each, whether it is one as it is.

    Arguments are arrays or their shapes; both are counted as `jax.tree.leaves` does.
    """
    closed, shape = jax.make_jaxpr(f, return_shape=True)(*args)
    out = _through(closed.jaxpr, [frozenset([i]) for i in range(len(closed.jaxpr.invars))])
    given = {id(v) for v in closed.jaxpr.invars}
    return jax.tree.unflatten(jax.tree.structure(shape), out), [id(v) in given for v in closed.jaxpr.outvars]


def _through(jaxpr: Jaxpr, args: list[Found]) -> list[Found]:
    known: dict[PyTree, Found] = dict(zip(jaxpr.invars, args, strict=True))

    def of(v: PyTree) -> Found:
        return NONE if isinstance(v, Literal) else known.get(v, NONE)

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, _apply_equation(eqn, [of(v) for v in eqn.invars]), strict=True))
    return [of(v) for v in jaxpr.outvars]


def _apply_equation(eqn: Eqn, args: list[Found]) -> list[Found]:
    name = eqn.primitive.name
    if name in CALLS:
        return _through(jaxpr_compat.callee(eqn.params).jaxpr, args)
    if name == "cond":
        each = [_through(branch.jaxpr, args[1:]) for branch in jaxpr_compat.branches(eqn.params)]
        return [args[0].union(*found) for found in zip(*each, strict=True)]
    if name == "scan":
        s = jaxpr_compat.scan(eqn.params)
        fixed, carried, rows = args[: s.consts], args[s.consts : s.consts + s.carry], args[s.consts + s.carry :]
        return _again(lambda c: _through(s.body.jaxpr, [*fixed, *c, *rows]), carried)
    return [NONE.union(*args)] * len(eqn.outvars)


def _again(body: Callable[[list[Found]], list[Found]], carried: list[Found]) -> list[Found]:
    """The results of a body that is applied to its own first results until nothing is added."""
    while True:
        out = body(carried)
        wider = [a | b for a, b in zip(carried, out, strict=False)]
        if wider == carried:
            return [*wider, *out[len(carried) :]]
        carried = wider


Leaves = list[Any]  # of (x, memory), or of x alone, in the order of jax.tree.leaves: x comes first
Z = dict[int, Any]  # some of them, by number
PLANT = ""  # in place of an observer's label


class Form(NamedTuple):
    """Of an observer and its plant, or of the plant alone; numbers of leaves."""

    label: str  # of the observer; PLANT: the plant alone
    signals: int  # n of e
    own: tuple[int, ...]  # of z, leaves that differ between lanes
    shared: tuple[int, ...]  # of z, leaves that do not
    counted: tuple[int, ...]  # that a tick moves and no error depends on: counters and flags


def plant_goes(layout: Layout, p: GridPointParams) -> bool:
    """Say whether the plant of a layout goes by products: without it nothing does."""
    if layout.controller or layout.continuous or layout.drifting or not isinstance(p.schedule, Schedule):
        return False
    x = jax.ShapeDtypeStruct(p.x0.shape, float)
    return p.process_std.shape[0] == 0 and _classes(layout, p, PLANT, jax.tree.structure((0, ())), [x]) is not None


def forms(layout: Layout, p: GridPointParams, state: State) -> tuple[Form, ...]:
    """Return the forms of the plant and of every observer that goes by products; none where the plant does not.

    Of the state after `initial_state.begin` the shapes suffice.
    """
    if not plant_goes(layout, p):
        return ()
    each = [_form(layout, p, state, label) for label in (PLANT, *(label for label, _ in layout.observers))]
    return tuple(form for form in each if form)


def leaves_of(state: State, label: str) -> Leaves:
    """Return the leaves of (x, memory), or of x: arrays and LaneArrays."""
    return jax.tree.leaves((state.x, () if label == PLANT else state.memories[label]), is_leaf=lane_array.is_lanes)


def with_leaves(state: State, label: str, leaves: Leaves) -> State:
    """Return the state with other leaves; of an observer with another memory, and x as it was."""
    if label == PLANT:
        return state._replace(x=leaves[0])
    tree = jax.tree.structure(state.memories[label], is_leaf=lane_array.is_lanes)
    return state._replace(memories=state.memories | {label: jax.tree.unflatten(tree, leaves[1:])})


def one_lane(state: State, label: str) -> tuple[PyTree, Leaves]:
    """Return the structure of one lane's (x, memory), and the shapes of its leaves."""
    each = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in leaves_of(state, label)]
    return jax.tree.structure((0, () if label == PLANT else state.memories[label]), is_leaf=lane_array.is_lanes), each


def motion(
    layout: Layout, p: GridPointParams, label: str, tree: PyTree, k: Array, leaves: Leaves
) -> tuple[Array, Leaves]:
    """Return e at tick k of one lane and one observer, and the leaves at tick k + 1; of the plant alone e [0]."""
    (x, memory), now = jax.tree.unflatten(tree, leaves), present(p, k, True)
    moved = layout.plant.step(p.params, now, x)
    if label == PLANT:
        return jnp.zeros(0), [moved]
    o, gains = dict(layout.observers)[label], p.gains[label]
    xhat = o.estimate(gains, memory)
    e = truth(layout, p.params, now, x)[: xhat.shape[0]] - xhat
    return e, [moved, *jax.tree.leaves(o.flow(gains, memory, now))]


def slopes(layout: Layout, p: GridPointParams, label: str, tree: PyTree, k: Array, leaves: Leaves, along: Z) -> PyTree:
    """Return e and some leaves at tick k + 1, by number, and their derivatives along a direction of those leaves."""

    def of_z(z: Z) -> tuple[Array, Z]:
        e, after = motion(layout, p, label, tree, k, [z.get(i, a) for i, a in enumerate(leaves)])
        return e, {i: after[i] for i in z}

    return jax.jvp(of_z, ({i: leaves[i] for i in along},), (along,))


def _form(layout: Layout, p: GridPointParams, state: State, label: str) -> Form | None:
    found = _classes(layout, p, label, *one_lane(state, label))
    if found is None:
        return None
    z, counted = found
    differs = [lane_array.is_lanes(a) for a in leaves_of(state, label)]
    own, common = (tuple(i for i in z if differs[i] == which) for which in (True, False))
    if label == PLANT:
        return Form(label, 0, own, common, ())
    stream = state.streams[label].absolute
    return Form(label, stream.shape[0], own, common, counted) if bool(own) == lane_array.is_lanes(stream) else None


def _classes(
    layout: Layout, p: GridPointParams, label: str, tree: PyTree, each: Leaves
) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """The leaves of z and those that are only counted; None where a tick is not affine in z."""
    first = len(jax.tree.leaves(p)) + 1  # arguments before the leaves: the problem and the tick
    k, many = jax.ShapeDtypeStruct((), int), range(len(each))
    (of_error, of_leaf), same = reach(lambda p, k, z: motion(layout, p, label, tree, k, z), p, k, each)
    moved, floats = [not kept for kept in same[1:]], [jnp.issubdtype(a.dtype, jnp.floating) for a in each]

    def among(found: frozenset[int]) -> set[int]:
        return {i - first for i in found if i >= first}

    z, wanted = set[int](), among(of_error) | {i for i in many if moved[i] and floats[i]}
    while wanted - z:
        z |= wanted
        wanted = set[int]().union(*(among(of_leaf[i]) for i in z if moved[i]))
    counted = tuple(i for i in many if moved[i] and i not in z)
    if not all(floats[i] for i in z) or any(among(of_leaf[i]) & z for i in counted):
        return None

    def slope(p: GridPointParams, k: Array, leaves: Leaves, along: Z) -> PyTree:
        return slopes(layout, p, label, tree, k, leaves, along)[1]

    (e, after), _ = reach(slope, p, k, each, {i: each[i] for i in sorted(z)})
    bent = any(0 <= i - first < len(each) and i - first in z for found in (e, *after.values()) for i in found)
    return None if bent else (tuple(sorted(z)), counted)
