"""Check the shapes that a controller's functions return, before anything is compiled or simulated."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from pcbench.errors import UserError
from pcbench.protocols import Controller, Now, Params
from pcbench.simulation.shape_checks import trace_shapes


class Sizes(NamedTuple):
    """n states, s unknown inputs after the states, m inputs."""

    n: int
    s: int
    m: int


def check(label: str, law: Controller, params: Params, sizes: Sizes) -> None:
    """Raise UserError with controller, function, returned and expected shape if a shape is wrong.

    - `target`: a vector of at most n
    - `before`, `command`: [m]
    - the memory of `command`: the structure, shapes and types that `start` returns

    An estimate may contain the plant's unknown inputs after the states.
    """
    for length in sorted({sizes.n, sizes.n + sizes.s}):
        _check(label, law, params, sizes, length)


def _check(label: str, law: Controller, params: Params, sizes: Sizes, length: int) -> None:
    tick, estimate = jnp.asarray(1), jax.ShapeDtypeStruct((length,), float)

    def shapes_of(name: str, f: Any, *args: PyTree) -> PyTree:
        advice = "for one run that accepts estimates with further signals after the states"
        problem = f"controller {label}: {name} cannot be traced with an estimate of {length}"
        return trace_shapes(problem, advice, f, params, *args)

    def command(params: Params, xhat: PyTree, *memory: PyTree) -> PyTree:
        now = Now(tick * 1.0, tick, jnp.asarray(1.0), jnp.zeros(sizes.m), lambda age: jnp.zeros(sizes.m))
        decide: PyTree = law.command
        out = decide(params, now, xhat, lambda i: jnp.zeros(sizes.m), *memory)
        return out if memory else (out, ())

    target = shapes_of("target", lambda params: jnp.asarray(law.target(params, tick)))
    if target.ndim != 1 or target.shape[0] > sizes.n:
        raise UserError(
            f"controller {label}: target returned shape {target.shape}, expected the set point of the first states, "
            f"({sizes.n},) at most; return a vector."
        )
    first_command = shapes_of("before", lambda params, xhat: jnp.asarray(law.before(params, tick, xhat)), estimate)
    memory = [shapes_of("start", law.start, estimate)] if law.start else []
    try:
        u, next_memory = shapes_of("command", command, estimate, *memory)
    except (TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(
            f"controller {label}: command returned no pair, expected (command, memory), as the law has `start`; return "
            "both."
        ) from None
    for name, output in (("before", first_command), ("command", u)):
        if getattr(output, "shape", None) != (sizes.m,):
            raise UserError(
                f"controller {label}: {name} returned {_form(output)}, expected ({sizes.m},), a number for each input; return "
                "that."
            )
    if memory and _form(next_memory) != _form(memory[0]):
        raise UserError(
            f"controller {label}: command keeps {_form(next_memory)}, expected what start returns, {_form(memory[0])}; "
            "keep its structure, shapes and types."
        )


def _form(tree: PyTree) -> str:
    """Return the structure of a tree with its shapes and types, as text."""
    if hasattr(tree, "shape"):
        return f"shape {tuple(tree.shape)} of {tree.dtype}"
    return str(jax.tree.map(lambda a: f"{a.dtype}{list(a.shape)}", tree))
