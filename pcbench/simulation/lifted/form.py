"""What of an observer and its plant goes by products: asked of the functions themselves, once a layout, by what depends on what.

Let z be the numbers of plant and memory that a tick moves, or that the error depends on. A tick is affine in z exactly where its
derivative along a direction does not depend on z. This is read from the derivative's own equations, so it is proven, and it
holds for a user's observer as for ours. Refused, and stepped: what is not affine, what depends on a counter or a flag that a memory keeps
(a schedule of the observer's own), closed loops, process noise, plants with numbers of each run, and schedules of each run.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.simulation import lanes
from pcbench.simulation.lifted.reach import reach
from pcbench.simulation.problem import Layout, Problem, State, present, truth
from pcbench.simulation.schedule.shared import Schedule
from pcbench.simulation.start import begin

Leaves = list[Any]  # of (x, memory), in the order of jax.tree.leaves


class Form(NamedTuple):
    """Numbers of leaves of (x, memory) of one observer."""

    label: str
    signals: int
    own: tuple[int, ...]  # of z, those that differ between lanes
    shared: tuple[int, ...]  # of z, those that do not
    counted: tuple[int, ...]  # that a tick moves and no error depends on: counters and flags


def forms(layout: Layout, p: Problem, state: State | None = None) -> tuple[Form, ...]:
    """Return the form of every observer; none where any of them is to be stepped. `state` is one after `begin`, its shapes suffice."""
    if layout.controller or layout.continuous or layout.drifting or not isinstance(p.schedule, Schedule):
        return ()
    if p.process_std.shape[0]:
        return ()
    there = state or jax.eval_shape(lambda p, zero, seeds: begin(layout, p, zero, seeds), p, *_run())
    found = [_form(layout, p, there, label) for label, _ in layout.observers]
    return tuple(form for form in found if form) if all(found) else ()


def leaves_of(state: State, label: str) -> Leaves:
    """Return the leaves of (x, memory): arrays and Lanes."""
    return jax.tree.leaves((state.x, state.memories[label]), is_leaf=lanes.is_lanes)


def with_leaves(state: State, label: str, leaves: Leaves) -> State:
    """Return the state with other leaves of (x, memory)."""
    tree = jax.tree.structure((state.x, state.memories[label]), is_leaf=lanes.is_lanes)
    x, memory = jax.tree.unflatten(tree, leaves)
    return state._replace(x=x, memories=state.memories | {label: memory})


def motion(layout: Layout, p: Problem, label: str, tree: Any, k: Array, leaves: Leaves) -> tuple[Array, Leaves]:
    """Return e at tick k of one lane and one observer, and the leaves of (x, memory) at tick k + 1."""
    x, memory = jax.tree.unflatten(tree, leaves)
    now, o, gains = present(p, k, True), dict(layout.observers)[label], p.gains[label]
    xhat = o.estimate(gains, memory)
    e = truth(layout, p.params, now, x)[: xhat.shape[0]] - xhat
    moved = layout.plant.step(p.params, now, x), o.flow(gains, memory, now)
    return e, jax.tree.leaves(moved)


def one_lane(state: State, label: str) -> tuple[Any, Leaves]:
    """Return the structure of one lane's (x, memory), and the shapes of its leaves."""
    each = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in leaves_of(state, label)]
    return jax.tree.structure((0, state.memories[label]), is_leaf=lanes.is_lanes), each


def _form(layout: Layout, p: Problem, state: State, label: str) -> Form | None:
    tree, each = one_lane(state, label)
    first = len(jax.tree.leaves(p)) + 1  # arguments before the leaves: the problem and the tick
    k, many = jax.ShapeDtypeStruct((), int), range(len(each))
    (of_error, of_leaf), same = reach(lambda p, k, z: motion(layout, p, label, tree, k, z), p, k, each)
    moved = [not kept for kept in same[1:]]
    floats = [jnp.issubdtype(a.dtype, jnp.floating) for a in each]
    z, wanted = set[int](), {i - first for i in of_error if i >= first} | {i for i in many if moved[i] and floats[i]}
    while wanted - z:
        z |= wanted
        wanted = {i - first for j in z if moved[j] for i in of_leaf[j] if i >= first}
    counted = [i for i in many if moved[i] and i not in z]
    if not all(floats[i] for i in z) or any(i - first in z for j in counted for i in of_leaf[j]):
        return None

    def slope(p: Problem, k: Array, leaves: Leaves, along: dict[int, Array]) -> tuple[Array, Leaves]:
        return tangents(layout, p, label, tree, k, leaves, along)

    found, _ = reach(slope, p, k, each, {i: each[i] for i in sorted(z)})
    if any(i - first in z for one in jax.tree.leaves(found, is_leaf=lambda a: isinstance(a, frozenset)) for i in one):
        return None
    differs = [lanes.is_lanes(a) for a in leaves_of(state, label)]
    own, common = (tuple(i for i in sorted(z) if differs[i] == which) for which in (True, False))
    if bool(own) != lanes.is_lanes(state.streams[label].absolute):
        return None
    return Form(label, state.streams[label].absolute.shape[0], own, common, tuple(counted))


def tangents(
    layout: Layout, p: Problem, label: str, tree: Any, k: Array, leaves: Leaves, along: dict[int, Array]
) -> tuple[Array, dict[int, Array]]:
    """Return the derivative of e and of the leaves at tick k + 1, by number, along a direction of some leaves."""

    def of_z(z: dict[int, Array]) -> tuple[Array, dict[int, Array]]:
        e, after = motion(layout, p, label, tree, k, [z.get(i, a) for i, a in enumerate(leaves)])
        return e, {i: after[i] for i in z}

    slope: tuple[Array, dict[int, Array]] = jax.jvp(of_z, ({i: leaves[i] for i in along},), (along,))[1]
    return slope


def _run() -> tuple[Array, Array]:
    return jnp.asarray(0), jnp.zeros(1, int)
