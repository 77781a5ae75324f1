"""The multiplications of an observer per sample and per tick, counted from its functions for one run, and its memory in bytes.

- Per sample: `snapshot`, `on_sample` if defined, and `jump`. Per tick: `flow` and `estimate`.
- Counted are products of floats: each product of a matrix product (with its addition), and each entry that is multiplied,
  divided, or passed to a root, a power or another function.
- Additions, comparisons and copies are not counted.
- A loop counts as often as it runs for the last sample of a run with a constant period and the assumed delay. Of the branches
  of a choice by index, the one that runs is counted.
- No sample is out of sequence. One that is costs an observer more if it computes newer samples again.
- Integers in an observer's memory (ticks, ring positions) have their values at the end of the run, as loops over a window that
  is not yet full are shorter. Floats have their values at the start, also those that decide how often a loop runs.

Not claimed: computing time, which must be measured.
"""

from collections.abc import Callable, Container, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import ClosedJaxpr, Eqn, Jaxpr
from pcbench.planning.padding import Plan
from pcbench.protocols import Arrival, Gains, Memory, Observer
from pcbench.simulation.types import GridPointParams, present

# one product per entry of the result
PER_ENTRY = {"mul", "div", "rem", "sqrt", "rsqrt", "cbrt", "square", "integer_pow", "pow", "exp", "exp2", "expm1"}
PER_ENTRY |= {"log", "log1p", "logistic", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"}
Value = Callable[[], ArrayLike]  # computed on demand
CUBIC = ("lu", "cholesky", "triangular_solve")  # of n x n: about n^3 / 3 products, or as many as the solution takes


class Cost(NamedTuple):
    """The cost of one observer in one run."""

    sample: int  # multiplications
    tick: int
    memory: int  # bytes of memory between ticks; the snapshot, which travels with the sample, is not included


def costs(p: Plan) -> dict[str, Cost]:
    """Return the cost of every observer of a grid point by label."""
    clocks = p.cell.times.clocks
    age = max((clock.period if clock.delay is None else clock.delay) + clock.mean_extra_delay for clock in clocks)
    period = max(clock.period for clock in clocks)
    return {
        label: counter(p, *observer)(age, period) for label, observer in zip(p.labels, p.layout.observers, strict=True)
    }


def counter(p: Plan, name: str, o: Observer) -> Callable[[int, int], Cost]:
    """Return a function (age of samples, ticks between them) -> Cost of an observer; the observer is traced once."""
    problem: GridPointParams = jax.tree.map(jnp.asarray, p.problem._replace(schedule=()))
    gains, q, ticks = problem.gains[name], len(p.cell.scenario.sampling.delay), p.cell.times.ticks
    ones, start = jnp.ones(q), jax.tree.map(jnp.asarray, jax.jit(o.init)(gains, problem.xhat0))
    memory_at = _memory_at_sample(o, problem, gains, start, q)

    def snapshot(memory: Memory, k: Array) -> PyTree:
        return o.snapshot(gains, memory, present(problem, k, False))

    def sample(gains: Gains, memory: Memory, value: Array, k: Array, age: Array, snapshot: PyTree) -> PyTree:
        now = present(problem, k, False)
        if o.on_sample:
            memory = o.on_sample(gains, memory, now, jnp.ones(q, bool))
        return o.snapshot(gains, memory, now), o.jump(gains, memory, now, _arrival(value, age, snapshot))

    def tick(gains: Gains, memory: Memory, k: Array) -> PyTree:
        return o.flow(gains, memory, present(problem, k, True)), o.estimate(gains, memory)

    k = jnp.asarray(1)
    of_sample = jax.make_jaxpr(sample)(gains, start, ones, k, k, snapshot(start, k))
    of_tick = jax.make_jaxpr(tick)(gains, start, k)
    size = sum(a.size * a.dtype.itemsize for a in jax.tree.leaves(start))
    # of the time t, which is not part of the observer
    time_cost = count_multiplications(lambda k: present(problem, k, True).t, k)

    @cache
    def cost(age: int, period: int) -> Cost:
        last = max((ticks - age) // period, 1)
        memory, k = memory_at(last, age, period), jnp.asarray(age + last * period)
        arrived = ones, k, jnp.asarray(age), snapshot(memory, k - age)
        counts = _count(of_sample, (gains, memory, *arrived)), _count(of_tick, (gains, memory, k))
        return Cost(counts[0] - time_cost, counts[1] - time_cost, size)

    return cost


def _arrival(value: Array, age: Array, snapshot: PyTree) -> Arrival:
    q = len(value)
    return Arrival(value, jnp.ones(q, bool), jnp.full(q, age), jnp.ones(q, int), snapshot, jnp.asarray(1))


def _memory_at_sample(
    o: Observer, p: GridPointParams, gains: Gains, start: Memory, q: int
) -> Callable[[int, int, int], Memory]:
    """Return a function for the initial memory with the integers that it has before sample `last` arrives."""
    leaves, tree = jax.tree.flatten(start)
    is_integer = [not jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    if not any(is_integer):
        return lambda last, age, period: jax.tree.unflatten(tree, leaves)

    def unflatten(ticks: Sequence[Array]) -> Memory:
        new = iter(ticks)
        return jax.tree.unflatten(tree, [next(new) if flag else a for flag, a in zip(is_integer, leaves, strict=True)])

    def after(age: Array, period: Array, number: Array, ticks: Sequence[Array]) -> list[Array]:
        memory, now = unflatten(ticks), present(p, age + number * period, False)
        snapshot = o.snapshot(gains, memory, present(p, number * period, False))
        if o.on_sample:
            memory = o.on_sample(gains, memory, now, jnp.ones(q, bool))
        new = jax.tree.leaves(o.jump(gains, memory, now, _arrival(jnp.ones(q), age, snapshot)))
        return [a.astype(b.dtype) for a, b, flag in zip(new, leaves, is_integer, strict=True) if flag]

    @jax.jit
    def until(last: Array, age: Array, period: Array) -> list[Array]:
        before = [a for a, flag in zip(leaves, is_integer, strict=True) if flag]
        return lax.fori_loop(0, last, partial(after, age, period), before)

    return lambda last, age, period: unflatten(until(last, age, period))


def count_multiplications(f: Callable[..., PyTree], *args: PyTree) -> int:
    """Return the multiplications of a function at these arguments."""
    return _count(jax.make_jaxpr(f)(*args), args)


def _count(closed_jaxpr: ClosedJaxpr, args: PyTree) -> int:
    consts, inputs = ([*map(_constant_value, v)] for v in (closed_jaxpr.consts, jax.tree.leaves(args)))
    return _walk_jaxpr(closed_jaxpr.jaxpr, consts, inputs)[0]


def _constant_value(value: ArrayLike) -> Value:
    return lambda: value


def _walk_jaxpr(
    jaxpr: Jaxpr, consts: Sequence[Value], args: Sequence[Value], only: Container[int] | None = None
) -> tuple[int, list[Value]]:
    """Return a program's multiplications and its outputs; only values that a loop or a choice depends on are computed.

    With `only`, the other equations are skipped and their results must not be read.
    """
    env: dict[Any, Value] = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))
    placeholder = _constant_value(np.nan)

    def read(v: Any) -> Value:
        return _constant_value(v.val) if _literal(v) else env.get(v, placeholder)

    total = 0
    for i, eqn in enumerate(jaxpr.eqns):
        if only is not None and i not in only:
            continue
        count, out = _step(eqn, [*map(read, eqn.invars)])
        total += count
        env.update(zip(eqn.outvars, out, strict=True))
    return total, [*map(read, jaxpr.outvars)]


def _step(eqn: Eqn, inputs: list[Value]) -> tuple[int, list[Value]]:
    name = eqn.primitive.name
    if name in jaxpr_compat.CALLS:
        program = jaxpr_compat.callee(eqn.params)
        return _walk_jaxpr(program.jaxpr, [*map(_constant_value, program.consts)], inputs)
    if name == "cond":
        program = jaxpr_compat.branches(eqn.params)[int(np.asarray(inputs[0]()))]
        return _walk_jaxpr(program.jaxpr, [*map(_constant_value, program.consts)], inputs[1:])
    if name == "while":
        return _while(eqn, inputs)

    @cache
    def results() -> Sequence[ArrayLike]:  # the operation's results, computed on demand
        out = eqn.primitive.bind(*(v() for v in inputs), **eqn.params)
        return out if eqn.primitive.multiple_results else [out]

    out: list[Value] = [partial(lambda i: results()[i], i) for i in range(len(eqn.outvars))]
    if name == "scan":
        body, n_consts, n_carry, length, _ = jaxpr_compat.scan(eqn.params)
        n = n_consts + n_carry
        rows: list[Value] = [partial(lambda xs: xs()[0], xs) for xs in inputs[n:]]
        body_consts = [*map(_constant_value, body.consts)]
        body_cost = _walk_jaxpr(body.jaxpr, body_consts, [*inputs[:n], *rows])[0] if length else 0
        return length * body_cost, out
    return _products(eqn), out


def _while(eqn: Eqn, inputs: list[Value]) -> tuple[int, list[Value]]:
    """Return a loop's multiplications and outputs.

    If all rounds cost the same, one round is counted. Only the values that decide the number of rounds are then computed.
    """
    cond, body, cond_nconsts, body_nconsts = jaxpr_compat.while_(eqn.params)
    n_consts = cond_nconsts + body_nconsts
    cond_args, body_args, start = inputs[:cond_nconsts], inputs[cond_nconsts:n_consts], inputs[n_consts:]
    cond_consts, body_consts = [*map(_constant_value, cond.consts)], [*map(_constant_value, body.consts)]

    def rounds(only: set[int] | None, entries: set[int]) -> tuple[int, list[Value]]:
        state = start
        total, goes_on = _walk_jaxpr(cond.jaxpr, cond_consts, [*cond_args, *state])
        while bool(goes_on[0]()):
            round_cost, new_state = _walk_jaxpr(body.jaxpr, body_consts, [*body_args, *state], only)
            state = [new if i in entries else old for i, (new, old) in enumerate(zip(new_state, state, strict=True))]
            cond_cost, goes_on = _walk_jaxpr(cond.jaxpr, cond_consts, [*cond_args, *state])
            total += (round_cost if only is None else body_cost) + cond_cost
        return total, state

    all_entries = set(range(len(start)))
    if _chooses(cond.jaxpr) or _chooses(body.jaxpr):
        return rounds(None, all_entries)
    body_cost = _walk_jaxpr(body.jaxpr, body_consts, [*body_args, *start])[0]
    entries, only = _condition_inputs(cond.jaxpr, body.jaxpr, cond_nconsts, body_nconsts)
    total, state = rounds(only, entries)
    full_state = cache(lambda: rounds(None, all_entries)[1])
    return total, [state[i] if i in entries else partial(lambda i: full_state()[i](), i) for i in range(len(start))]


def _chooses(jaxpr: Jaxpr) -> bool:
    """Return whether the cost of a program depends on the values of its inputs."""
    for eqn in jaxpr.eqns:
        name = eqn.primitive.name
        inner = jaxpr_compat.callee(eqn.params) if name in jaxpr_compat.CALLS else None
        inner = jaxpr_compat.scan(eqn.params).body if name == "scan" else inner
        if name in ("cond", "while") or (inner and _chooses(inner.jaxpr)):
            return True
    return False


def _condition_inputs(cond: Jaxpr, body: Jaxpr, cond_nconsts: int, body_nconsts: int) -> tuple[set[int], set[int]]:
    """Return the entries of a loop's state that its condition depends on, and the equations of its body that compute them."""

    def dependencies(jaxpr: Jaxpr, entries: set[int]) -> tuple[set[int], set[Any]]:
        equations, variables = set[int](), {v for i in entries if not _literal(v := jaxpr.outvars[i])}
        for i, eqn in reversed([*enumerate(jaxpr.eqns)]):
            if variables & {*eqn.outvars}:
                equations.add(i)
                variables |= {v for v in eqn.invars if not _literal(v)}
        return equations, variables

    def state(jaxpr: Jaxpr, n_consts: int, variables: set[Any]) -> set[int]:
        return {i for i, v in enumerate(jaxpr.invars[n_consts:]) if v in variables}

    new, entries, equations = state(cond, cond_nconsts, dependencies(cond, {0})[1]), set[int](), set[int]()
    while new - entries:
        entries |= new
        equations, variables = dependencies(body, entries)
        new = state(body, body_nconsts, variables)
    return entries, equations


def _literal(v: Any) -> bool:
    return isinstance(v, jaxpr_compat.Literal)


def _products(eqn: Eqn) -> int:
    """Return the number of products of one operation."""
    name, out = eqn.primitive.name, eqn.outvars[0].aval
    if not jnp.issubdtype(out.dtype, jnp.floating):
        return 0
    if name == "dot_general":
        return jaxpr_compat.product_count(eqn)
    if name in CUBIC:
        n = eqn.invars[0].aval.shape[-1]
        return int(n * n * out.shape[-1]) if name == "triangular_solve" else n**3 // 3
    return int(np.prod(out.shape)) if name in PER_ENTRY else 0
