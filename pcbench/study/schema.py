"""The keys of a study file: scenarios, observers, axes, seeds, choices and tuning."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from pcbench.scenarios.signals import PATHS
from pcbench.study.lti import Lti
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.scenario_schema import ScenarioTable
from pcbench.toml_text import TomlTable

Values = list[object]
# gains as published (in a scenario), by design from the assumptions, by tuning
TUNINGS = ("published", "design", "tuned")


class Choices(BaseModel):
    """`[options.scenario]`: choices left open by a scenario's source, for all scenarios of a study."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    random_initial_state: bool = Field(
        False, description="draw x(0) from N(xhat0, P0) in each run; with initial_box draw xhat(0) about x(0) instead"
    )
    initial_spread: float = Field(
        0.0, ge=0, description="draw x(0) about x0 in each run, with this standard deviation relative to x0"
    )
    input: str | None = Field(None, description="input signal")
    unknown_input: str | None = Field(None, description="signal of the unknown input")
    feedforward: bool | None = Field(None, description="the controller adds the input that its path needs")
    predictor: bool | None = Field(
        None, description="the controller uses the state predicted to the arrival of its command"
    )
    path: str | None = Field(None, description="path that the controller follows: " + ", ".join(PATHS))
    consistency: bool = Field(
        False, description="compute NEES and NIS of observers with a covariance; needs random_initial_state = true"
    )
    precision: str = Field("float64", description="floating-point type, float64 only")

    def loop(self) -> TomlTable:
        """Return the choices for a closed loop; None: those of the scenario."""
        return {"feedforward": self.feedforward, "predictor": self.predictor, "path": self.path}

    @field_validator("precision")
    @classmethod
    def _require_float64(cls, precision: str) -> str:
        if precision != "float64":
            raise ValueError("float64: float32 rounds at 1e-7 of a signal, which is the size of errors compared here")
        return precision


