"""Checks that read an observer's programs: gains are all the numbers there are, functions are pure, float64 is kept."""

from typing import Any

import jax
import numpy as np

from pcbench.checking import jaxpr_checks
from pcbench.checking.fixtures import Case, Trial, designed
from pcbench.checking.jaxpr_checks import Program, alike, program
from pcbench.checking.observer_functions import Given, asked, given
from pcbench.checking.targets import require
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
    return jaxpr_checks.purity(asked(t, t.cases[0]), _given(t))


def float64(t: Trial) -> str:
    """No number is rounded to fewer bits than it came with."""
    return jaxpr_checks.float64(asked(t, t.cases[0]), _given(t))


def _given(t: Trial) -> Given:
    return given(t, t.cases[0], t.cases[0].problem.gains[t.label])


def _gains(t: Trial, case: Case) -> Gains:
    return designed(t.candidate, case).gains


def _programs(t: Trial, case: Case, gains: Gains) -> dict[str, Program]:
    g = given(t, case, gains)
    return {a.name: program(a, g) for a in asked(t, case)}


def _form(gains: Any) -> str:
    shapes = jax.tree.map(lambda a: f"{np.asarray(a).dtype}{list(np.shape(a))}", gains)
    return str(jax.tree.structure(gains)) + " of " + str(jax.tree.leaves(shapes))
