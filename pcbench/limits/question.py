"""The question, checked before anything runs: one scenario, one axis, one metric of one signal, one limit."""

from math import isfinite
from typing import NamedTuple

from pcbench.dataset.adaptive_seeds import METRICS
from pcbench.dataset.columns import AXIS_UNITS, unit_of
from pcbench.errors import UserError, unknown
from pcbench.limits.axis import Axis, axis_of
from pcbench.plants import settles_alone, signals_of
from pcbench.scenarios import Scenario
from pcbench.statistics import OF_RUN
from pcbench.statistics.metric_matrix import SIGNED
from pcbench.study import Study, scenarios_of

SMALLER_IS_BETTER = tuple(m for m in METRICS if m not in SIGNED)
UNITLESS = ("divergence_rate", "unsettled_rate")
PUSHES = ("parameter_drift", "process_std")


class Question(NamedTuple):
    """What is asked of a study."""

    study: Study
    scenario: Scenario
    axis: Axis
    metric: str
    signal: str
    threshold: float

    @property
    def unit(self) -> str:
        """Return the metric's unit."""
        return "1" if self.metric in UNITLESS else unit_of(self.metric, dict(signals_of(self.scenario))[self.signal])

    @property
    def axis_unit(self) -> str:
        """Return the axis' unit; empty where it has none that is known."""
        return AXIS_UNITS.get(self.axis.name, "").replace("1", "")


def question(study: Study, where: str, named: str, metric: str, signal: str | None, threshold: float) -> Question:
    """Return what is asked; raise UserError naming what no answer can be given to."""
    if metric not in SMALLER_IS_BETTER:
        if metric in ("rms_efficiency", *SIGNED):
            raise UserError(
                f"--metric: got {metric}, of which less is not better, expected the size of an error; take steady_pooled_rmse."
            )
        raise unknown("--metric", "metric to be kept below a limit", metric, SMALLER_IS_BETTER)
    if not (isfinite(threshold) and threshold > 0):
        raise UserError(
            f"--threshold: got {threshold:g}, expected a number above 0, in the unit of the metric; write another."
        )
    if len(study.scenarios) > 1:
        raise UserError(
            f"{where}: got {len(study.scenarios)} scenarios, expected one here; name one of {', '.join(study.scenarios)}."
        )
    s = scenarios_of(study)[study.scenarios[0]]
    axis = axis_of(named, s, study.axes.get(named.partition("[")[0].strip().replace("-", "_")), where)
    for name, values in study.axes.items():
        if name != axis.name and len(values) > 1:
            raise UserError(
                f"{where}: axes.{name}: got {len(values)} values, expected one while {axis.called} is searched; add --set "
                f"axes.{name}=VALUE."
            )
    names = [name for name, _ in signals_of(s)]
    if signal is not None and signal not in names:
        raise unknown("--signal", f"signal of {s.name}", signal, names)
    chosen = signal or (names[0] if metric in OF_RUN else (*s.scoring.headline, *names)[0])
    return Question(study, s, axis, metric, chosen, threshold)


def notes(q: Question) -> list[str]:
    """Return what has to be known of an answer besides."""
    said = [
        "A value suffices where the whole 95 % interval is below the limit and no run diverged; where the interval holds the "
        "limit, it is not decided."
    ]
    others = [name for name in (*q.study.axes, q.axis.name) if name in PUSHES or name.startswith("plant.")]
    if not others and settles_alone(q.scenario):
        said.append(
            f"{q.scenario.name}: the plant decays by itself, is what its model says, and has no process noise. There the model "
            "alone wins in the end, and no answer about periods or delays follows; say what pushes it (process_std)."
        )
    return said
