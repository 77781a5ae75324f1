"""Objective of a tuning: a metric of a signal, over the training runs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import unknown
from pcbench.plants import signals_of
from pcbench.scenarios import Scenario
from pcbench.scenarios.signals import jumps
from pcbench.simulation import reverse_mode
from pcbench.statistics import COMPARED, OF_RUN, POOLED
from pcbench.study.times import to_ticks

MEASURES = (*COMPARED, *POOLED)


class Objective(NamedTuple):
    """A metric of the tables, and its signal."""

    metric: str
    signal: int
    name: str  # of the signal
    unit: str

    @property
    def base(self) -> str:
        """Return the metric of a run whose mean is the objective."""
        return POOLED.get(self.metric, self.metric)

    @property
    def smooth(self) -> bool:
        """Return whether the objective has a gradient."""
        return self.base.removeprefix("steady_") in reverse_mode.SMOOTH

    def from_mean(self, mean: float) -> float:
        """Return the objective from the mean of its base over runs."""
        return float(np.sqrt(mean)) if self.metric in POOLED else mean

    def to_mean(self, value: float) -> float:
        """Return the mean of the base from the objective."""
        return value**2 if self.metric in POOLED else value

    def slope(self, mean: float) -> float:
        """Return the derivative of the objective with respect to the mean of its base."""
        return 0.5 / float(np.sqrt(mean)) if self.metric in POOLED and mean > 0 else 1.0

    def from_runs(self, runs: NDArray[np.float64], diverged: NDArray[np.bool_]) -> float:
        """Return the objective from values [n] of its base over runs; infinite if a run diverged."""
        return float("inf") if diverged.any() else self.from_mean(float(np.mean(runs)))


def objective_of(objective: str, scenario: Scenario, signal: str | None, where: str) -> Objective:
    """Return an objective by names; the default signal is the first that the table of a study shows.

    Raises UserError for unknown names.
    """
    ticks = to_ticks(scenario.duration, scenario)
    loop, has_jumps = bool(scenario.loop.controller), jumps(scenario.truth.unknown_input, scenario.dt, ticks).size > 0
    metrics = [m for m in MEASURES if (loop or "tracking" not in m) and (has_jumps or m != "recovery_time")]
    metrics = [m for m in metrics if m not in OF_RUN]  # those of a signal
    if objective not in metrics:
        raise unknown(f"{where}: --objective", "metric to tune for here", objective, metrics)
    names = [name for name, _ in signals_of(scenario)]
    if signal is not None and signal not in names:
        raise unknown(f"{where}: --signal", "signal", signal, names)
    index = names.index(signal or (*scenario.scoring.headline, names[0])[0])
    return Objective(objective, index, names[index], signals_of(scenario)[index][1])
