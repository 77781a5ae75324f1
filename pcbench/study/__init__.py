"""What a study is: scenarios x observers x axes x seeds, with the options of each observer.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from pcbench.errors import UserError, short, shown, unknown
from pcbench.observers import OBSERVERS, base_of, entry_of
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.scenarios.signals import PATHS, SIGNALS, SINGLE
from pcbench.study import axes
from pcbench.study.lti import Lti

Values = list[Any]
KINDS = ("float", "str")  # how pydantic's names end for a value that may be of several kinds
LEAST = 1e-30  # a number of an option is 0 or no smaller: the square of the least noise is larger
TUNINGS = ("paper", "design", "tuned")  # gains as printed (a scenario's), by design for what is known, by tuning
OWN = "lti"  # the scenario of a study's own plant


class Choices(BaseModel):
    """`[options.scenario]`: choices left open by a scenario's source, for all scenarios of a study."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    random_start: bool = Field(
        False,
        description="draw x(0) from N(xhat(0), P0) for each seed, or xhat(0) in a box about x(0) where there is one",
    )
    start_spread: float = Field(0.0, ge=0, description="draw x(0) about x0 for each seed, by this part of its size")
    input: str | None = Field(None, description="name of the input signal")
    unknown_input: str | None = Field(None, description="name of the signal that pushes a plant with an unknown input")
    feedforward: bool | None = Field(None, description="a controller knows the input that its path needs")
    predictor: bool | None = Field(
        None, description="a controller acts on the state predicted to its command's arrival"
    )
    path: str | None = Field(None, description="what a controller follows: " + ", ".join(PATHS))
    drift_sign: Literal[-1, 1] = Field(1, description="the operator lost in print, in the cart's drift")
    precision: str = Field("float64", description="float64: no other is offered")

    def loop(self) -> dict[str, Any]:
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
    objective: str = Field("rmse", description="metric of the tables to make small")
    signal: str | None = Field(None, description="of which signal; default: the first that a closing table shows")
    budget: int = Field(60, ge=1, le=100_000, description="times that all training runs are simulated")
    training: int = Field(256, ge=2, le=100_000, description="training runs; their seeds are far from a study's")


class Study(BaseModel):
    """A study as it stands in a TOML file; seconds and SI units."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^\w[\w./+-]*$", max_length=100)
    scenarios: list[str] = Field(min_length=1)
    observers: list[str] | None = None
    seeds: int = Field(256, gt=0, le=10_000_000, strict=True)
    first_seed: int = Field(0, ge=0, le=4_000_000_000, strict=True)
    root_seed: int = Field(0, ge=0, lt=2**32, strict=True)
    axes: dict[str, Values] = {}
    options: dict[str, dict[str, Any]] = {}
    lti: Lti | None = None
    tuning: str | list[str] = Field("paper", description="whose gains: " + ", ".join(TUNINGS) + ", or a list of them")
    tune: Tune = Tune()

    @field_validator("tuning", mode="before")
    @classmethod
    def _known(cls, given: Any) -> Any:
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


STUDIES = {
    "quick": Study(name="quick", scenarios=["cart/nominal", "cart/white"], seeds=256),
    "cart": Study(
        name="cart",
        scenarios=[s for s in SCENARIOS if s.startswith("cart/") and not s.startswith("cart/variable")],
        seeds=1024,
    ),
    "unequal-delays": Study(
        name="unequal-delays",
        scenarios=["csth/10s-noise"],
        observers=["chain", "chain-slow", "chain-riccati", "equal-delay", "no-delay", "dkf", "open-loop"],
        seeds=256,
        axes={
            "delay": [
                [40.0, 40.0, 40.0],
                [30.0, 40.0, 50.0],
                [20.0, 40.0, 60.0],
                [10.0, 40.0, 70.0],
                [20.0, 50.0, 70.0],
            ],
            "noise_std": [[1.0, 0.1, 0.1], [0.1, 0.01, 0.01]],
        },
    ),
    "unknown-input": Study(
        name="unknown-input",
        scenarios=["arm/sampled"],
        seeds=256,
        axes={
            "sampling_period": [0.001, 0.02, 0.2],
            "delay": [0.001, 0.02, 0.2],
            "noise_std": [1e-3, 3e-3],
            "drift": [0.0, 0.01, 0.05],
        },
    ),
    "helicopter": Study(
        name="helicopter",
        scenarios=["helicopter/constant"],
        observers=["high-gain", "high-gain-robust", "ekf"],
        seeds=256,
        axes={
            "sampling_period": [0.05, 0.2, 0.8],
            "delay": [0.01, 0.03],
            "noise_std": [5e-4, 2e-2],
            "drift": [0.0, 0.3],
        },
        options={"scenario": {"random_start": True}},
    ),
    "fair": Study(
        name="fair",
        scenarios=["cart/gaussian"],
        seeds=1024,
        options={"scenario": {"random_start": True}},
        tuning=list(TUNINGS),
        tune=Tune(objective="tail_pooled_rmse"),
    ),
    "all": Study(name="all", scenarios=list(SCENARIOS), seeds=256),
    "variable-sampling": Study(
        name="variable-sampling",
        scenarios=["cart/variable", "cart/variable-bias", "cart/variable-gain"],
        seeds=256,
        axes={"profile": ["sine", "uniform"], "jitter": [0.0, 0.04], "loss": [0.0, 0.2]},
    ),
}


def scenarios_of(study: Study, where: str | None = None) -> dict[str, Scenario]:
    """Return every scenario a study may name: the published ones, and `lti` where it brings a plant of its own."""
    return SCENARIOS if study.lti is None else SCENARIOS | {OWN: study.lti.scenario(OWN, f"{where or study.name}: lti")}


def labels_of(study: Study) -> list[str]:
    """Return what names an observer: its own name, or name-anything with options (study's or scenario's) under it."""
    given = [key for s in scenarios_of(study).values() if s.name in study.scenarios for key in s.options]
    return list(dict.fromkeys([*OBSERVERS, *(key for key in [*given, *study.options] if base_of(key) is not None)]))


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or scenarios_of(study)[scenario].observers)


def options_of(study: Study, scenario: Scenario, observer: str) -> BaseModel:
    """Return an observer's options, checked and complete: see `given`."""
    return checked_options(observer, given(study, scenario, observer), f"{study.name}: options.{observer}")


