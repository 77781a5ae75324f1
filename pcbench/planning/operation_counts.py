"""What an observer costs: multiplications of a sample and of a tick, counted from its own functions at one lane, and bytes.

A sample costs `snapshot`, `on_sample` where there is one, and `jump`; a tick `flow` and `estimate`. Counted are the products of
floats: each of a matrix product (with its addition), each entry multiplied, divided, or put through a root, a power or another
function. Additions, comparisons and what is only moved are free. A loop counts as often as it goes round, for the last sample
of a run whose samples are a period apart and of the believed age; of the branches of a choice that one runs, where it is made
by an index. So whole numbers that an observer remembers (ticks, places in a ring) are those of the end, for loops over a window
that is not full yet are shorter; floats are those of the start, and a loop that depends on them is counted as it goes there.
Not claimed: time. What a processor does with so many products is for a clock to say.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import Eqn, Jaxpr
from pcbench.planning.padding import Plan
from pcbench.protocols import Arrival, Gains, Memory, Observer
from pcbench.simulation.types import GridPointParams, present

ONCE = {"mul", "div", "rem", "sqrt", "rsqrt", "cbrt", "square", "integer_pow", "pow", "exp", "exp2", "expm1", "log"}
ONCE |= {"log1p", "logistic", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"}
Value = Callable[[], ArrayLike]  # computed when it is asked for
CUBIC = ("lu", "cholesky", "triangular_solve")  # of n x n: about n^3 / 3 products, or as many as it solves


class Cost(NamedTuple):
    """What one lane of an observer costs."""

    sample: int  # multiplications
    tick: int
    memory: int  # bytes between ticks; what it notes travels with the sample


def costs(p: Plan) -> dict[str, Cost]:
    """Return the cost of every observer of a cell by label."""
    return {label: _of(p, name, o) for label, (name, o) in zip(p.labels, p.layout.observers, strict=True)}


def _of(p: Plan, name: str, o: Observer) -> Cost:
    problem: GridPointParams = jax.tree.map(jnp.asarray, p.problem._replace(schedule=()))
    gains, q, clocks = problem.gains[name], len(p.cell.scenario.sampling.delay), p.cell.times.clocks
    age = max((clock.period if clock.delay is None else clock.delay) + clock.later for clock in clocks)
    period = max(clock.period for clock in clocks)
    last = max((p.cell.times.ticks - age) // period, 1)
    memory = _worn(o, problem, last, age, period, name, q)
    k = jnp.asarray(age + last * period)
    snapshot = o.snapshot(gains, memory, present(problem, k - age, False))
    decided, open_ = (present(problem, k, known) for known in (True, False))

    def sample(gains: Gains, memory: Memory, value: Array) -> PyTree:
        told = o.on_sample(gains, memory, open_, jnp.ones(q, bool)) if o.on_sample else memory
        return o.snapshot(gains, told, open_), o.jump(gains, told, open_, _arrival(value, age, snapshot))

    def tick(gains: Gains, memory: Memory) -> PyTree:
        return o.flow(gains, memory, decided), o.estimate(gains, memory)

    size = sum(np.size(leaf) * np.asarray(leaf).dtype.itemsize for leaf in jax.tree.leaves(memory))
    return Cost(
        count_multiplications(sample, gains, memory, jnp.ones(q)), count_multiplications(tick, gains, memory), size
    )


def _arrival(value: Array, age: int, snapshot: Array) -> Arrival:
    q = len(value)
    return Arrival(value, jnp.ones(q, bool), jnp.full(q, age), jnp.ones(q, int), snapshot, jnp.asarray(1))


def _worn(o: Observer, p: GridPointParams, last: int, age: int, period: int, name: str, q: int) -> Memory:
    """The memory of the start, its whole numbers as they are before sample number `last` arrives."""
    gains = p.gains[name]
    leaves, tree = jax.tree.flatten(jax.tree.map(jnp.asarray, o.init(gains, p.xhat0)))
    whole = [not jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    if not any(whole):
        return jax.tree.unflatten(tree, leaves)

    def with_(ticks: Sequence[Array]) -> Memory:
        new = iter(ticks)
        return jax.tree.unflatten(tree, [next(new) if w else a for w, a in zip(whole, leaves, strict=True)])

    def after(number: Array, ticks: Sequence[Array]) -> list[Array]:
        memory, now = with_(ticks), present(p, age + number * period, False)
        snapshot = o.snapshot(gains, memory, present(p, number * period, False))
        told = o.on_sample(gains, memory, now, jnp.ones(q, bool)) if o.on_sample else memory
        new = jax.tree.leaves(o.jump(gains, told, now, _arrival(jnp.ones(q), age, snapshot)))
        return [a.astype(b.dtype) for a, b, w in zip(new, leaves, whole, strict=True) if w]

    before = [a for a, w in zip(leaves, whole, strict=True) if w]
    return with_(jax.jit(lambda before: lax.fori_loop(0, last, after, before))(before))


def count_multiplications(f: Callable[..., PyTree], *args: PyTree) -> int:
    """Return the multiplications of a function at these arguments."""
    closed = jax.make_jaxpr(f)(*args)
    return _walk_jaxpr(
        closed.jaxpr, [*map(_constant_value, closed.consts)], [*map(_constant_value, jax.tree.leaves(args))]
    )[0]


def _constant_value(value: ArrayLike) -> Value:
    return lambda: value


def _walk_jaxpr(jaxpr: Jaxpr, consts: Sequence[Value], args: Sequence[Value]) -> tuple[int, list[Value]]:
    """Count a program's multiplications; of what it computes, only what a loop or a choice depends on is computed."""
    env = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))

    def read(v: Any) -> Value:
        return _constant_value(v.val) if isinstance(v, jaxpr_compat.Literal) else env[v]

    total = 0
    for eqn in jaxpr.eqns:
        many, out = _step(eqn, [*map(read, eqn.invars)])
        total += many
        env.update(zip(eqn.outvars, out, strict=True))
    return total, [*map(read, jaxpr.outvars)]


