"""Checks of a study or a scenario before it runs: gains, loops, a perfect start, a few short runs."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from pcbench import planning
from pcbench.checking.noise_free_runs import errors, limit_duration, noise_free, plan_cell, record_run, relative_errors
from pcbench.checking.targets import CheckNote, Finding, SkipCheck, run_checks
from pcbench.dynamics.observability import format_mode
from pcbench.errors import UserError
from pcbench.planning import all_observers
from pcbench.plants import entry_of, nonlinear, numbers_of, states_of
from pcbench.study import controller_table, parse
from pcbench.study.grid import Cell, Grid
from pcbench.study.parse import StudyLike

ROUNDING = 1e-9  # of the largest state: a tick of slip is more than 1e-5
LINEAR = 1e-5  # the same of a linear model near the operating point of a nonlinear plant
MOST, SEEDS = 6, 3  # cells of a scenario whose gains are computed; runs


def load_grid(study: StudyLike, overrides: Sequence[str]) -> tuple[Grid, str]:
    """Return a study with its cells and a text of its sizes; raise UserError that names the wrong entry."""
    grid = all_observers.grid_of(study, {}, list(overrides))
    names = ", ".join(dict.fromkeys(c.scenario.name for c in grid.cells))
    observers = ", ".join(dict.fromkeys(o for c in grid.cells for o in c.options))
    return grid, f"{names}: {len(grid.cells)} cell{'s' * (len(grid.cells) != 1)}; {observers}"


def gains(grid: Grid) -> str:
    """Check that every observer has gains, in the first and the last cell of each scenario and some in between."""
    sample = [cell for cells in _by_scenario(grid) for cell in _spread(cells)]
    for cell in sample:
        for label, options in cell.options.items():
            try:
                planning.draft(cell, {label: options})
            except UserError as error:
                raise UserError(
                    f"gains: got a refusal of {label} in {cell.scenario.name}{_where(cell)}: '{str(error).rstrip('.')}', "
                    "expected gains in every cell; leave it, or that value of an axis, out, or give it other options."
                ) from None
    return f"found in {len(sample)} of {len(grid.cells)} cells"


def _by_scenario(grid: Grid) -> list[list[Cell]]:
    return [[c for c in grid.cells if c.scenario.name == name] for name in grid.study.scenarios]


def _first(grid: Grid) -> list[Cell]:
    """Return the first cell of each scenario."""
    return [cells[0] for cells in _by_scenario(grid)]


def _spread(cells: list[Cell]) -> list[Cell]:
    """Return the first cell, the last one, and some in between."""
    return [cells[i] for i in sorted({round(i) for i in np.linspace(0, len(cells) - 1, MOST)})]


def _where(cell: Cell) -> str:
    return f", cell {cell.number}" if cell.number else ""


def settles(grid: Grid) -> str:
    """Check that every loop is stable: with state feedback the eigenvalues are within the unit circle."""
    scenarios = {(c.scenario.name, str(c.scenario.loop)): c.scenario for c in grid.cells}
    slowest = {name: controller_table.slowest_mode(s, "settles") for (name, _), s in scenarios.items()}
    loops = {name: loop for name, loop in slowest.items() if loop}
    if sentences := parse.stability_warnings(grid):
        raise UserError(sentences[0])
    if not loops:
        raise SkipCheck("no controller here has a known linear law")
    return "; ".join(f"{name}: eigenvalue {format_mode(e.mode)} over {e.period:g} s" for name, e in loops.items())


def perfect_start(grid: Grid) -> str:
    """Check that observers that claim so have no error, in the first cell of each scenario.

    The model and the initial state are true, and there is no noise. An error of a built-in observer is not a mistake of
    the study. The check then reports it as a note.
    """
    exact: list[str] = []
    inexact: list[str] = []
    grows: list[str] = []
    for cell in _first(grid):
        claims = [label for label in cell.options if claims_it(cell, label)]
        if not claims:
            continue
        for p in plan_cell(noise_free(limit_duration(cell))):  # all observers: the program is that of `runs`
            out = record_run(p, noise=False)
            if not np.isfinite(out.x).all():
                grows.append(cell.scenario.name)
                break
            for label, e in relative_errors(p, out).items():
                if label in claims and label in cell.user_observers:
                    require_none(e, f"perfect start: got, from {label} in {cell.scenario.name},", cell)
                elif label in claims and not (e <= ROUNDING).all():
                    inexact.append(f"{label} in {cell.scenario.name} ({np.max(e):.2g} of the largest state)")
        else:
            exact.append(f"{cell.scenario.name}: {', '.join(claims)}")
    if grows and not exact:
        raise SkipCheck(f"the state of {', '.join(grows)} is not finite without noise; use a shorter tick")
    if not exact:
        raise SkipCheck("no observer here claims one, or an unknown input pushes the plant")
    if inexact:
        raise CheckNote(
            f"without noise, from the true start, an error remains of {', '.join(inexact)}: these observers are pcbench's and "
            "approximate this plant, of fast modes or curved; use a shorter tick, or other observers"
        )
    return f"no error in {'; '.join(exact)}"


def claims_it(cell: Cell, label: str) -> bool:
    """Return whether an observer claims a perfect start on a cell's plant."""
    s, entry = cell.scenario, cell.entry(label)
    has_unknown_input = entry_of(s).nominal(numbers_of(s)).E is not None
    return entry.knows_schedule and not has_unknown_input and (entry.nonlinear or not nonlinear(s))


def require_none(e: np.ndarray, got: str, cell: Cell) -> None:
    """Raise UserError if there is an error e [N+1, n], as a fraction of the largest state."""
    for k, i in np.argwhere(~(e <= ROUNDING)):
        raise UserError(
            f"{got} an error of {e[k, i]:.2g} of the largest state in {states_of(cell.scenario)[i][0]} at tick {k}, expected "
            "none (true model, true start, no noise); look for an offset of one tick, or declare knows_schedule False."
        )


def runs(grid: Grid) -> str:
    """Run some seeds of the first cell of each scenario: the plant must stay finite; observers that diverge are named."""
    diverging: list[str] = []
    for cell in _first(grid):
        short_cell = limit_duration(cell)
        for p in plan_cell(short_cell, true_unknowns=False):
            outs = [record_run(p, seed) for seed in range(SEEDS)]
            n = len(states_of(cell.scenario))
            for k in (k for out in outs for k in np.flatnonzero(~np.isfinite(np.asarray(out.x)[:, :n]).all(1))):
                raise UserError(
                    f"runs: got a plant of {cell.scenario.name} that is not finite after {k * cell.scenario.dt:g} s, expected "
                    "numbers; close the loop, or give another start, a shorter tick or duration."
                )
            for label in p.labels:
                diverged = [not (e <= p.problem.bound[: e.shape[1]]).all() for e in (errors(p, o)[label] for o in outs)]
                if any(diverged):
                    diverging.append(f"{label} in {cell.scenario.name} ({sum(diverged)} of {SEEDS} runs)")
    if diverging:
        raise CheckNote(f"the error exceeds the divergence threshold of {', '.join(diverging)}")
    return f"{SEEDS} of each scenario: no error exceeds its divergence threshold"


CHECKS: dict[str, Callable[[Grid], str]] = {
    "gains": gains,
    "settles": settles,
    "perfect start": perfect_start,
    "runs": runs,
}
NEEDS = {"": (), "perfect start": ("gains",), "runs": ("gains",)}


def findings(study: StudyLike, overrides: Sequence[str] = ()) -> list[Finding]:
    """Return the results of all checks of a study."""
    return run_checks("reads", partial(load_grid, study, overrides), CHECKS, NEEDS)
