"""A study's linear plant `[lti]`: matrices and experiment, validated and converted to a scenario.

The process noise per tick is `process_std`, or `G` with `QN`. A continuous plant x' = A x + B u + G w has white noise w of
intensity QN, whose covariance per tick is exact (Van Loan). A discrete one adds G w with w ~ N(0, QN) at every tick.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcbench.dynamics.linear import noise_over_tick
from pcbench.errors import UserError, brief_repr
from pcbench.observers.parts.assumed_noise import require_covariance
from pcbench.plants.lti import MATRICES, Numbers
from pcbench.scenarios import NOTHING, Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.scenario import ProcessNoise
from pcbench.scenarios.signals import SIGNALS, SINGLE
from pcbench.scenarios.sources import units
from pcbench.signal_names import names_and_units
from pcbench.study import axes, times
from pcbench.study.lti_inputs import sources
from pcbench.study.lti_plant import LtiTable, dimensions, nominal_numbers, plant_deviations, require_slow
from pcbench.study.parse_scenario import experiment_on
from pcbench.study.scenario_schema import Experiment, takes_axes


def process_noise(
    lti: LtiTable, std: float | list[float] | None, A: ArrayLike, tick: float, where: str
) -> ProcessNoise:
    """Return the noise per tick of a plant A [n, n], as in `Truth.process_std`: [n], its root [n, n], or empty.

    `std` is the table's process_std, common to all states or one per state. The root is the symmetric square root of the
    covariance. Raises UserError if G and QN do not fit, or if QN is not a covariance.
    """
    n = np.shape(A)[0]
    if std is not None:
        if key := next((name for name in ("G", "QN") if getattr(lti, name) is not None), None):
            raise UserError(f"{where}: got process_std and {key}, expected one of the two ways; leave one out.")
        stds = std if isinstance(std, list) else [float(std)] * n
        if len(stds) != n:
            raise UserError(f"{where}.process_std: got {len(stds)} numbers, expected {n}, one for each state.")
        return tuple(stds) if any(stds) else ()
    if lti.QN is None:
        if lti.G is not None:
            raise UserError(f"{where}.QN is missing, which G needs; write QN = ..., the intensity of the noise.")
        return ()
    if lti.G is not None and (len(lti.G) != n or len(widths := {len(row) for row in lti.G}) != 1 or 0 in widths):
        raise UserError(
            f"{where}.G: got {brief_repr(lti.G)}, expected {n} rows of the same length, one row for each state."
        )
    G = np.eye(n) if lti.G is None else np.array(lti.G, float)
    QN = covariance(lti.QN, G.shape[1], f"{where}.QN")
    Q = G @ QN @ G.T if lti.dt else noise_over_tick(np.array(A, float), G @ QN @ G.T, tick)
    if not np.any(Q):
        return ()
    if not np.any(Q - np.diag(np.diag(Q))):
        return tuple(np.sqrt(np.diag(Q)).tolist())
    eigenvalues, V = np.linalg.eigh(Q)
    return tuple(tuple(row) for row in ((V * np.sqrt(np.maximum(eigenvalues, 0.0))) @ V.T).tolist())


def covariance(entries: float | list[float] | list[list[float]], n: int, where: str) -> NDArray[np.float64]:
    """Return a number, `n` numbers or rows as a matrix; raise UserError if it is not a covariance of this size."""
    if not isinstance(entries, list):
        return float(entries) * np.eye(n)
    flat = not any(isinstance(row, list) for row in entries)
    if len(entries) != n or not (flat or all(isinstance(row, list) and len(row) == n for row in entries)):
        raise UserError(
            f"{where}: got {brief_repr(entries)}, expected a number, {n} numbers, or {n} x {n}: one noise "
            "for each column of G."
        )
    Q: NDArray[np.float64] = np.diag(np.array(entries, float)) if flat else np.array(entries, float)
    require_covariance(Q, entries, where)
    return Q


# `plant` replaces parameter_drift, a [controller] replaces command axes
@takes_axes(
    required=("sampling_period", "delay", "noise_std"),
    without=("parameter_drift", *axes.COMMANDS),
    defaults={"input": "sine", "divergence_threshold": 1e6, "duration": 10.0, "observers": ["kf", "model-only"]},
)
class Lti(Experiment, LtiTable):
    """x' = A x + B u + E f, y = C x + D u, u and f held over a tick; with `dt`, x one tick later. n, m, q; r unknown inputs.

    By default, x(0) is ones and f is a sine.
    """

    def numbers(self, where: str) -> Numbers:
        """Return the plant's parameters as assumed by observers; raise UserError with the entry that has no value."""
        return nominal_numbers(self, where)

    def scenario(self, name: str, where: str) -> Scenario:
        """Return the experiment as a scenario; raise UserError with the invalid key."""
        n, m, _ = dimensions(self, where)
        numbers = self.numbers(where)
        plant = plant_deviations(self, numbers, where)
        if self.dt is not None and self.tick not in (None, self.dt):
            raise UserError(
                f"{where}: got a discrete plant of dt = {self.dt:g} s and a tick of {self.tick:g} s, expected the same; "
                f"leave tick out, or discretise the plant at {self.tick:g} s."
            )
        r = len(self.E[0]) if self.E else 0
        if self.unknown_input is not None and not r:
            raise UserError(
                f"{where}.unknown_input: got {brief_repr(self.unknown_input)} without E, expected E [n, r] too."
            )
        table = {key: value for key, value in self.as_table().items() if key not in LtiTable.model_fields}
        tick, duration = self.dt or self.tick or 1e-3, table.pop("duration", Scenario._field_defaults["duration"])
        ticks = times.ticks_of(duration, tick, where)
        table |= {
            "x0": table.get("x0", 1.0),
            "steady_start": round(table.get("steady_start", 0.3 * duration) / tick) * tick,
        }
        table["input"] = sources(self.input, m, SIGNALS, (ticks, tick), "inputs", f"{where}.input")
        unknown_input, place = table.pop("unknown_input", "sine"), f"{where}.unknown_input"
        unknown_input = sources(unknown_input, r, SINGLE, (ticks, tick), "unknown inputs", place) if r else ""
        unknowns = tuple(
            ("input" if r == 1 else f"input{i + 1}", unit or "1") for i, unit in enumerate(units(unknown_input, r))
        )
        states = _states(self.states, n, unknowns, where)
        require_slow(numbers.A, self.dt is not None, ticks, tick, where)
        model = {letter: getattr(numbers, letter) for letter in MATRICES} | {"discrete": numbers.discrete}
        model |= (
            {"parameters": dict(numbers.parameters), "formulas": dict(numbers.formulas)} if numbers.parameters else {}
        )
        noise = process_noise(self, table.pop("process_std", None), numbers.A, tick, where)
        base = Scenario(
            name=name,
            summary="a user's plant",
            source="the study",
            plant="lti",
            observers=tuple(self.observers or ()),
            truth=Truth(
                x0=(),
                parameter_drift=1.0 if plant else 0.0,
                parameters={"plant": plant} if plant else NOTHING,
                process_std=noise,
                unknown_input=unknown_input,
            ),
            loop=Loop(),
            sampling=Sampling((), (), ()),
            belief=Belief((), (), model=model),
            scoring=Scoring(
                settle_band=(),
                divergence_threshold=1e6,
                signals=states,
                unknowns=unknowns,
                headline=(states[0][0], *(name for name, _ in unknowns)) if r else (),
            ),
            dt=tick,
            duration=ticks * tick,
        )
        return experiment_on(base, table, where)


def _states(
    names: list[str] | None, n: int, unknowns: tuple[tuple[str, str], ...], where: str
) -> tuple[tuple[str, str], ...]:
    """Return names and units of the states, by default x1 to xn; raise UserError for a name of an unknown input."""
    if names is not None and len(names) != n:
        raise UserError(f"{where}.states: got {len(names)} names, expected {n}, one for each state.")
    default = tuple((f"x{i + 1}", "1") for i in range(n))
    states = default if names is None else names_and_units(names, f"{where}.states")
    for signal, _ in unknowns:
        if signal in dict(states):
            raise UserError(
                f"{where}.states: got a state called '{signal}', expected another name (the unknown input has it)."
            )
    return states