def _step(eqn: Eqn, given: list[Value]) -> tuple[int, list[Value]]:
    name = eqn.primitive.name
    if name in jaxpr_compat.CALLS:
        program = jaxpr_compat.callee(eqn.params)
        return _walk_jaxpr(program.jaxpr, [*map(_constant_value, program.consts)], given)
    if name == "cond":
        program = jaxpr_compat.branches(eqn.params)[int(np.asarray(given[0]()))]
        return _walk_jaxpr(program.jaxpr, [*map(_constant_value, program.consts)], given[1:])
    if name == "while":
        return _while(eqn, given)

    @cache
    def made() -> Sequence[ArrayLike]:  # what the operation makes, once somebody asks for it
        out = eqn.primitive.bind(*(each() for each in given), **eqn.params)
        return out if eqn.primitive.multiple_results else [out]

    out: list[Value] = [partial(lambda i: made()[i], i) for i in range(len(eqn.outvars))]
    if name == "scan":
        body, consts, carry, length, _ = jaxpr_compat.scan(eqn.params)
        rows: list[Value] = [partial(lambda rows: rows()[0], row) for row in given[consts + carry :]]
        held = [*map(_constant_value, body.consts)]
        return length * (_walk_jaxpr(body.jaxpr, held, [*given[: consts + carry], *rows])[0] if length else 0), out
    return _products(eqn), out


def _while(eqn: Eqn, given: list[Value]) -> tuple[int, list[Value]]:
    cond, body, first, second = jaxpr_compat.while_(eqn.params)
    asked, fixed, state = given[:first], given[first : first + second], given[first + second :]
    held, inside = [*map(_constant_value, cond.consts)], [*map(_constant_value, body.consts)]
    total, goes_on = _walk_jaxpr(cond.jaxpr, held, [*asked, *state])
    while bool(goes_on[0]()):
        each, state = _walk_jaxpr(body.jaxpr, inside, [*fixed, *state])
        more, goes_on = _walk_jaxpr(cond.jaxpr, held, [*asked, *state])
        total += each + more
    return total, state


def _products(eqn: Eqn) -> int:
    """How many products one operation takes."""
    name, out = eqn.primitive.name, eqn.outvars[0].aval
    if not jnp.issubdtype(out.dtype, jnp.floating):
        return 0
    if name == "dot_general":
        return jaxpr_compat.products(eqn)
    if name in CUBIC:
        n = eqn.invars[0].aval.shape[-1]
        return int(n * n * out.shape[-1]) if name == "triangular_solve" else n**3 // 3
    return int(np.prod(out.shape)) if name in ONCE else 0
