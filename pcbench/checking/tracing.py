"""The programs that jax makes of an observer's functions, and the numbers written into them."""

import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.checking.trial import Case, Trial
from pcbench.protocols import Arrival
from pcbench.simulation.lanes.primitives import ClosedJaxpr, Literal, inner
from pcbench.simulation.problem import present

TICK, AGE = 5, 2  # where the functions are asked: a tick and an age that every schedule has


class Given(NamedTuple):
    """With what the functions are asked."""

    gains: Any
    memory: Any
    value: Any  # [q]
    note: Any  # [r]
    xhat0: Any  # [n]
    inputs: Any  # [N+1, m]


class Asked(NamedTuple):
    """A function of the protocol, as f(given)."""

    name: str
    f: Callable[[Given], Any]


class Program(NamedTuple):
    """A traced function: its text without addresses, and the numbers written into it."""

    text: str
    numbers: tuple[np.ndarray, ...]
    jaxpr: Any


def given(t: Trial, case: Case, gains: Any) -> Given:
    """Return arguments of a plausible size, with a memory as the observer makes it."""
    o, p = t.observer, case.problem
    n, q = p.x0.shape[0], p.noise_std.shape[0]
    gains, u = jax.tree.map(jnp.asarray, gains), jnp.asarray(p.inputs)
    xhat0 = jnp.asarray(p.x0) + jnp.arange(1.0, n + 1)

    def start(gains: Any, xhat0: Any) -> Any:
        memory = o.init(gains, xhat0)
        return memory, jnp.asarray(o.note(gains, memory, _now(p, u, False)))

    memory, note = jax.jit(start)(gains, xhat0)
    return Given(gains, memory, jnp.arange(1.0, q + 1), note, xhat0, u)


def asked(t: Trial, case: Case) -> list[Asked]:
    """Return every function of the observer."""
    o, p = t.observer, case.problem
    q = p.noise_std.shape[0]

    def jump(g: Given) -> Any:
        arrival = Arrival(g.value, jnp.ones(q, bool), jnp.full(q, AGE), jnp.ones(q, int), g.note, jnp.asarray(AGE))
        return o.jump(g.gains, g.memory, _now(p, g.inputs, False), arrival)

    return [
        Asked("init", lambda g: o.init(g.gains, g.xhat0)),
        Asked("note", lambda g: o.note(g.gains, g.memory, _now(p, g.inputs, False))),
        Asked("jump", jump),
        Asked("flow", lambda g: o.flow(g.gains, g.memory, _now(p, g.inputs, True))),
        Asked("estimate", lambda g: o.estimate(g.gains, g.memory)),
    ]


def _now(p: Any, inputs: Any, decided: bool) -> Any:
    return present(p._replace(inputs=inputs, dt=jnp.asarray(p.dt)), jnp.asarray(TICK), decided)


def program(a: Asked, g: Given) -> Program:
    """Trace a function anew."""
    closed = jax.make_jaxpr(lambda g: a.f(g))(g)
    numbers = tuple(np.asarray(x) for x in (*closed.consts, *_literals(closed.jaxpr)) if np.size(x))
    return Program(re.sub(r"0x[0-9a-f]+", "", str(closed.jaxpr)), numbers, closed.jaxpr)


def alike(a: Program, b: Program) -> bool:
    """Say whether two programs are the same, numbers included."""
    pairs = zip(a.numbers, b.numbers, strict=False)
    return a.text == b.text and len(a.numbers) == len(b.numbers) and all(np.array_equal(x, y) for x, y in pairs)


def inside(jaxpr: Any) -> Iterator[Any]:
    """Yield a program and every program in it."""
    yield jaxpr
    for eqn in jaxpr.eqns:
        for each in inner(eqn.params):
            yield from inside(getattr(each, "jaxpr", each))


def _literals(jaxpr: Any) -> Iterator[Any]:
    for program in inside(jaxpr):
        for eqn in program.eqns:
            yield from (v.val for v in eqn.invars if isinstance(v, Literal))
            for each in inner(eqn.params):
                yield from each.consts if isinstance(each, ClosedJaxpr) else ()
