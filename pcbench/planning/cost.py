"""What an observer costs: multiplications of a sample and of a tick, counted from its own functions at one lane, and bytes.

A sample costs `note`, `sampled` where there is one, and `jump`; a tick `flow` and `estimate`. Counted are the products of
floats: each of a matrix product (with its addition), each entry multiplied, divided, or put through a root, a power or another
function. Additions, comparisons and what is only moved are free. A loop counts as often as it goes round, for a sample of the
believed age that follows one of a period before; of the branches of a choice that one runs, where it is made by an index.
Not claimed: time. What a processor does with so many products is for a clock to say.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.planning.padding import Plan
from pcbench.protocols import Arrival
from pcbench.simulation.lanes import primitives, rules
from pcbench.simulation.problem import present

ONCE = {
    "mul",
    "div",
    "sqrt",
    "rsqrt",
    "cbrt",
    "square",
    "integer_pow",
    "pow",
    "exp",
    "exp2",
    "expm1",
    "log",
    "log1p",
    "logistic",
}
ONCE |= {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "rem"}
CUBIC = ("lu", "cholesky", "triangular_solve")  # of n x n: about n^3 / 3 products, or as many as it solves


class Cost(NamedTuple):
    """What one lane of an observer costs."""

    sample: int  # multiplications
    tick: int
    memory: int  # bytes between ticks; what it notes travels with the sample


def costs(p: Plan) -> dict[str, Cost]:
    """Return the cost of every observer of a cell by label."""
    return {label: _of(p, name, o) for label, (name, o) in zip(p.labels, p.layout.observers, strict=True)}


def _of(p: Plan, name: str, o: Any) -> Cost:
    problem: Any = jax.tree.map(jnp.asarray, p.problem._replace(schedule=()))
    gains, q = problem.gains[name], len(p.cell.scenario.sampling.delay)
    clocks = p.cell.times.clocks
    age = max((clock.period if clock.delay is None else clock.delay) + clock.spread // 2 for clock in clocks)
    k = age + max(clock.period for clock in clocks)
    memory = o.init(gains, problem.xhat0)
    note = o.note(gains, memory, present(problem, jnp.asarray(k - age), False))
    decided, open_ = (present(problem, jnp.asarray(k), known) for known in (True, False))

    def sample(gains: Any, memory: Any, value: Any) -> Any:
        told = o.sampled(gains, memory, open_, jnp.ones(q, bool)) if o.sampled else memory
        ticks = jnp.full(q, age)
        arrival = Arrival(value, jnp.ones(q, bool), ticks, jnp.ones(q, int), note, jnp.asarray(1))
        return o.note(gains, told, open_), o.jump(gains, told, open_, arrival)

    def tick(gains: Any, memory: Any) -> Any:
        return o.flow(gains, memory, decided), o.estimate(gains, memory)

    size = sum(np.size(leaf) * np.asarray(leaf).dtype.itemsize for leaf in jax.tree.leaves(memory))
    return Cost(counted(sample, gains, memory, jnp.ones(q)), counted(tick, gains, memory), size)


def counted(f: Any, *args: Any) -> int:
    """Return the multiplications of a function at these arguments."""
    closed = jax.make_jaxpr(f)(*args)
    return _walked(closed.jaxpr, closed.consts, jax.tree.leaves(args))[0]


def _walked(jaxpr: Any, consts: Any, args: Any) -> tuple[int, list[Any]]:
    """Count a program's multiplications while it is computed, for loops depend on what is."""
    env = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))
    total = 0
    for eqn in jaxpr.eqns:
        given = [v.val if isinstance(v, primitives.Literal) else env[v] for v in eqn.invars]
        many, out = _step(eqn, given)
        total += many
        env.update(zip(eqn.outvars, out, strict=True))
    return total, [v.val if isinstance(v, primitives.Literal) else env[v] for v in jaxpr.outvars]


def _step(eqn: Any, given: list[Any]) -> tuple[int, list[Any]]:
    name = eqn.primitive.name
    if name in primitives.CALLS:
        program = primitives.called(eqn.params)
        return _walked(program.jaxpr, program.consts, given)
    if name == "cond":
        program = primitives.branches(eqn.params)[int(given[0])]
        return _walked(program.jaxpr, program.consts, given[1:])
    if name == "while":
        return _while(eqn, given)
    out = eqn.primitive.bind(*given, **eqn.params)
    out = list(out) if eqn.primitive.multiple_results else [out]
    if name == "scan":
        body, consts, carry, length, _ = primitives.scan(eqn.params)
        rows = [row[0] for row in given[consts + carry :]] if length else []
        return length * (_walked(body.jaxpr, body.consts, [*given[: consts + carry], *rows])[0] if length else 0), out
    return _products(eqn), out


def _while(eqn: Any, given: list[Any]) -> tuple[int, list[Any]]:
    cond, body, first, second = primitives.while_(eqn.params)
    asked, fixed, state = given[:first], given[first : first + second], given[first + second :]
    total, goes_on = _walked(cond.jaxpr, cond.consts, [*asked, *state])
    each = 0
    while bool(goes_on[0]):
        if not each:  # every round is the same program
            each = _walked(body.jaxpr, body.consts, [*fixed, *state])[0]
        state = primitives.jaxpr_as_fun(body)(*fixed, *state)
        more, goes_on = _walked(cond.jaxpr, cond.consts, [*asked, *state])
        total += each + more
    return total, state


def _products(eqn: Any) -> int:
    """How many products one operation takes."""
    name, out = eqn.primitive.name, eqn.outvars[0].aval
    if not jnp.issubdtype(out.dtype, jnp.floating):
        return 0
    if name == "dot_general":
        return rules.products(eqn)
    if name in CUBIC:
        n = eqn.invars[0].aval.shape[-1]
        return int(n * n * out.shape[-1]) if name == "triangular_solve" else n**3 // 3
    return int(np.prod(out.shape)) if name in ONCE else 0
