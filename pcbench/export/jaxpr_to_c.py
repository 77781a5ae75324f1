"""Translation of a jax program to C, equation by equation; loops stay loops.

Equations that only move numbers are evaluated here and produce no code. The compiler removes unused results. The state
of a loop is in arrays of its own, which are assigned at the end of each iteration.
"""

from collections.abc import Callable, Sequence

import numpy as np

from pcbench.dynamics.room import ROOM
from pcbench.engine import batching_rules, jaxpr_compat
from pcbench.engine.jaxpr_compat import ClosedJaxpr, Eqn, Jaxpr
from pcbench.errors import UserError
from pcbench.export import arithmetic, places
from pcbench.export.terms import Entries, Term, Writer, array_entries, as_c, is_known, kind_of, number_entries, scalar

Rule = Callable[[Writer, Eqn, list[Entries]], Entries]
MOVES = jaxpr_compat.STRUCTURAL | {"split", "stack", "tile"}
RULES: dict[str, Rule] = dict.fromkeys(jaxpr_compat.FOLDS, arithmetic.fold) | {
    "dot_general": arithmetic.product,
    "cumsum": arithmetic.running_sum,
    "argmax": arithmetic.extreme,
    "argmin": arithmetic.extreme,
    "dynamic_slice": places.dynamic_slice,
    "dynamic_update_slice": places.dynamic_update_slice,
    "gather": places.gather,
    "scatter": places.scatter,
    "scatter-add": places.scatter,
    "scatter_add": places.scatter,
}
LONGEST = 60_000  # lines of a function


class UnsupportedPrimitive(UserError):
    """A primitive that this translation does not support."""


def write(w: Writer, program: ClosedJaxpr, args: list[Entries]) -> list[Entries]:
    """Write a program for some input entries and return its outputs; raise UnsupportedPrimitive with its name."""
    return _walk(w, program.jaxpr, [number_entries(c) for c in program.consts], args)


def assign(w: Writer, targets: list[tuple[str, Entries, Entries]]) -> None:
    """Write assignments of new values (kind, place, value), as if all happened at once.

    No old value is read after it is overwritten.
    """
    assignments = []
    for kind, old, new in targets:
        for a, b in zip(old.flat, new.flat, strict=True):
            if a is b or (isinstance(b, Term) and a.text == b.text):
                continue
            may_change = isinstance(b, Term) and b.text[0] != "t"  # what may be written over
            assignments.append((a.text, w.let(kind, b.text).text if may_change else as_c(b)))
    for place, text in assignments:
        w.say(f"{place} = {text};")


def _walk(w: Writer, jaxpr: Jaxpr, consts: list[Entries], args: list[Entries]) -> list[Entries]:
    env = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))

    def read(v: jaxpr_compat.Atom) -> Entries:
        return number_entries(np.asarray(v.val)) if isinstance(v, jaxpr_compat.Literal) else env[v]

    for eqn in jaxpr.eqns:
        try:
            outputs = _step(w, eqn, [*map(read, eqn.invars)])
        except (KeyError, AttributeError) as error:  # a parameter, or a type of number, that this file does not read
            raise UnsupportedPrimitive(f"{eqn.primitive.name} in a form that is not read here ({error})") from error
        env.update(zip(eqn.outvars, outputs, strict=True))
    return [*map(read, jaxpr.outvars)]


def _step(w: Writer, eqn: Eqn, args: list[Entries]) -> list[Entries]:
    name = eqn.primitive.name
    if len(w.lines) > LONGEST:
        raise UnsupportedPrimitive(f"{name}: got more than {LONGEST:,} lines of C in one function, expected fewer.")
    if name in jaxpr_compat.CALLS and jaxpr_compat.callee_name(eqn.params) == ROOM:
        w.check(args[1])
        return [np.broadcast_to(args[0], eqn.outvars[0].aval.shape)]
    if name in jaxpr_compat.CALLS:
        return write(w, jaxpr_compat.callee(eqn.params), args)
    if name in ("scan", "while", "cond"):
        return {"scan": _scan, "while": _while, "cond": _cond}[name](w, eqn, args)
    if name == "iota":
        return [number_entries(np.asarray(eqn.primitive.bind(**eqn.params)))]
    if name == "platform_index":
        return [
            scalar(np.int32(next(i for i, p in enumerate(jaxpr_compat.param(eqn, "platforms")) if not p or "cpu" in p)))
        ]
    if name in MOVES:
        return _move_entries(eqn, args)
    if name in arithmetic.ELEMENTWISE:
        return [arithmetic.elementwise(w, eqn, args)]
    if name in RULES:
        return [RULES[name](w, eqn, args)]
    if (expansion := jaxpr_compat.expansion(eqn)) is not None:
        return write(w, expansion, args)
    raise UnsupportedPrimitive(name)


