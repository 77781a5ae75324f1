"""Two solvers for every matrix inequality, and what decides between them: a certificate, not what a solver says of itself.

Clarabel, an interior-point method, is asked first. Where it has no answer, or one that fails its re-check by eigenvalues, SCS
is asked, a first-order method that shares no code with it. Both answers are judged the same way: what a solver calls
inaccurate may prove a gain, and what it calls optimal may not.

Remember what a solver found, so that the second run of a study need not import it.

Only raw answers are kept, under the hash of the problem's bits, of the text that states it and of the solvers' versions;
every certificate is re-checked on what is read back, so a damaged or foreign entry can cost time but cannot enter a table.
"""

import hashlib
import inspect
import json
import sys
import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError, first_sentence
from pcbench.runtime.cache import folder, keep
from pcbench.synthesis.certificate import Certificate, require_certified

if TYPE_CHECKING:
    import cvxpy as cp

SOLVERS = ("CLARABEL", "SCS")
SETTINGS = {
    "CLARABEL": dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10)
    | dict.fromkeys(("reduced_tol_gap_abs", "reduced_tol_gap_rel", "reduced_tol_feas"), 1e-6),
    "SCS": {"eps_abs": 1e-8, "eps_rel": 1e-8, "max_iters": 200_000},
}
F = TypeVar("F")  # an answer
ANSWERED = ("optimal", "optimal_inaccurate")


class Impossible(DesignError):
    """There is no such gain: a solver has proven it, so another need not be asked."""


def minimise(
    objective: "cp.Expression",
    rules: "list[cp.Constraint]",
    unknowns: "tuple[cp.Variable, ...]",
    where: str,
    solver: str,
    advice: str,
) -> tuple[str, list[Matrix]]:
    """Solve a problem of cvxpy to the last digits a solver gives; return its status and the unknowns' values.

    Raises DesignError with the status and the `advice` where there are none, Impossible where the solver proves that.
    """
    import cvxpy as cp

    problem = cp.Problem(cp.Minimize(objective), rules)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that an answer is inaccurate; the status says it too
            problem.solve(solver=solver, **SETTINGS.get(solver, {}))
        status = str(problem.status)
    except (cp.SolverError, ValueError, ArithmeticError) as error:  # a solver's own errors, by its name or not
        status = str(error)
    if status not in ANSWERED:
        kind = Impossible if status == "infeasible" else DesignError
        raise kind(
            f"{where}: the LMI was not solved ({solver} said '{first_sentence(status)}'), expected a solution; {advice}."
        )
    return status, [np.asarray(unknown.value, dtype=np.float64) for unknown in unknowns]


def proven(
    solve: Callable[[str], F],
    certify: Callable[[F], Certificate],
    where: str,
    least: float = 0.0,
    hopeless: Callable[[F], bool] = lambda found: False,
    among: tuple[str, ...] = SOLVERS,
) -> tuple[F, Certificate]:
    """Return the first solver's answer whose certificate's margin is above `least`, and the certificate.

    `solve` takes a solver's name. If `hopeless(answer)`, the answer itself shows that no gain does better: no other is asked.
    Raises DesignError with the largest margin where no answer stands, or with the last status where there is none.
    """
    tried: list[str] = []
    answers: list[tuple[F, Certificate]] = []
    failure: DesignError | None = None
    for solver in among:
        try:
            found = solve(solver)
        except Impossible:
            raise
        except DesignError as error:
            failure = error
            tried.append(f"{solver} had no answer")
            continue
        certificate = certify(found)._replace(fallback=", ".join(tried))
        answers.append((found, certificate))
        if certificate.margin > least or hopeless(found):
            break
        tried.append(f"{solver}'s ('{certificate.status}') had margin {certificate.margin:.3g}")
    if not answers and failure:
        raise failure
    best = max(answers, key=lambda each: -np.inf if np.isnan(each[1].margin) else each[1].margin)
    return best[0], require_certified(best[1], where, least)


def solve_or_load(kind: Callable[..., F], name: str, problem: tuple[np.ndarray, ...], solve: Callable[[], F]) -> F:
    """Return `kind` (a NamedTuple of arrays, numbers and strings) from the cache, or solve and remember it."""
    bits = b"".join(np.ascontiguousarray(a, float).tobytes() + str(np.shape(a)).encode() for a in problem)
    said = f"{name} {_solvers()}".encode()
    key = hashlib.sha256(bits + said + _source(kind.__module__) + _source(__name__)).hexdigest()[:32]
    path = folder("gains") / f"{name}-{key}.json"
    try:
        stored = json.loads(path.read_text())
        return kind(**{k: np.array(v) if isinstance(v, list) else v for k, v in stored.items()})
    except (OSError, ValueError, TypeError, AttributeError):
        found = solve()
        keep(path, _to_json(found))
        return found


@cache
def _solvers() -> str:
    """The versions of the solvers: looked up once, as each takes milliseconds."""
    return f"{version('cvxpy')} {version('clarabel')} {version('scs')}"


@cache
def _source(module: str) -> bytes:
    """The text of the module that states a problem: another statement may have another answer."""
    found = inspect.getsourcefile(sys.modules[module])
    return Path(found).read_bytes() if found else b""


def _to_json(found: Any) -> str:
    return json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found._asdict().items()})
