"""What a study file may say: scenarios x observers x axes x seeds, choices, and what to tune for."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from pcbench.scenarios.signals import PATHS
from pcbench.study.lti import Lti
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.scenario_schema import ScenarioTable
from pcbench.toml_text import TomlTable

Values = list[object]
TUNINGS = ("published", "design", "tuned")  # gains as printed (a scenario's), by design for what is known, by tuning


class Choices(BaseModel):
    """`[options.scenario]`: choices left open by a scenario's source, for all scenarios of a study."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    random_initial_state: bool = Field(
        False,
        description="draw x(0) from N(xhat(0), P0) for each seed, or xhat(0) in a box about x(0) where there is one",
    )
    initial_spread: float = Field(0.0, ge=0, description="draw x(0) about x0 for each seed, by this part of its size")
    input: str | None = Field(None, description="name of the input signal")
    unknown_input: str | None = Field(None, description="name of the signal that pushes a plant with an unknown input")
    feedforward: bool | None = Field(None, description="a controller adds the input that its path needs")
    predictor: bool | None = Field(
        None, description="a controller acts on the state predicted to its command's arrival"
    )
    path: str | None = Field(None, description="what a controller follows: " + ", ".join(PATHS))
    consistency: bool = Field(
        False,
        description="say whether observers know how wrong they are, of those that have a covariance (random_initial_state)",
    )
    precision: str = Field("float64", description="float64: no other is offered")

    def loop(self) -> TomlTable:
        """Return what is chosen of a closed loop, None where it is the scenario's."""
        return {"feedforward": self.feedforward, "predictor": self.predictor, "path": self.path}

    @field_validator("precision")
    @classmethod
    def _enough(cls, precision: str) -> str:
        if precision != "float64":
            raise ValueError("float64: float32 rounds at 1e-7 of a signal, which is the size of errors compared here")
        return precision


class Tune(BaseModel):
    """`[tune]`: what gains are tuned for, and the effort, the same for every observer of a study."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    objective: str = Field(
        "rmse", description="metric of the tables to make small; by default rmse, of an exact objective pooled_rmse"
    )
    signal: str | None = Field(None, description="of which signal; default: the first that a closing table shows")
    only: list[str] | None = Field(None, min_length=1, description="options that are tuned; default: all that may be")
    exact_objective: bool = Field(False, description="take its expected value over all noise, without training runs")
    budget: int = Field(60, ge=1, le=100_000, description="times that all training runs are simulated")
    training: int = Field(256, ge=2, le=100_000, description="training runs; their seeds are far from a study's")
    cells: Literal["first", "all"] = Field(
        "first", description="first: gains are tuned in the first cell and used in all; all: in every cell for itself"
    )

    @model_validator(mode="before")
    @classmethod
    def _has_an_exact_value(cls, given: object) -> object:
        if isinstance(given, dict) and given.get("exact_objective") is True:
            return {"objective": "pooled_rmse"} | given
        return given


class TunedCell(BaseModel):
    """`[[tuned.cells]]`: the gains of one cell, where gains were tuned in every cell."""

    model_config = ConfigDict(extra="forbid")
    cell: TomlTable = Field(description="value of each axis")
    options: dict[str, TomlTable] = Field(description="all options of each tuned label in this cell")


class TunedOptions(BaseModel):
    """`[tuned]` of a study that was run: which options were tuned, and where."""

    model_config = ConfigDict(extra="forbid")
    scenario: str
    cell: TomlTable = Field(description="value of each axis with which they were tuned; of several cells the first")
    metric: str
    signal: str
    options: dict[str, TomlTable] = Field(description="tuned options by label; none where the start was kept")
    cells: list[TunedCell] | None = Field(None, description="the options of every cell, if each was tuned for itself")


class Study(BaseModel):
    """A study as it stands in a TOML file; seconds and SI units."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^\w[\w./+-]*$", max_length=100)
    scenarios: list[str] = Field(min_length=1)
    observers: list[str] | None = None
    excluded: dict[str, str] | None = Field(
        None, description='why observers that `observers = "all"` would have are not among them; pcbench writes it'
    )
    tuned: TunedOptions | None = Field(
        None, description="which options were tuned, in which cell and for which metric; pcbench writes it"
    )
    custom_observers: dict[str, str] = Field({}, description="MODULE:NAME of your own observers, by label")
    seeds: int = Field(256, gt=0, le=10_000_000, strict=True)
    first_seed: int = Field(0, ge=0, le=4_000_000_000, strict=True)
    root_seed: int = Field(0, ge=0, lt=2**32, strict=True)
    evaluation: Literal["runs", "exact", "both"] = Field(
        "runs", description="simulated runs; exact numbers without a seed; or exact ones and runs of what has none"
    )
    engine: Literal["definition", "steps"] | None = Field(
        None,
        description="definition: each run as it is defined, by vmap of lax.scan; steps (the default): equal to it and faster. "
        "A dataset keeps the engine with which it began",
    )
    schedules: int = Field(
        64, ge=2, le=100_000, strict=True, description="over which exact numbers of random cells are averaged"
    )
    axes: dict[str, Values] = {}
    vary: Literal["all", "one-at-a-time"] = Field(
        "all",
        description="a cell for every combination of the axes; each: for one axis at a time, the others at their first",
    )
    options: dict[str, TomlTable] = {}
    lti: Lti | None = None
    scenario: ScenarioTable | None = None
    tables: dict[str, ScenarioTable] | None = Field(
        None, description="your own scenarios, by name; a study file writes [scenarios.NAME]"
    )
    controller: TomlTable | None = Field(None, description="a law that closes the loop of every scenario")
    tuning: str | list[str] = Field(
        "published", description="whose gains: " + ", ".join(TUNINGS) + ", or a list of them"
    )
    tune: Tune = Tune()
    # what is a user's own, once the study is read: observers by label of `use`, plants and controllers by MODULE:NAME
    _own: dict[str, UserPlugin] = PrivateAttr({})

    @field_validator("tuning", mode="before")
    @classmethod
    def _known(cls, given: object) -> object:
        asked = [given] if isinstance(given, str) else given
        if not isinstance(asked, list) or not asked or any(each not in TUNINGS for each in asked):
            raise ValueError(f"{', '.join(map(repr, TUNINGS))}, or a list of them")
        if len(set(asked)) < len(asked):
            raise ValueError("each of them once")
        return given

    @property
    def tunings(self) -> list[str]:
        """Return whose gains are asked for, as a list."""
        return [self.tuning] if isinstance(self.tuning, str) else list(self.tuning)

    @property
    def tuning_sentence(self) -> str | None:
        """Return in which cell the gains were tuned; None if none were."""
        if self.tuned is None:
            return None
        cell = ", ".join(f"{name} = {value}" for name, value in self.tuned.cell.items())
        tuned = (
            f"The gains of {', '.join(self.tuned.options) or 'no observer'} were tuned for {self.tuned.metric} of "
            f"{self.tuned.signal} in {self.tuned.scenario}"
        )
        if self.tuned.cells:
            return f"{tuned}, in each of {len(self.tuned.cells)} cells for itself."
        return f"{tuned}{f' at {cell}' if cell else ''}." + (
            " The other cells use the same gains." if any(len(v) > 1 for v in self.axes.values()) else ""
        )


KEYS = {  # by table of a study file
    "": [*Study.model_fields],
    "lti": [*Lti.model_fields],
    "scenario": [*ScenarioTable.model_fields],
    "tune": [*Tune.model_fields],
    "tuned": [*TunedOptions.model_fields],
    "tuned.cells": [*TunedCell.model_fields],
}