class Tune(BaseModel):
    """`[tune]`: what gains are tuned for, and the effort, the same for every observer of a study."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    objective: str = Field("rmse", description="metric to minimise; default with exact_objective: pooled_rmse")
    signal: str | None = Field(None, description="signal of the metric; default: the first signal of the closing table")
    only: list[str] | None = Field(None, min_length=1, description="options to tune; default: all that can be tuned")
    exact_objective: bool = Field(
        False, description="minimise the expected value over all noise, without training runs"
    )
    budget: int = Field(60, ge=1, le=100_000, description="maximum number of simulations of all training runs")
    training: int = Field(
        256, ge=2, le=100_000, description="number of training runs; their seeds differ from those of the study"
    )
    cells: Literal["first", "all"] = Field(
        "first",
        description="first: tune at the first grid point and use the gains at all; all: tune at every grid point",
    )

    @model_validator(mode="before")
    @classmethod
    def _set_default_objective(cls, value: object) -> object:
        if isinstance(value, dict) and value.get("exact_objective") is True:
            return {"objective": "pooled_rmse"} | value
        return value


class TunedCell(BaseModel):
    """`[[tuned.cells]]`: the gains of one cell, where gains were tuned in every cell."""

    model_config = ConfigDict(extra="forbid")
    cell: TomlTable = Field(description="value of each axis")
    options: dict[str, TomlTable] = Field(description="all options of each tuned label at this grid point")


class TunedOptions(BaseModel):
    """`[tuned]` of a study that was run: which options were tuned, and where."""

    model_config = ConfigDict(extra="forbid")
    scenario: str = Field(description="scenario of the training runs")
    cell: TomlTable = Field(
        description="value of each axis at the grid point of the tuning, or at the first of several"
    )
    metric: str = Field(description="metric that was minimised")
    signal: str = Field(description="signal of the metric")
    options: dict[str, TomlTable] = Field(
        description="tuned options by label; empty if no gains were better than the first"
    )
    cells: list[TunedCell] | None = Field(None, description="options of every grid point, if each was tuned")


class Study(BaseModel):
    """A study file; seconds and SI units."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^\w[\w./+-]*$", max_length=100, description="name of the study and of its folder")
    scenarios: list[str] = Field(
        min_length=1, description="names of scenarios; not needed with [scenario], [scenarios] or [lti]"
    )
    observers: list[str] | None = Field(None, description='names, labels, or "all"; default: those of each scenario')
    excluded: dict[str, str] | None = Field(
        None, description='reasons why `observers = "all"` leaves out observers; pcbench writes it'
    )
    tuned: TunedOptions | None = Field(None, description="tuned options, with grid point and metric; pcbench writes it")
    custom_observers: dict[str, str] = Field({}, description="your own observers: MODULE:NAME by label")
    seeds: int = Field(256, gt=0, le=10_000_000, strict=True, description="number of runs per grid point and observer")
    first_seed: int = Field(0, ge=0, le=4_000_000_000, strict=True, description="index of the first seed")
    root_seed: int = Field(0, ge=0, lt=2**32, strict=True, description="root of all random numbers of the study")
    evaluation: Literal["runs", "exact", "both"] = Field(
        "runs",
        description="runs: simulated runs; exact: expected values without seeds; both: exact values, and runs for all others",
    )
    engine: Literal["definition", "steps"] | None = Field(
        None,
        description="definition: the reference, one lax.scan per run; steps (the default): the same numbers, faster. A dataset "
        "keeps its first engine",
    )
    schedules: int = Field(
        64, ge=2, le=100_000, strict=True, description="number of random schedules over which exact values are averaged"
    )
    axes: dict[str, Values] = Field({}, description="list of values by axis")
    vary: Literal["all", "one-at-a-time"] = Field(
        "all",
        description="all: one grid point per combination of the axes; one-at-a-time: one axis varies, the others keep their "
        "first value",
    )
    options: dict[str, TomlTable] = Field({}, description="options by observer or label, and [options.scenario]")
    lti: Lti | None = None
    scenario: ScenarioTable | None = None
    tables: dict[str, ScenarioTable] | None = Field(
        None, description="your own scenarios by name; a study file has [scenarios.NAME]"
    )
    controller: TomlTable | None = Field(None, description="control law that closes the loop of every scenario")
    tuning: str | list[str] = Field("published", description="gains: " + ", ".join(TUNINGS) + ", or a list of these")
    tune: Tune = Tune()
    # user-defined objects once the study is read: observers by label, plants and controllers by MODULE:NAME
    _plugins: dict[str, UserPlugin] = PrivateAttr({})

    @field_validator("tuning", mode="before")
    @classmethod
    def _require_valid_tunings(cls, value: object) -> object:
        tunings = [value] if isinstance(value, str) else value
        if not isinstance(tunings, list) or not tunings or any(t not in TUNINGS for t in tunings):
            raise ValueError(f"{', '.join(map(repr, TUNINGS))}, or a list of them")
        if len(set(tunings)) < len(tunings):
            raise ValueError("each of them once")
        return value

    @property
    def tunings(self) -> list[str]:
        """Return the requested tunings as a list."""
        return [self.tuning] if isinstance(self.tuning, str) else list(self.tuning)

    @property
    def tuning_sentence(self) -> str | None:
        """Return a sentence on the grid points at which the gains were tuned; None if none were."""
        if self.tuned is None:
            return None
        cell = ", ".join(f"{name} = {value}" for name, value in self.tuned.cell.items())
        tuned = (
            f"The gains of {', '.join(self.tuned.options) or 'no observer'} were tuned for {self.tuned.metric} of "
            f"{self.tuned.signal} in {self.tuned.scenario}"
        )
        if self.tuned.cells:
            return f"{tuned}, separately at each of {len(self.tuned.cells)} grid points."
        return f"{tuned}{f' at {cell}' if cell else ''}." + (
            " The other grid points use the same gains." if any(len(v) > 1 for v in self.axes.values()) else ""
        )


KEYS = {  # by table of a study file
    "": [*Study.model_fields],
    "lti": [*Lti.model_fields],
    "scenario": [*ScenarioTable.model_fields],
    "options.scenario": [*Choices.model_fields],
    "tune": [*Tune.model_fields],
    "tuned": [*TunedOptions.model_fields],
    "tuned.cells": [*TunedCell.model_fields],
}
