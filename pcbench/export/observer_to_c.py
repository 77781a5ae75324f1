"""The functions of an observer in C: their arguments and their results.

The struct `now` contains the present tick, and past inputs in a ring buffer. `past_u` reads the input of a given age
from it. Before tick 0 the input is 0, unless `now` was initialised with other values. Beyond the ring buffer it is NaN.
"""

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, ShapeDtypeStruct
from jaxtyping import PyTree

from pcbench.dynamics.room import within_room
from pcbench.engine.jaxpr_compat import ClosedJaxpr
from pcbench.errors import UserError
from pcbench.export import jaxpr_to_c, structs
from pcbench.export.structs import Field
from pcbench.export.terms import Entries, Writer, array_entries, kind_of
from pcbench.protocols import Arrival, Now, Observer


class Shapes(NamedTuple):
    """The sizes of an observer: m inputs, q outputs, its snapshot, and the rows of past inputs."""

    inputs: int
    outputs: int
    snapshot_size: int
    past: int


# of functions by name: the function, its arguments, and what it changes
FunctionTable = dict[str, tuple[Callable[..., PyTree], tuple[str, ...], str]]
PastReads = Literal["not", "once", "in a loop"]


class Function(NamedTuple):
    """One function in C."""

    name: str
    returns: str  # a type
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
    jump_looks_back: PastReads  # and how the jump does
    estimates: int


def present(t: Array, tick: Array, dt: Array, u: Array, past: Array, *, decided: bool) -> Now:
    """Return the argument `now` of a tick; its own input is `decided`, as in `flow`, or not yet."""
    rows = past.shape[0]

    def past_u(age: Array) -> Array:
        age = within_room(age, age < rows + (not decided))
        n = tick - age
        row = jax.lax.dynamic_index_in_dim(past, n % rows, 0, False)
        return jnp.where(n < 0, 0.0, jnp.where(age < rows + (not decided), row, jnp.nan))

    return Now(t, tick, dt, u, past_u)


def source(label: str, o: Observer, gains: PyTree, xhat0: Array, shapes: Shapes) -> Source:
    """Return an observer in C; raise UserError with the function and the primitive if C cannot express it."""
    memory = jax.eval_shape(o.init, gains, xhat0)
    now, arrival, flags = _argument_shapes(shapes)
    fields = {
        "g": structs.fields(gains, "gain"),
        "m": structs.fields(memory, "value"),
        "now": _make_fields(("t", "tick", "dt", "u", "past"), now),
        "a": structs.fields(arrival, "arrival"),
    }
    vectors = {"xhat0": _make_fields(("xhat0",), [xhat0]), "mask": _make_fields(("mask",), [flags])}
    out = []
    for name, (f, args, changes) in _observer_functions(o, shapes.snapshot_size).items():
        values = {"g": gains, "m": memory, "now": now, "a": arrival, "xhat0": xhat0, "mask": flags}
        program = jax.make_jaxpr(f)(*(values[arg] for arg in args))
        entries: list[Entries] = []
        for arg in args:
            is_struct = arg in fields
            entries += structs.entries(arg, fields[arg]) if is_struct else [array_entries(arg, vectors[arg][0].shape)]
        into = structs.entries("m", fields["m"]) if changes == "m" else None
        try:
            lines = _lines(program, entries, into, changes, name == "jump")
        except jaxpr_to_c.UnsupportedPrimitive as error:
            if name == "covariance":
                continue
            raise UserError(
                f"{label}: {name} needs {error}, which cannot be written in C here, expected primitives that can; export "
                "another observer, or write this one by hand from its gains."
            ) from None
        out.append(Function(name, "int" if name == "jump" else "void", _head(label, args, changes), lines))
    estimates = jax.eval_shape(lambda g, m: jnp.asarray(o.estimate(g, m)), gains, memory).shape[0]
    looks = any("now->past[" in line for f in out for line in f.lines)
    return Source(
        gains=fields["g"],
        memory=fields["m"],
        now=fields["now"],
        arrival=fields["a"],
        functions=out,
        looks_back=looks,
        jump_looks_back=_past_reads("jump", out),
        estimates=estimates,
    )


def _past_reads(name: str, functions: list[Function]) -> PastReads:
    """Return how a function reads past inputs: in a loop it may read inputs from before the arriving sample."""
    loops: list[int] = []
    reads = False
    for line in next(f.lines for f in functions if f.name == name):
        indent = len(line) - len(line.lstrip())
        loops = [loop for loop in loops if loop < indent]
        reads |= "now->past[" in line
        if loops and "now->past[" in line:
            return "in a loop"
        loops += [indent] if line.lstrip().startswith("for (") else []
    return "once" if reads else "not"


