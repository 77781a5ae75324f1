"""The least error that any causal estimator can have in a cell."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.dynamics import linear
from pcbench.planning import memo
from pcbench.plants import differs, nonlinear, numbers_of
from pcbench.simulation.schedule import common_times
from pcbench.study.grid import Cell
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import DesignContext


def bound(cell: Cell, known: DesignContext, ask: memo.Once = memo.anew) -> NDArray[np.float64] | None:
    """The Bayesian bound over the tail; it exists for the true linear model, a known schedule and normal noise and starts."""
    s = cell.scenario
    other = differs(numbers_of(s), cell.parameters)
    wrong = nonlinear(s) or s.truth.parameter_drift or other or s.truth.unknown_input or s.loop.command_std
    wrong = wrong or len(s.belief.unknown_std) > 0  # what is not known of the plant is looked for
    normal = all(s.sampling.noise_std) and not s.sampling.outlier_probability and np.isinf(s.sampling.student_t_dof)
    normal = normal and not any(s.sampling.quantization_step)
    normal = normal and not (cell.choices.random_initial_state and s.belief.initial_box)  # runs draw a uniform start
    normal = normal and not cell.choices.initial_spread  # or one that is not of the prior
    exact = not wrong and normal
    clocks = cell.times.clocks
    if not exact or cell.times.random:
        return None
    known = known._replace(noise_std=s.sampling.noise_std)  # what is, whatever is believed
    sees = known.model, known.dt, known.ticks, known.noise_std, known.P0, s.truth.process_std
    key = memo.key_of((*sees, cell.times.tail)), tuple(clocks)
    alike = memo.key_of((known.model, known.dt, known.noise_variance, s.truth.process_std))
    steps = ask("steps", alike, riccati.no_steps)
    moved = ask("moved", (alike, known.ticks), lambda: _over_ticks(known, s.truth.process_std))
    found: NDArray[np.float64] = ask("bound", key, lambda: _bound(cell, known, moved, steps))
    return found


def _over_ticks(known: DesignContext, process_std: Any) -> tuple[linear.Matrix, linear.Matrix]:
    """Return what the model and its noise, which is what is and not what designers assume, do over 2^b ticks."""
    doubled = linear.doublings(known.model, known.dt, linear.bits_for(known.ticks))
    added = known._replace(process_std=process_std).process_noise
    return doubled, linear.noise_doublings(known.model, added, known.dt, len(doubled))


def _bound(
    cell: Cell, known: DesignContext, moved: tuple[linear.Matrix, linear.Matrix], steps: riccati.Steps
) -> NDArray[np.float64]:
    samples = [(s.arrives, s.taken, s.channel) for s in common_times.samples(cell.times.clocks, known.ticks)]
    tail = range(cell.times.tail, known.ticks)
    variance = riccati.posterior_variance(*moved, known.model.C, known.noise_variance, known.P0, samples, tail, steps)
    return np.sqrt(variance)
