"""Solution of matrix inequalities by two solvers; a certificate accepts the answer, not the status that a solver reports.

Clarabel, an interior-point method, is tried first. If it has no answer, or one whose certificate fails the check by
eigenvalues, SCS is tried, a first-order method with no common code. A certificate may accept an answer that the solver calls
inaccurate, and reject one that it calls optimal.

Raw answers are cached on disk, so that the second run of a study need not import a solver. The key is a hash of the problem's
bits, of the source text that states it, and of the solvers' versions. Certificates are always checked again on cached
answers, so a damaged entry can cost time but cannot change a table.
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
Solution = TypeVar("Solution")  # an answer
SOLVED = ("optimal", "optimal_inaccurate")


class Impossible(DesignError):
    """No such gain exists, as a solver has proven; no other solver is tried."""


def minimise(
    objective: "cp.Expression",
    constraints: "list[cp.Constraint]",
    unknowns: "tuple[cp.Variable, ...]",
    where: str,
    solver: str,
    advice: str,
) -> tuple[str, list[Matrix]]:
    """Solve a problem of cvxpy to the highest accuracy of the solver; return its status and the values of the unknowns.

    Raises DesignError with the status and the `advice` without a solution, and Impossible if the solver proves that none
    exists.
    """
    import cvxpy as cp

    problem = cp.Problem(cp.Minimize(objective), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # inaccurate answers; the status reports them too
            problem.solve(solver=solver, **SETTINGS.get(solver, {}))
        status = str(problem.status)
    except (cp.SolverError, ValueError, ArithmeticError) as error:  # also errors of a solver that are no SolverError
        status = str(error)
    if status not in SOLVED:
        error_type = Impossible if status == "infeasible" else DesignError
        raise error_type(
            f"{where}: the LMI was not solved ({solver} said '{first_sentence(status)}'), expected a solution; {advice}."
        )
    return status, [np.asarray(unknown.value, dtype=np.float64) for unknown in unknowns]


def solve_certified(
    solve: Callable[[str], Solution],
    certify: Callable[[Solution], Certificate],
    where: str,
    least: float = 0.0,
    hopeless: Callable[[Solution], bool] = lambda solution: False,
    solver_names: tuple[str, ...] = SOLVERS,
) -> tuple[Solution, Certificate]:
    """Return the first solver's solution whose certificate has a margin above `least`, and the certificate.

    `solve` takes a solver's name. If `hopeless(solution)`, the solution itself shows that no gain is better, and no other
    solver is tried.
    Raises DesignError with the largest margin if no solution is certified, or with the last status if there is none.
    """
    attempts: list[str] = []
    candidates: list[tuple[Solution, Certificate]] = []
    failure: DesignError | None = None
    for solver in solver_names:
        try:
            solution = solve(solver)
        except Impossible:
            raise
        except DesignError as error:
            failure = error
            attempts.append(f"{solver} had no answer")
            continue
        certificate = certify(solution)._replace(fallback=", ".join(attempts))
        candidates.append((solution, certificate))
        if certificate.margin > least or hopeless(solution):
            break
        attempts.append(f"{solver}'s ('{certificate.status}') had margin {certificate.margin:.3g}")
    if not candidates and failure:
        raise failure
    best = max(candidates, key=lambda candidate: -np.inf if np.isnan(candidate[1].margin) else candidate[1].margin)
    return best[0], require_certified(best[1], where, least)


def solve_or_load(
    solution_type: Callable[..., Solution],
    problem_name: str,
    problem: tuple[np.ndarray, ...],
    solve: Callable[[str], Solution],
    solver: str,
) -> Solution:
    """Return an answer, a `solution_type` (a NamedTuple of arrays, numbers, strings), from the cache, or solve and store it."""
    name = f"{problem_name}-{solver.lower()}"
    bits = b"".join(np.ascontiguousarray(a, float).tobytes() + str(np.shape(a)).encode() for a in problem)
    label = f"{name} {_solvers()}".encode()
    key = hashlib.sha256(bits + label + _source(solution_type.__module__) + _source(__name__)).hexdigest()[:32]
    path = folder("gains") / f"{name}-{key}.json"
    try:
        fields = json.loads(path.read_text())
        return solution_type(**{k: np.array(v) if isinstance(v, list) else v for k, v in fields.items()})
    except (OSError, ValueError, TypeError, AttributeError):
        solution = solve(solver)
        keep(path, _to_json(solution))
        return solution


@cache
def _solvers() -> str:
    """Return the versions of the solvers; cached, because the lookup takes milliseconds."""
    return f"{version('cvxpy')} {version('clarabel')} {version('scs')}"


@cache
def _source(module: str) -> bytes:
    """Return the source text of the module that states a problem, because its answer depends on it."""
    file = inspect.getsourcefile(sys.modules[module])
    return Path(file).read_bytes() if file else b""


def _to_json(solution: Any) -> str:
    return json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in solution._asdict().items()})
