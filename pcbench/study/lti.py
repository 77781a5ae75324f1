"""A study's own linear plant, `[lti]`: matrices with the experiment on them, checked and turned into a scenario."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from pcbench.errors import UserError, shown
from pcbench.plants.lti import Numbers
from pcbench.scenarios import NOTHING, Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.signals import SIGNALS, SINGLE
from pcbench.scenarios.sources import Sources, units
from pcbench.study import axes, limits
from pcbench.study.lti_inputs import sources
from pcbench.study.lti_noise import Intensity, process_noise
from pcbench.study.lti_plant import Differing, differing, known, told
from pcbench.study.lti_shapes import (
    Number,
    NumberRows,
    PerState,
    Positive,
    Rows,
    Size,
    dimensions,
    require_slow,
    signals,
    vector,
)
from pcbench.study.scenario_schema import takes_axes


# `plant` says what drifts, and a [controller] what commands are
@takes_axes(required=("sampling_period", "delay", "noise_std"), without=("parameter_drift", *axes.COMMANDS))
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
        ticks = limits.ticks_of(self.duration, tick, where)
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
