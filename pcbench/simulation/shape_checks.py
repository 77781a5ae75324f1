"""Check the shapes that an observer's functions return, before anything is compiled or simulated."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from pcbench.errors import UserError, describe_exception
from pcbench.protocols import Arrival, Memory, Observer
from pcbench.simulation.types import GridPointParams, present


def trace_shapes(problem: str, advice: str, f: Callable[..., PyTree], *args: PyTree) -> PyTree:
    """Return the shapes that f returns; raise UserError with `problem`, the exception and `advice` if it cannot be traced."""
    try:
        return jax.eval_shape(f, *args)
    except Exception as error:
        raise UserError(f"{problem} ({describe_exception(error)}); expected pure jax.numpy code {advice}.") from error


def check(label: str, observer: Observer, p: GridPointParams, continuous: bool = False) -> None:
    """Raise UserError with observer, function, returned and expected shape if a shape is wrong.

    - `estimate`: [n], or [n + s] with the plant's unknown inputs
    - `snapshot`: a vector
    - `jump`, `flow`, and `field` if measurements are `continuous`: the structure, shapes and types of the memory
    """
    n, q, k = p.x0.shape[0], p.noise_std.shape[0], jnp.asarray(1)
    signals = len(p.band)
    state, value = jax.ShapeDtypeStruct((n,), float), jax.ShapeDtypeStruct((q,), float)

    at_jump = partial(present, k=k, decided=False)

    def at_arrival(f: Any) -> PyTree:
        def at_event(p: GridPointParams, memory: Memory, value: PyTree, snapshot: PyTree) -> PyTree:
            arrival = Arrival(value, jnp.ones(q, bool), jnp.ones(q, int), jnp.ones(q, int), snapshot, k)
            return f(p.gains[label], memory, at_jump(p), arrival)

        return at_event

    def shapes_of(name: str, f: Any, *args: PyTree) -> PyTree:
        advice = "for one run, with jnp.where instead of if"
        return trace_shapes(f"observer {label}: {name} cannot be traced", advice, f, p, *args)

    memory = shapes_of("init", lambda p, x: observer.init(p.gains[label], x), state)
    snapshot = shapes_of("snapshot", lambda p, m: jnp.asarray(observer.snapshot(p.gains[label], m, at_jump(p))), memory)
    if snapshot.ndim != 1:
        raise UserError(
            f"observer {label}: snapshot returned shape {snapshot.shape}, expected a vector [r]; use jnp.atleast_1d."
        )
    xhat = shapes_of("estimate", lambda p, m: jnp.asarray(observer.estimate(p.gains[label], m)), memory)
    if xhat.shape not in ((n,), (signals,)):
        suffix = f", or ({signals},) with its unknown inputs" if signals > n else ""
        raise UserError(
            f"observer {label}: estimate returned shape {xhat.shape}, expected ({n},): every state of the plant{suffix}; "
            "return all of it."
        )
    _check_memory(label, "jump", shapes_of("jump", at_arrival(observer.jump), memory, value, snapshot), memory)
    if (on_sample := observer.on_sample) is not None:
        mask = jax.ShapeDtypeStruct((q,), bool)
        output = shapes_of("on_sample", lambda p, m, f: on_sample(p.gains[label], m, at_jump(p), f), memory, mask)
        _check_memory(label, "on_sample", output, memory)
    if (init_random := observer.init_random) is not None:
        words = jax.ShapeDtypeStruct((2,), jnp.uint32)
        output = shapes_of("init_random", lambda p, m, w, x: init_random(p.gains[label], m, w, x), memory, words, state)
        _check_memory(label, "init_random", output, memory)
    if (covariance := observer.covariance) is not None:
        P = shapes_of("covariance", lambda p, m: jnp.asarray(covariance(p.gains[label], m, at_jump(p))), memory)
        meaning = "the covariance of the errors of all estimated signals; return all of it"
        _require_shape(label, "covariance", P, (*xhat.shape, *xhat.shape), meaning)
    if (bounds := observer.bounds) is not None:
        ends = shapes_of("bounds", lambda p, m: jnp.asarray(bounds(p.gains[label], m)), memory)
        meaning = "the lower and upper bounds of all estimated signals; return both"
        _require_shape(label, "bounds", ends, (2, *xhat.shape), meaning)
    if (delay := observer.delay) is not None:
        moments = shapes_of("delay", lambda p, m: jnp.asarray(delay(p.gains[label], m, at_jump(p))), memory)
        _require_shape(label, "delay", moments, (2,), "the mean delay and its standard deviation [s]; return both")
    if observer.innovation is not None:
        stats = shapes_of("innovation", at_arrival(observer.innovation), memory, value, snapshot)
        if (shapes := [leaf.shape for leaf in jax.tree.leaves(stats)]) not in (
            *([()] * count for count in (2, 3, 4)),
            *([*[()] * 4, *[value.shape] * count] for count in (1, 2)),
        ):
            raise UserError(
                f"observer {label}: innovation returned shapes {shapes}, expected two numbers, nu' S^-1 nu and its "
                "degrees of freedom, or the fields of pcbench.InnovationStats; return these."
            )
    if continuous and observer.field is not None:
        field = observer.field
        output = shapes_of("field", lambda p, m, y: field(p.gains[label], m, present(p, k, True), y), memory, value)
        _check_memory(label, "field", output, memory)
    next_memory = shapes_of("flow", lambda p, m: observer.flow(p.gains[label], m, present(p, k, True)), memory)
    _check_memory(label, "flow", next_memory, memory)


def _require_shape(label: str, name: str, output: Any, shape: tuple[int, ...], meaning: str) -> None:
    if output.shape != shape:
        raise UserError(f"observer {label}: {name} returned shape {output.shape}, expected {shape}: {meaning}.")


def _check_memory(label: str, name: str, output: PyTree, memory: Memory) -> None:
    def form(tree: PyTree) -> PyTree:
        return jax.tree.map(lambda a: f"{a.dtype}{list(a.shape)}", tree)

    if str(jax.tree.structure(output)) != str(jax.tree.structure(memory)) or form(output) != form(memory):
        raise UserError(
            f"observer {label}: {name} returned {form(output)}, expected the memory that init returns, {form(memory)}; "
            "keep its structure, shapes and types."
        )