def _argument_shapes(shapes: Shapes) -> tuple[list[ShapeDtypeStruct], Arrival, ShapeDtypeStruct]:
    """Return types and shapes of the functions' arguments other than gains and memory."""

    def kind(dtype: type, *shape: int) -> Any:
        return jax.ShapeDtypeStruct(shape, dtype)

    m, q, r, rows = shapes
    now = [kind(float), kind(int), kind(float), kind(float, m), kind(float, rows, m)]
    arrival = Arrival(
        value=kind(float, q),
        mask=kind(bool, q),
        age=kind(int, q),
        index=kind(int, q),
        snapshot=kind(float, r),
        ticks_since_arrival=kind(int),
    )
    return now, arrival, kind(bool, q)


def _make_fields(names: Iterable[str], kinds: Iterable[ShapeDtypeStruct | Array]) -> list[Field]:
    return [Field(name, kind_of(a.dtype), tuple(a.shape)) for name, a in zip(names, kinds, strict=True)]


def _observer_functions(o: Observer, snapshot_size: int) -> FunctionTable:
    """Return the functions of the observer in the order of a tick, with their arguments and what they change."""

    def event_now(now: Iterable[Array]) -> Now:
        return present(*now, decided=False)

    out: FunctionTable = {"init": (o.init, ("g", "xhat0"), "m")}
    if snapshot_size:
        out["snapshot"] = (
            lambda g, m, now: jnp.asarray(o.snapshot(g, m, event_now(now))),
            ("g", "m", "now"),
            "snapshot",
        )
    if on_sample := o.on_sample:
        out["sampled"] = (lambda g, m, now, mask: on_sample(g, m, event_now(now), mask), ("g", "m", "now", "mask"), "m")
    out["jump"] = (lambda g, m, now, a: o.jump(g, m, event_now(now), _complete(a)), ("g", "m", "now", "a"), "m")
    out["estimate"] = (lambda g, m: jnp.asarray(o.estimate(g, m)), ("g", "m"), "xhat")
    if cov := o.covariance:
        out["covariance"] = (lambda g, m, now: jnp.asarray(cov(g, m, event_now(now))), ("g", "m", "now"), "P")
    out["flow"] = (lambda g, m, now: o.flow(g, m, present(*now, decided=True)), ("g", "m", "now"), "m")
    return out


def _complete(a: Arrival) -> Arrival:
    """Return an arrival in which channels without an arrival have value 0 and the age of the other channels."""
    oldest = jnp.max(jnp.where(a.mask, a.age, 0))
    return a._replace(value=jnp.where(a.mask, a.value, 0.0), age=jnp.where(a.mask, a.age, oldest))


def _lines(
    program: ClosedJaxpr, entries: list[Entries], into: list[Entries] | None, changes: str, refuses: bool
) -> list[str]:
    """Return the lines of a function that writes the outputs of a program `into` a struct, or an array called `changes`.

    A function that `refuses` returns 1 and changes nothing if the program exceeds the room, and otherwise returns 0.
    """
    w = Writer()
    outputs = jaxpr_to_c.write(w, program, entries)
    kinds = [kind_of(v.aval.dtype) for v in program.jaxpr.outvars]
    if w.checks and refuses:
        w.say("if (outside) return 1;")
    jaxpr_to_c.assign(w, [*zip(kinds, into or [array_entries(changes, outputs[0].shape)], outputs, strict=True)])
    w.count()
    if refuses:
        w.say("return 0;")
    return [
        *(["    bool outside = false;"] if w.checks else []),
        *w.lines,
        *(["    (void)outside;"] if w.checks and not refuses else []),
    ]


def _head(label: str, args: tuple[str, ...], changes: str) -> str:
    """Return the declaration of a function's arguments in C."""
    const = "" if changes == "m" else "const "
    texts = {
        "g": f"const {label}_gains *g",
        "m": f"{const}{label}_memory *m",
        "now": f"const {label}_now *now",
        "a": f"const {label}_arrival *a",
        "xhat0": "const real *xhat0",
        "mask": "const bool *mask",
    }
    output = [texts["m"]] if changes == "m" and "m" not in args else [f"real *{changes}"] if changes != "m" else []
    return ", ".join([*(texts[arg] for arg in args), *output])


def numbers(tree: PyTree) -> list[np.ndarray]:
    """Return the arrays of a pytree in the order of its fields."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
