"""Find the values of a program that differ between lanes, and how they are stored, from its jaxpr without computing anything.

A value is common to all lanes (SAME), or a LaneArray by entries (ENTRIES) or as a table (TABLE). The results of `interpreter`
have these forms; tests check this.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jaxtyping import PyTree

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import CALLS, STRUCTURAL, ClosedJaxpr, Eqn, Literal
from pcbench.engine.lane_array import ENTRIES, SAME, TABLE, form_of, is_lanes
from pcbench.protocols import UNIT_NAME

TABLE_ROWS = 32  # rows from which on a result of `vmap_as_unit` is stored as a table
Forms = Sequence[int]


def trace_lane(f: Callable[..., PyTree], *args: PyTree) -> tuple[ClosedJaxpr, list[int], list[PyTree]]:
    """Return the program of `f` for one lane, the forms of its arguments, and the shapes of its results."""
    flat, tree = jax.tree.flatten(args, is_leaf=is_lanes)
    one = [jax.ShapeDtypeStruct(x.shape, x.dtype) if is_lanes(x) else x for x in flat]
    program, out = jax.make_jaxpr(lambda *a: f(*jax.tree.unflatten(tree, a)), return_shape=True)(*one)
    return program, [form_of(x) for x in flat], out


def forms_of(program: ClosedJaxpr, arg_forms: Forms) -> list[int]:
    """Return the forms of a program's results from the forms of its arguments."""
    jaxpr = program.jaxpr
    forms = dict.fromkeys(jaxpr.constvars, SAME) | dict(zip(jaxpr.invars, arg_forms, strict=True))
    of = lambda v: SAME if isinstance(v, Literal) else forms[v]  # noqa: E731
    for eqn in jaxpr.eqns:
        args = [of(v) for v in eqn.invars]
        result_forms = _forms_of_eqn(eqn, args) if any(args) else [SAME] * len(eqn.outvars)
        forms.update(zip(eqn.outvars, result_forms, strict=True))
    return [of(v) for v in jaxpr.outvars]


def _forms_of_eqn(eqn: Eqn, args: Forms) -> Forms:
    name = eqn.primitive.name
    if name in CALLS:
        forms = forms_of(jaxpr_compat.callee(eqn.params), args)
        if jaxpr_compat.callee_name(eqn.params) != UNIT_NAME:
            return forms
        return [_unit_form(v.aval) if form else SAME for v, form in zip(eqn.outvars, forms, strict=True)]
    if is_one_row(eqn, args):
        return [TABLE if name == "dynamic_update_slice" else ENTRIES]
    if name == "scan" and (scan := jaxpr_compat.scan(eqn.params)).length:
        carry, rows = scan_forms(scan, args)
        return [*carry, *(TABLE if row else SAME for row in rows)]
    if name == "while" and (state := while_forms(jaxpr_compat.while_(eqn.params), args)) is not None:
        return state
    if name == "cond" and not args[0]:
        return cond_forms(jaxpr_compat.branches(eqn.params), args[1:])
    return [SAME if not v.aval.size and name in STRUCTURAL else ENTRIES for v in eqn.outvars]


def _unit_form(aval: Any) -> int:
    """Return the form of a result of a function applied as one unit."""
    if aval.shape and aval.shape[0] >= TABLE_ROWS:
        return TABLE
    return ENTRIES if aval.size else SAME


def is_one_row(eqn: Eqn, args: Forms) -> bool:
    """Return whether an equation reads or writes one whole row at an index common to all lanes."""
    if eqn.primitive.name not in ("dynamic_slice", "dynamic_update_slice"):
        return False
    update = eqn.primitive.name == "dynamic_update_slice"
    shape = eqn.invars[0].aval.shape
    size = eqn.invars[1].aval.shape if update else jaxpr_compat.slice_sizes(eqn.params)
    return size == (1, *shape[1:]) and not any(args[1 + update :])


def scan_forms(scan: jaxpr_compat.Scan, args: Forms) -> tuple[Forms, Forms]:
    """Return the forms of a scan's carries, and of one row of its other results."""
    first, second = scan.consts, scan.consts + scan.carry
    consts, carry, rows = args[:first], by_entries(args[first:second]), by_entries(args[second:])
    body = lambda state: forms_of(scan.body, [*consts, *state, *rows])  # noqa: E731
    state = fixed_point(lambda state: body(state)[: scan.carry], carry)
    return state, body(state)[scan.carry :]


def while_forms(loop: jaxpr_compat.While, args: Forms) -> Forms | None:
    """Return the forms of a while loop's state; None if lanes end it at different times."""
    first, second = loop.cond_consts, loop.cond_consts + loop.body_consts
    cond_consts, body_consts, state = args[:first], args[first:second], by_entries(args[second:])
    state = fixed_point(lambda state: forms_of(loop.body, [*body_consts, *state]), state)
    return None if any(forms_of(loop.cond, [*cond_consts, *state])) else state


def cond_forms(branches: Sequence[ClosedJaxpr], args: Forms) -> Forms:
    """Return the forms of the results of a choice that is common to all lanes, which hold for each of its branches."""
    return list(map(max, zip(*(forms_of(branch, args) for branch in branches), strict=True)))


def by_entries(forms: Forms) -> list[int]:
    """Return the forms with tables replaced by entries."""
    return [min(form, ENTRIES) for form in forms]


def fixed_point(step: Callable[[Forms], Forms], state: Forms) -> list[int]:
    """Return the forms of a state at a fixed point of `step`; a value that differs between lanes, or is a table, stays so."""
    while (wider := [max(pair) for pair in zip(state, step(state), strict=True)]) != list(state):
        state = wider
    return wider
