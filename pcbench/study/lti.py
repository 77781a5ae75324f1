"""A study's own linear plant, `[lti]`: matrices with the experiment on them, checked and turned into a scenario.

The process noise of a plant of one's own, over one tick: `process_std`, or `G` with `QN`.

A continuous plant x' = A x + B u + G w has white noise w of intensity QN, whose covariance over a tick is exact (Van Loan);
a discrete one adds G w with w ~ N(0, QN) at every tick.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pcbench.dynamics.linear import noise_over_tick
from pcbench.errors import UserError, shown
from pcbench.plants.lti import Numbers
from pcbench.scenarios import NOTHING, Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.signals import SIGNALS, SINGLE
from pcbench.scenarios.sources import Sources, units
from pcbench.study import axes, times
from pcbench.study.lti_inputs import sources
from pcbench.study.lti_plant import (
    Differing,
    Number,
    NumberRows,
    PerState,
    Positive,
    Rows,
    Size,
    differing,
    dimensions,
    known,
    require_slow,
    signals,
    told,
    vector,
)
from pcbench.study.scenario_schema import takes_axes

Intensity = Size | list[Size] | list[list[Number]]
ROUNDING = 1e-12  # part of the largest entry by which a covariance may fall short of one


class Noisy(Protocol):
    """What says how process noise enters a plant, and how much of it."""

    dt: float | None
    process_std: Any
    G: Any
    QN: Any


def process_noise(lti: Noisy, A: Any, tick: float, where: str) -> tuple[Any, ...]:
    """Return the noise of a tick of a plant A [n, n] as `Truth.process_std` has it: [n], [n, n], or nothing.

    Raises UserError where G and QN do not fit, or QN is no covariance.
    """
    n = len(A)
    if lti.process_std is not None:
        other = next((name for name in ("G", "QN") if getattr(lti, name) is not None), None)
        if other:
            raise UserError(f"{where}: got process_std and {other}, expected one of the two ways; leave one out.")
        std = vector(lti.process_std, 0.0, n, f"{where}.process_std")
        return tuple(std) if any(std) else ()
    if lti.QN is None:
        if lti.G is not None:
            raise UserError(f"{where}.QN is missing beside G; write QN = ..., the intensity of the noise.")
        return ()
    G = np.eye(n) if lti.G is None else _entering(lti.G, n, f"{where}.G")
    QN = covariance(lti.QN, G.shape[1], f"{where}.QN")
    Q = G @ QN @ G.T if lti.dt else noise_over_tick(np.array(A, float), G @ QN @ G.T, tick)
    return root(Q) if np.any(Q) else ()


def root(Q: NDArray[np.float64]) -> tuple[Any, ...]:
    """Return a covariance's symmetric square root as tuples; its diagonal alone where the covariance is diagonal."""
    if not np.any(Q - np.diag(np.diag(Q))):
        return tuple(np.sqrt(np.diag(Q)).tolist())
    size, V = np.linalg.eigh(Q)
    return tuple(tuple(row) for row in ((V * np.sqrt(np.maximum(size, 0.0))) @ V.T).tolist())


def covariance(given: Any, many: int, where: str) -> NDArray[np.float64]:
    """Return a number, one for each of `many`, or rows as a matrix; raise UserError where it is no covariance of so many."""
    if not isinstance(given, list):
        return float(given) * np.eye(many)
    flat = not any(isinstance(row, list) for row in given)
    if len(given) != many or not (flat or all(len(row) == many for row in given)):
        raise UserError(
            f"{where}: got {shown(given)}, expected a number, {many} numbers, or {many} x {many}: one noise for each column "
            "of G."
        )
    Q: NDArray[np.float64] = np.diag(np.array(given, float)) if flat else np.array(given, float)
    size = max(float(np.abs(Q).max()), 1e-300)
    if np.abs(Q - Q.T).max() > ROUNDING * size or np.linalg.eigvalsh(Q)[0] < -ROUNDING * size:
        raise UserError(
            f"{where}: got {shown(given)}, expected a covariance: symmetric, with no eigenvalue below 0; mend its entries."
        )
    return Q


