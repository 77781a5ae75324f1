"""The functions of an observer in C, from those of the protocol: what each is given, and what it leaves.

What a function knows of the present is the struct `now`. The inputs of the past stand there in a ring, from which `past_u` reads
what was applied so many ticks ago: 0 before tick 0, and NaN beyond the ring.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.errors import UserError
from pcbench.export import program, structs
from pcbench.export.structs import Field
from pcbench.export.terms import Writer, kind_of, stored
from pcbench.protocols import Arrival, Now, Observer


class Shapes(NamedTuple):
    """What an observer is of: n states, m inputs, q outputs, what it notes, and the rows of past inputs."""

    states: int
    inputs: int
    outputs: int
    noted: int
    past: int


class Function(NamedTuple):
    """One function in C."""

    name: str
    head: str  # its arguments
    lines: list[str]


class Source(NamedTuple):
    """An observer in C."""

    gains: list[Field]
    memory: list[Field]
    now: list[Field]
    arrival: list[Field]
    functions: list[Function]
    looks_back: bool  # whether any of them reads past inputs
    estimates: int


def present(t: Array, tick: Array, dt: Array, u: Array, past: Array, decided: bool) -> Now:
    """Return the present of a tick, whose own input is `decided`, as it is in `flow`, or not yet."""
    rows = past.shape[0]

    def past_u(age: Array) -> Array:
        n = tick - age
        row = jax.lax.dynamic_index_in_dim(past, n % rows, 0, False)
        return jnp.where(n < 0, 0.0, jnp.where(age < rows + (not decided), row, jnp.nan))

    return Now(t, tick, dt, u, past_u)


def source(label: str, o: Observer, gains: Any, xhat0: Any, shapes: Shapes) -> Source:
    """Return an observer in C; raise UserError, naming the function and the primitive, where it cannot be written."""
    n, m, q, r, rows = shapes
    memory = jax.eval_shape(o.init, gains, xhat0)
    whole, number, flag = jax.ShapeDtypeStruct((), int), jax.ShapeDtypeStruct((), float), bool
    now = [number, whole, number, jax.ShapeDtypeStruct((m,), float), jax.ShapeDtypeStruct((rows, m), float)]
    ints = jax.ShapeDtypeStruct((q,), int)
    arrival = Arrival(
        value=jax.ShapeDtypeStruct((q,), float),
        fresh=jax.ShapeDtypeStruct((q,), flag),
        age=ints,
        index=ints,
        note=jax.ShapeDtypeStruct((r,), float),
        since=whole,
    )
    there = {
        "g": structs.fields(gains, "gain"),
        "m": structs.fields(memory, "value"),
        "now": [Field(name, kind_of(a.dtype), a.shape) for name, a in zip(("t", "tick", "dt", "u", "past"), now, strict=True)],
        "a": [Field(name, kind_of(a.dtype), a.shape) for name, a in arrival._asdict().items()],
    }
    P = f"const {label}_gains *g"
    M, C, N = f"{label}_memory *m", f"const {label}_memory *m", f"const {label}_now *now"
    vectors = {"xhat0": ("real", (n,)), "fresh": ("bool", (q,))}
    looks: list[bool] = []

    def made(name: str, head: str, given: str, f: Callable[..., Any], out: str, *shapes: Any) -> Function:
        w, args = Writer(), []
        for each in given.split():
            args += structs.entries(each, there[each]) if each in there else [stored(each, vectors[each][1])]
        closed = jax.make_jaxpr(f)(*shapes)
        try:
            left = program.write(w, closed, args)
        except program.Hindered as hindered:
            raise UserError(
                f"{label}: {name} needs {hindered}, which cannot be written in C here, expected primitives that can; export "
                "another observer, or write this one by hand from its gains."
            ) from None
        into = structs.entries("m", there["m"]) if out == "m" else [stored(out, left[0].shape)]
        kinds = [kind_of(v.aval.dtype) for v in closed.jaxpr.outvars]
        program.assign(w, [*zip(kinds, into, left, strict=True)])
        w.count()
        looks.append(any("now->past[" in line for line in w.lines))
        return Function(name, head, w.lines)

    decided = lambda now: present(*now, decided=True)  # noqa: E731
    undecided = lambda now: present(*now, decided=False)  # noqa: E731
    functions = [
        made("init", f"{P}, const real xhat0[{n}], {M}", "g xhat0", o.init, "m", gains, xhat0),
        made("flow", f"{P}, {M}, {N}", "g m now", lambda g, m, now: o.flow(g, m, decided(now)), "m", gains, memory, now),
        made("estimate", f"{P}, {C}, real *xhat", "g m", lambda g, m: jnp.asarray(o.estimate(g, m)), "xhat", gains, memory),
        made(
            "jump", f"{P}, {M}, {N}, const {label}_arrival *a", "g m now a",
            lambda g, m, now, a: o.jump(g, m, undecided(now), a), "m", gains, memory, now, arrival,
        ),
    ]  # fmt: skip
    if r:
        f = lambda g, m, now: jnp.asarray(o.note(g, m, undecided(now)))  # noqa: E731
        functions.insert(1, made("note", f"{P}, {C}, {N}, real *note", "g m now", f, "note", gains, memory, now))
    if told := o.sampled:
        f = lambda g, m, now, fresh: told(g, m, undecided(now), fresh)  # noqa: E731
        flags = jax.ShapeDtypeStruct((q,), flag)
        functions.insert(
            -1, made("sampled", f"{P}, {M}, {N}, const bool *fresh", "g m now fresh", f, "m", gains, memory, now, flags)
        )
    if spread := o.covariance:
        f = lambda g, m, now: jnp.asarray(spread(g, m, undecided(now)))  # noqa: E731
        try:
            functions.append(made("covariance", f"{P}, {C}, {N}, real *P", "g m now", f, "P", gains, memory, now))
        except UserError:
            pass
    estimates = jax.eval_shape(lambda g, m: jnp.asarray(o.estimate(g, m)), gains, memory).shape[0]
    return Source(*there.values(), functions, any(looks), estimates)  # type: ignore[arg-type]


def numbers(tree: Any) -> list[np.ndarray]:
    """Return the arrays of a pytree in the order of its fields."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