def given(study: Study, scenario: Scenario, observer: str) -> dict[str, Any]:
    """Return the options that are given: the scenario's, with the study's put over them, the label's own over its name's."""
    out: dict[str, Any] = {}
    for label in dict.fromkeys([base_of(observer) or observer, observer]):
        out |= dashes(dict(scenario.options.get(label, {}))) | dashes(study.options.get(label, {}))
    return out


def choices_of(study: Study) -> Choices:
    """Return the study's `[options.scenario]`."""
    return Choices.model_validate(dashes(study.options.get("scenario", {})))


def checked_options(name: str, given: dict[str, Any], where: str) -> BaseModel:
    """Return the options that a table holds for an observer's label, or for 'scenario'."""
    if name != "scenario" and base_of(name) is None:
        raise unknown(where, "observer with options (or 'scenario')", name, [*OBSERVERS, "scenario"])
    model = Choices if name == "scenario" else entry_of(name).options
    for key in dashes(given):
        if key not in model.model_fields:
            raise unknown(where, "key here", key, model.model_fields)
    underscored(given, where)
    for key, value in given.items():
        _of_sensible_size(value, f"{where}.{key}")
    try:
        options = model.model_validate(dashes(given))
    except ValidationError as error:
        raise sentence(where, error, model) from None
    if isinstance(options, Choices):
        for key, signal, valid in (("input", options.input, SIGNALS), ("unknown_input", options.unknown_input, SINGLE)):
            if signal is not None and signal not in valid:
                raise unknown(f"{where}.{key}", "input", signal, valid)
        if options.path is not None and options.path not in PATHS:
            raise unknown(f"{where}.path", "path", options.path, PATHS)
        if options.random_start and options.start_spread:
            raise UserError(f"{where}: got random_start and start_spread, expected one of them; leave the other out.")
    return options


def dashes(given: dict[str, Any]) -> dict[str, Any]:
    """Return a table with keys as Python names them."""
    return {key.replace("-", "_"): value for key, value in given.items()}


def underscored(given: dict[str, Any], where: str, but: str = "\n") -> dict[str, Any]:
    """Return a table with keys as Python names them, but for those that begin so; raise UserError for one given twice."""
    out = {key if key.startswith(but) else key.replace("-", "_"): value for key, value in given.items()}
    if len(out) < len(given):
        twice = next(key for key in given if "-" in key and key.replace("-", "_") in given)
        raise UserError(f"{where}: got {twice} twice, with - and with _, expected it once; remove one.")
    return out


def _of_sensible_size(value: Any, where: str) -> None:
    """Raise UserError where a number, or one in a list, is so large or so small that its square is of no use."""
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else []
    for each in inside:
        _of_sensible_size(each, where)
    if not isinstance(value, int | float) or value != value:
        return
    if LEAST <= abs(value) <= axes.LARGEST or value == 0:
        return
    raise UserError(
        f"{where}: got {shown(value)}, expected 0 or a number of {LEAST:g} to {axes.LARGEST:g} in size; write SI units."
    )


def sentence(where: str, error: ValidationError, model: type[BaseModel]) -> UserError:
    """The first of pydantic's findings as a sentence; of a value that may be of several kinds, the one that comes nearest."""
    findings = sorted(
        error.errors(), key=lambda each: each["type"] != "extra_forbidden"
    )  # a name that is none explains others
    loc, kind = findings[0]["loc"], findings[0]["type"]
    place = _place(loc)
    if kind == "extra_forbidden":
        inside = ".".join(str(part) for part in loc[:-1])
        names = (Lti if inside == "lti" else model).model_fields
        return unknown(f"{where}: {inside}" if inside else where, "key here", str(loc[-1]), names)
    if kind == "missing":
        return UserError(f"{where}: {place} is missing; write {loc[-1]} = ...")
    same = [each for each in findings if each["loc"][:1] == loc[:1] and _place(each["loc"]).startswith(place)]
    deepest = max(len(_place(each["loc"])) for each in same)
    near = [each for each in same if len(_place(each["loc"])) == deepest]
    expected = " or ".join(dict.fromkeys(_expected(each["msg"]) for each in near))
    place = _place(near[0]["loc"])
    return UserError(f"{where}: {place + ': ' if place else ''}got {shown(near[0]['input'])}, expected {expected}.")


def _place(loc: tuple[int | str, ...]) -> str:
    """Where pydantic found something, as TOML writes it; without its names for the kinds that a value may be of."""
    parts = [part for i, part in enumerate(loc) if not i or not _is_kind(str(part))]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{short(part)}" for part in parts).removeprefix(".")


def _is_kind(part: str) -> bool:
    return part.rstrip("]").endswith(KINDS) or part.startswith("literal[")


def _expected(message: str) -> str:
    """Pydantic's message as what was expected."""
    text = message.removeprefix("Value error, ").removeprefix("Input should be ")
    text = text.replace("dictionary", "table").replace("table or instance of Lti", "table")
    text = text.replace("String should", "a string that should").replace("List should", "a list that should")
    return (text[0].lower() + text[1:]).rstrip(".")