def _entering(rows: list[list[float]], n: int, where: str) -> NDArray[np.float64]:
    widths = {len(row) for row in rows}
    if len(rows) != n or len(widths) != 1 or 0 in widths:
        raise UserError(f"{where}: got {shown(rows)}, expected {n} rows of the same length, one row for each state.")
    return np.array(rows, float)


# `plant` says what drifts, a [controller] when commands come and what is wrong with them
@takes_axes(
    required=("sampling_period", "delay", "noise_std"), without=("parameter_drift", "actuator_delay", *axes.COMMANDS)
)
class Lti(BaseModel):
    """x' = A x + B u + E f, y = C x + D u, u and f held over a tick; with `dt`, x one tick later. n, m, q; r unknown inputs."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    parameters: dict[str, Number] | None = Field(
        None, description='named numbers; entries of A to E may be formulas of them, such as "-k/m"'
    )
    plant: Differing | None = Field(
        None, description="what is true of the plant and told to no observer: any of A to E, or of the parameters"
    )
    A: Rows = Field(description="[n, n]")
    B: Rows = Field(description="[n, m]")
    C: Rows = Field(description="[q, n]")
    D: Rows | None = Field(None, description="[q, m]; left out: zero")
    E: Rows | None = Field(None, description="[n, r] how an unknown input enters; left out: there is none")
    dt: Positive | None = Field(None, description="tick of a discrete plant [s]; left out: a continuous plant")
    tick: Positive | None = Field(None, description="tick of the simulation [s]; default 0.001, or dt")
    states: list[str] | None = Field(None, description='names with units, such as "angle [rad]"')
    process_std: PerState | None = Field(
        None, description="of the noise added at every tick, one for all states or one for each; default: none"
    )
    G: NumberRows | None = Field(None, description="[n, g] how process noise enters; default: each state has its own")
    QN: Intensity | None = Field(
        None, description="of the process noise, [g, g], a number for each, or one: intensity [1/s]; with dt, a tick's"
    )
    assumed_process_std: PerState | None = Field(
        None, description="what designers assume in place of the process noise that there is"
    )
    input: Any = Field(
        "sine",
        description="a signal's name for all inputs, or one for each, with commas; or a wave, values, rows, a CSV file",
    )
    unknown_input: Any | None = Field(None, description="likewise, of what pushes by E; default: sine")
    unknown_std: Number | list[Number] | None = Field(None, description="[r] its typical size; default: ones")
    x0: Number | list[Number] | None = Field(None, description="[n] default: ones")
    xhat0: Number | list[Number] | None = Field(None, description="[n] default: zeros")
    prior_std: Size | list[Size] | None = Field(
        None, description="[n] of x(0) about xhat(0); default: |x0 - xhat0|, and 1 of a state in which they are equal"
    )
    settle_band: Size | list[Size] | None = Field(
        None, description="[n] default: 5 % of prior_std (of its default if it is 0) and unknown_std; [n + r] with E"
    )
    divergence_threshold: Positive = Field(1e6, description="a run has diverged when an |e| leaves it")
    duration: Positive = Field(10.0, description="[s]")
    steady_start: Size | None = Field(None, description="where the tail starts [s]; default: 30 % of the horizon")
    observers: list[str] = Field(["kf", "model-only"], min_length=1)

    def numbers(self, where: str) -> Numbers:
        """Return the plant's numbers as observers know them; raise UserError naming the entry that has no value."""
        return known(self, where)

    def scenario(self, name: str, where: str) -> Scenario:
        """Return the experiment as a scenario; raise UserError naming the key that does not fit."""
        n, m, q = dimensions(self, where)
        numbers = self.numbers(where)
        plant = differing(self, numbers, where)
        if self.dt is not None and self.tick not in (None, self.dt):
            raise UserError(
                f"{where}: got a discrete plant of dt = {self.dt:g} s and a tick of {self.tick:g} s, expected the same; "
                f"leave tick out, or discretise the plant at {self.tick:g} s."
            )
        r = len(self.E[0]) if self.E else 0
        if self.unknown_input is not None and not r:
            raise UserError(
                f"{where}.unknown_input: got {shown(self.unknown_input)} without E, expected E [n, r] beside it."
            )
        x0, xhat0 = vector(self.x0, 1.0, n, f"{where}.x0"), vector(self.xhat0, 0.0, n, f"{where}.xhat0")
        apart = [abs(a - b) or 1.0 for a, b in zip(x0, xhat0, strict=True)]
        prior = vector(self.prior_std, apart, n, f"{where}.prior_std")
        size = vector(self.unknown_std, 1.0, r, f"{where}.unknown_std", "unknown input")
        if any(one < axes.SMALLEST for one in size):
            raise UserError(
                f"{where}.unknown_std: got {shown(size)}, expected sizes greater than 0; write how large the input is."
            )
        band = [0.05 * p for p in [*(p or default for p, default in zip(prior, apart, strict=True)), *size]]
        tail = 0.3 * self.duration if self.steady_start is None else self.steady_start
        tick = self.dt or self.tick or 1e-3
        ticks = times.ticks_of(self.duration, tick, where)
        driving = sources(self.input, m, SIGNALS, (ticks, tick), "inputs", f"{where}.input")
        pushing: Sources = ""
        if r:
            asked = "sine" if self.unknown_input is None else self.unknown_input
            pushing = sources(asked, r, SINGLE, (ticks, tick), "unknown inputs", f"{where}.unknown_input")
        unknowns = tuple(
            ("input" if r == 1 else f"input{i + 1}", unit or "1") for i, unit in enumerate(units(pushing, r))
        )
        states = signals(self.states, n, f"{where}.states")
        for signal, _ in unknowns:
            if signal in dict(states):
                raise UserError(
                    f"{where}.states: got a state called '{signal}', expected another name (the unknown input has it)."
                )
        require_slow(numbers.A, self.dt is not None, ticks, tick, where)
        base = Scenario(
            name=name,
            summary="a plant of one's own",
            source="the study",
            plant="lti",
            observers=tuple(self.observers),
            truth=Truth(
                x0=tuple(x0),
                parameter_drift=1.0 if plant else 0.0,
                parameters={"plant": plant} if plant else NOTHING,
                process_std=process_noise(self, numbers.A, tick, where),
                unknown_input=pushing,
            ),
            loop=Loop(input=driving),
            sampling=Sampling(sampling_period=(tick,) * q, delay=(0.0,) * q, noise_std=(0.0,) * q),
            belief=Belief(
                xhat0=tuple(xhat0),
                prior_std=tuple(prior),
                model=told(numbers),
                unknown_std=tuple(size),
                assumed_process_std=tuple(vector(self.assumed_process_std, [], n, f"{where}.assumed_process_std"))
                if self.assumed_process_std is not None
                else (),
            ),
            scoring=Scoring(
                settle_band=tuple(vector(self.settle_band, band, n + r, f"{where}.settle_band", "signal")),
                divergence_threshold=self.divergence_threshold,
                steady_start=round(tail / tick) * tick,
                signals=states,
                unknowns=unknowns,
                headline=(states[0][0], *(name for name, _ in unknowns)) if r else (),
            ),
            dt=tick,
            duration=ticks * tick,
        )
        if not 0 <= base.scoring.steady_start < base.duration:
            raise UserError(
                f"{where}.steady_start: got {tail:g} s, expected less than the duration of {self.duration:g} s."
            )
        given = {f: v for f in axes.AXES if f not in axes.STATES and (v := getattr(self, f, None)) is not None}
        return base.having(**{f: axes.point(f, v, base, f"{where}.{f}") for f, v in given.items()})
