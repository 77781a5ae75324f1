"""Checks that read the traced programs: gains are all the numbers there are, functions are pure, float64 is kept."""

from typing import Any

import jax
import numpy as np

from pcbench.checking.finding import require
from pcbench.checking.tracing import Asked, Given, Program, alike, asked, given, inside, program
from pcbench.checking.trial import Case, Trial, designed
from pcbench.errors import UserError
from pcbench.protocols import Gains

ALLOWED = (-1.0, 0.0, 0.5, 1.0, 2.0)  # of arrays that pick or sign entries, or are a Runge-Kutta step's: no design's


def gains(t: Trial) -> str:
    """Gains are arrays; another design fits the same program, and changes no number in it."""
    case = t.cases[0]
    first = _gains(t, case)
    programs = _programs(t, case, first)
    for name, each in programs.items():
        captured = [a for a in each.numbers if a.ndim and a.dtype.kind == "f" and not np.isin(a, ALLOWED).all()]
        require(
            not captured,
            f"gains: got an array of shape {list(np.shape(captured[0])) if captured else []} written into {name}, expected "
            "every number among the gains; return it from design and take it from there.",
        )
    other = t.cases[-1]
    known = other.setting._replace(noise_std=tuple(2 * s or 1.0 for s in case.setting.noise_std))
    second = _gains(t, other._replace(setting=known))
    require(
        _form(first) == _form(second),
        f"gains: got {_form(second)} from another delay and noise, expected the form {_form(first)} of the first design; keep "
        "structure, shapes and types, and every number in an array, or each cell of a study compiles anew.",
    )
    for name, each in _programs(t, case, second).items():
        require(
            alike(each, programs[name]),
            f"gains: got other numbers in the program of {name} after another design, expected the gains alone to change; take "
            "from gains what design finds, not from a global or a closure.",
        )
    return "all numbers are gains; another design needs no other program"


def purity(t: Trial) -> str:
    """The same input gives the same output; nothing is kept outside, no argument is changed."""
    case = t.cases[0]
    g = given(t, case, case.problem.gains[t.label])
    for a in asked(t, case):
        require(
            alike(_leakless(a, g), _leakless(a, g)),
            f"purity: got two programs when {a.name} was traced twice, expected one; take out counters and random numbers of "
            "Python.",
        )
        require(
            not _changed(a, g),
            f"purity: got arguments that {a.name} has changed, expected them as they were; return a new memory "
            "(memory._replace, or {**memory, ...}).",
        )
    return "same input, same output; nothing kept outside, no argument changed"


def float64(t: Trial) -> str:
    """No number is rounded to fewer bits than it came with."""
    case = t.cases[0]
    g = given(t, case, case.problem.gains[t.label])
    for a in asked(t, case):
        for eqn in (eqn for inner in inside(program(a, g).jaxpr) for eqn in inner.eqns):
            narrow = [v.aval.dtype for v in eqn.outvars if str(getattr(v.aval, "dtype", "")) in NARROW]
            require(
                not narrow,
                f"float64: got {narrow[0] if narrow else ''} in {a.name} ({eqn.primitive.name}), expected float64 throughout; "
                "leave out dtypes, or write float.",
            )
    return "float64 in, float64 throughout"


NARROW = ("float32", "float16", "bfloat16", "complex64")


def _leakless(a: Asked, g: Given) -> Program:
    """Trace a function; raise UserError where it keeps what it was traced with."""
    try:
        with jax.checking_leaks():
            return program(a, g)
    except Exception as error:
        if "eak" not in str(error):
            raise
        raise UserError(
            f"purity: got a traced value that {a.name} leaves behind outside itself, expected none; return what is to be kept "
            "as memory."
        ) from None


def _changed(a: Asked, g: Given) -> bool:
    """Whether a function changes its arguments while it is traced."""
    found: list[bool] = []

    def traced(g: Given) -> Any:
        before, form = jax.tree.flatten(g)
        out = a.f(g)
        after, same = jax.tree.flatten(g)
        found.append(str(form) != str(same) or any(x is not y for x, y in zip(before, after, strict=True)))
        return out

    jax.eval_shape(traced, g)
    return found[0]


def _gains(t: Trial, case: Case) -> Gains:
    return designed(t.candidate, case).gains


def _programs(t: Trial, case: Case, gains: Gains) -> dict[str, Program]:
    g = given(t, case, gains)
    return {a.name: program(a, g) for a in asked(t, case)}


def _form(gains: Any) -> str:
    shapes = jax.tree.map(lambda a: f"{np.asarray(a).dtype}{list(np.shape(a))}", gains)
    return str(jax.tree.structure(gains)) + " of " + str(jax.tree.leaves(shapes))