def _move_entries(eqn: Eqn, args: list[Entries]) -> list[Entries]:
    """Return the entries after a primitive that only moves numbers."""
    flat = np.concatenate([a.ravel() for a in args])
    indices = batching_rules.source_indices(
        eqn.primitive, jaxpr_compat.parameter_items(eqn), tuple(a.shape for a in args)
    )
    return [flat[i.ravel()].reshape(i.shape) if i.size else np.empty(i.shape, object) for i in indices]


def _kinds(vs: Sequence[jaxpr_compat.Atom]) -> list[str]:
    return [kind_of(v.aval.dtype) for v in vs]


def _state(w: Writer, vs: Sequence[jaxpr_compat.Atom], values: list[Entries], stays: list[bool]) -> list[Entries]:
    """Return C arrays for a loop's state; entries that the loop does not change need none."""
    out = []
    for kind, value, is_constant in zip(_kinds(vs), values, stays, strict=True):
        if is_constant or not value.size:
            out.append(value)
            continue
        room = w.room(kind, value.shape)
        for a, b in zip(room.flat, value.flat, strict=True):
            w.say(f"{a.text} = {as_c(b)};")
        out.append(room)
    return out


def _while(w: Writer, eqn: Eqn, args: list[Entries]) -> list[Entries]:
    cond, body, first, second = jaxpr_compat.while_(eqn.params)
    cond_consts, body_consts, values = args[:first], args[first : first + second], args[first + second :]
    state_vars = body.jaxpr.invars[second:]
    is_constant = [a is b for a, b in zip(state_vars, body.jaxpr.outvars, strict=True)]
    state = _state(w, state_vars, values, is_constant)
    with w.block("for (;;)"):
        (condition,) = write(w, cond, [*cond_consts, *state])
        w.say(f"if (!{as_c(condition[()])}) break;")
        checks = w.checks
        new = write(w, body, [*body_consts, *state])
        if w.checks > checks:
            w.say("if (outside) break;")
        updates = zip(zip(_kinds(state_vars), state, new, strict=True), is_constant, strict=True)
        assign(w, [update for update, constant in updates if not constant])
    return state


def _scan(w: Writer, eqn: Eqn, args: list[Entries]) -> list[Entries]:
    body, consts, carry, length, params = jaxpr_compat.scan(eqn.params)
    state_vars, rows = body.jaxpr.invars[consts : consts + carry], args[consts + carry :]
    if length == 1:
        out = write(w, body, [*args[: consts + carry], *(r.reshape(r.shape[1:]) for r in rows)])
        return [*out[:carry], *(r[None] for r in out[carry:])]
    is_constant = [a is b for a, b in zip(state_vars, body.jaxpr.outvars[:carry], strict=True)]
    state = _state(w, state_vars, args[consts : consts + carry], is_constant)
    ys = [w.room(kind_of(v.aval.dtype), (length, *v.aval.shape)) for v in body.jaxpr.outvars[carry:]]
    if not length:
        return [*state, *ys]
    tables = [
        places.as_c_array(w, kind_of(v.aval.dtype), r) if r.size else None
        for v, r in zip(body.jaxpr.invars[consts + carry :], rows, strict=True)
    ]
    i, n = w.name("i"), w.name("i")
    with w.block(f"for (int64_t {i} = 0; {i} < {length}; {i}++)"):
        w.say(f"const int64_t {n} = {f'{length - 1} - {i}' if params['reverse'] else i};")
        xs = [_row(n, t, r) for t, r in zip(tables, rows, strict=True)]
        out = write(w, body, [*args[:consts], *state, *xs])
        kinds = _kinds(body.jaxpr.outvars[carry:])
        y_updates = [
            (kind, array_entries(a.flat[0].store, b.shape, f"{n} * {b.size}"), b)
            for kind, a, b in zip(kinds, ys, out[carry:], strict=True)
            if b.size
        ]
        carry_updates = zip(zip(_kinds(state_vars), state, out[:carry], strict=True), is_constant, strict=True)
        assign(w, [*y_updates, *(update for update, constant in carry_updates if not constant)])
    return [*state, *ys]


def _row(n: str, table: Term | None, rows: Entries) -> Entries:
    """Return one row of the arrays over which a loop iterates."""
    if table is None:
        return np.empty(rows.shape[1:], object)
    size = int(np.prod(rows.shape[1:]))
    base = f"{table.base} + {n} * {size}" if table.base else f"{n} * {size}"
    return array_entries(table.store, rows.shape[1:], base, table.place)


def _cond(w: Writer, eqn: Eqn, args: list[Entries]) -> list[Entries]:
    programs, index = jaxpr_compat.branches(eqn.params), args[0]
    if is_known(index):
        return write(w, programs[int(np.clip(int(index[()]), 0, len(programs) - 1))], args[1:])
    results = [w.room(kind_of(v.aval.dtype), v.aval.shape) for v in eqn.outvars]
    for i, program in enumerate(programs):
        last = i == len(programs) - 1
        condition = f"if ({as_c(index[()])} {'<=' if not i else '=='} {i})"
        with w.block("else" if last else condition if not i else f"else {condition}"):
            assign(w, [*zip(_kinds(eqn.outvars), results, write(w, program, args[1:]), strict=True)])
    return results
