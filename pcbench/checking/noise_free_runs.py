"""Short runs, recorded tick by tick, also without noise or errors of the assumptions.

In a noise-free run the model and the assumed initial state are true, and there is no noise. Schedule, input and controller
are those of the grid point.
"""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pcbench import planning
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.plants import states_of
from pcbench.simulation import trajectory
from pcbench.simulation.trajectory import Recording
from pcbench.simulation.types import present, truth
from pcbench.study.grid import Cell

LONGEST = 4000  # ticks of a recorded run, at most


def limit_duration(cell: Cell) -> Cell:
    """Return a cell with a duration of at most `LONGEST` ticks."""
    s = cell.scenario
    ticks = min(cell.times.ticks, LONGEST)
    return cell.with_fields(duration=ticks * s.dt, steady_start=min(s.scoring.steady_start, (ticks - 1) * s.dt))


def noise_free(cell: Cell) -> Cell:
    """Return a cell in which all assumptions of the observers are true and the plant has no process noise."""
    s = cell.scenario
    changes = {"unknown_input": "zero"} if s.truth.unknown_input else {}
    quiet_cell = cell.with_fields(
        **changes,
        parameter_drift=0.0,
        parameters={},
        process_std=(),
        assumed_process_std=s.belief.assumed_process_std or s.truth.process_std,
        command_std=0.0,
        xhat0=s.truth.x0,
        initial_box=(),
        assumed_delay_error=0.0,
    )
    choices = cell.choices.model_copy(update={"random_initial_state": False, "initial_spread": 0.0})
    return quiet_cell._replace(parameters={}, choices=choices)


def plan_cell(cell: Cell, true_unknowns: bool = True) -> list[Plan]:
    """Return the plan of a cell; in a closed loop one plan per observer.

    If `true_unknowns`, the observers start with the true values of the plant's unknown parameters.
    """
    context = planning.context_of(cell)
    if true_unknowns:
        context = context._replace(unknown0=unknowns(cell, context.unknown0))
    by_plan = [{o: cell.options[o]} for o in cell.options] if cell.scenario.loop.controller else [cell.options]
    return [padding.fit([planning.draft(cell, options, context)])[0] for options in by_plan]


def unknowns(cell: Cell, assumed: tuple[float, ...]) -> tuple[float, ...]:
    """Return the true initial values of the plant's unknowns, or the assumed ones if the plant gives another number."""
    draft = planning.draft(cell, {})
    p, n = jax.tree.map(jnp.asarray, draft.problem), len(states_of(cell.scenario))
    true = truth(draft.layout, p.params, present(p, jnp.asarray(0), True), p.x0)[n:]
    return tuple(map(float, true)) if len(true) == len(assumed) else assumed


def record_run(p: Plan, seed: int = 0, noise: bool = True, inputs: NDArray[np.float64] | None = None) -> Recording:
    """Record a run; in an open loop with other `inputs` [N+1, m] if given."""
    p = planning.alone(p, 0, seed)
    problem = p.problem if inputs is None else p.problem._replace(inputs=inputs)
    if not noise:
        problem = problem._replace(noise_std=np.zeros_like(problem.noise_std))
    return Recording(
        *jax.tree.map(np.asarray, tuple(trajectory.jit_record()(p.layout, problem, np.asarray(0), np.asarray(seed))))
    )


def errors(p: Plan, out: Recording) -> dict[str, NDArray[np.float64]]:
    """Return the absolute errors of each observer's signals, by label: [N+1, n or n + s]."""
    by_label = {}
    for label, (name, _) in zip(p.labels, p.layout.observers, strict=True):
        xhat = np.asarray(out.estimates[name])
        by_label[label] = np.abs(np.asarray(out.x)[:, : xhat.shape[1]] - xhat)
    return by_label


def relative_errors(p: Plan, out: Recording) -> dict[str, NDArray[np.float64]]:
    """Return the absolute errors of the states divided by the largest state, by label: [N+1, n]."""
    n = len(states_of(p.cell.scenario))
    largest = np.abs(np.asarray(out.x)[:, :n]).max() or 1.0
    return {label: e[:, :n] / largest for label, e in errors(p, out).items()}
