"""The keys of a study's tables `[scenario]` and `[lti]`.

Keys of both tables are declared once: the axes in `pcbench.fields`, the other keys in `Experiment`.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationInfo, create_model

from pcbench import fields
from pcbench.errors import printable
from pcbench.study import axes
from pcbench.toml_text import TomlTable

LEAST = 1e-100  # a number is 0 or at least this, so that its square does not underflow


def _zero_or_not_tiny(number: float) -> float:
    if 0 < abs(number) < LEAST:
        raise ValueError(f"0 or a number of at least {LEAST:g} in size")
    return number


def rows_only(value: object, info: ValidationInfo) -> object:
    """Reject a flat list of numbers, with the matrix form to use: a column for each input, a row for each output."""
    if isinstance(value, list) and value and not any(isinstance(v, list) for v in value):
        rows = [[v] for v in value] if info.field_name in ("B", "E") else [value]
        raise ValueError(f"a list of rows; write {rows}")
    return value


NumberOrInf = Annotated[float, Strict(), Field(allow_inf_nan=True)]  # inf: no limit
# Strict: no text, no boolean
Number = Annotated[float, Strict(), Field(ge=-axes.LARGEST, le=axes.LARGEST), AfterValidator(_zero_or_not_tiny)]
Positive = Annotated[
    float, Strict(), Field(le=axes.LARGEST), AfterValidator(_zero_or_not_tiny), Field(ge=axes.SMALLEST)
]
Size = Annotated[float, Strict(), Field(ge=0, le=axes.LARGEST), AfterValidator(_zero_or_not_tiny)]
NumberRows = Annotated[list[list[Number]], BeforeValidator(rows_only)]
Switch = Annotated[bool, Strict()]
Words = Annotated[str, AfterValidator(printable)]

M = TypeVar("M", bound=BaseModel)


def value_type(field: fields.Field) -> Any:
    """Return the type of a field's value in a table; `axes.axis_value` checks its range."""
    if field.word == "inf":
        return NumberOrInf
    if field.word == "lost":
        return list[Number | Literal["lost"]]
    if field.listed:
        numbers = list[Number] | list[list[Number]] if field.rows else list[Number]
        return str | numbers if field.word else numbers
    if field.per == "state":
        return Size | list[Size]
    numeric = Number | list[Number] if field.per else Number
    if field.rows:
        return numeric | list[list[Number]]
    return numeric | str if field.word else numeric


def takes_axes(
    required: Sequence[str] = (), without: Sequence[str] = (), defaults: Mapping[str, object] = MappingProxyType({})
) -> Callable[[type[M]], type[M]]:
    """Return a class decorator that adds a key for each field of `fields.FIELDS`.

    A key that a table omits is None, unless it is `required` or has one of the `defaults`. Fields in `without` have no key.
    """

    def with_keys(table: type[M]) -> type[M]:
        keys: TomlTable = {}
        for name, value in defaults.items():
            keys[name] = table.model_fields[name].annotation, copy(table.model_fields[name])
            keys[name][1].default = value
        for f in fields.FIELDS:
            description = f.meaning if f.unit in ("", "1") else f"[{f.unit}] {f.meaning}"
            if f.name in required:
                keys[f.name] = value_type(f), Field(description=description)
            elif f.name not in without:
                keys[f.name] = value_type(f) | None, Field(None, description=description)
        model: type[M] = create_model(
            table.__name__, __base__=table, __module__=table.__module__, __doc__=table.__doc__, **keys
        )
        model.__annotations__ = {}  # the API reference reads fields from the text of the class
        return model

    return with_keys


class Experiment(BaseModel):
    """The keys of both tables that are no axes. A key that is left out has its default.

    One number instead of a list holds for all states, unknowns or outputs.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    noise_correlation: NumberRows | None = Field(
        None, description="[q, q] correlation of the channels' noise; default: independent"
    )
    assumed_process_std: Size | list[Size] | NumberRows | None = Field(
        None,
        description="[n] process noise that designs assume [unit of the state], or [n, n] a root of the covariance of a tick; "
        "default: process_std",
    )
    input: object = Field(None, description="input of an open loop, as below; default: sine")
    unknown_input: object = Field(None, description="unknown input, in the same forms")
    unknown_std: Positive | list[Positive] | None = Field(
        None, description="typical size of each unknown input or parameter; default: 1"
    )
    x0: Number | list[Number] | None = Field(None, description="[n] true initial state")
    xhat0: Number | list[Number] | None = Field(None, description="[n] initial estimate; default: 0")
    prior_std: Size | list[Size] | None = Field(
        None,
        description="[n] standard deviation of x(0) about xhat(0); default: |x0 - xhat0|, and 1 for a state where this is 0",
    )
    settle_band: Size | list[Size] | None = Field(
        None, description="largest |e| of a settled run, one per signal; default: 5 % of prior_std"
    )
    divergence_threshold: Positive | list[Positive] | None = Field(
        None, description="a run whose |e| exceeds it has diverged; one number, or one per signal"
    )
    duration: Positive | None = Field(None, description="duration of a run [s]; default: 10")
    steady_start: Size | None = Field(
        None, description="start of the steady_* metrics [s]; default: 30 % of the duration"
    )
    observers: list[str] | None = Field(None, min_length=1, description="observers, if the study names none")

    def as_table(self) -> TomlTable:
        """Return the fields of the scenario that the table sets."""
        values = {key: getattr(self, key) for key in type(self).model_fields if key not in ("base", "name")}
        return {key: value for key, value in values.items() if value is not None}


@takes_axes(without=("process_std",))
class ScenarioTable(Experiment):
    """Your own scenario, or `base` with some fields changed; other keys have the value of the base, or their default."""

    base: str | None = Field(None, description="built-in scenario that the other keys change")
    name: str | None = Field(
        None, pattern=r"^\w[\w./+-]*$", max_length=100, description="name in tables; default: the name of the study"
    )
    summary: Words | None = Field(None, description="description in a few words")
    source: Words | None = Field(None, description="paper and section")
    plant: str | None = Field(None, description="name of a plant (pcbench list plants), or MODULE:NAME")
    dt: Positive | None = Field(None, description="duration of a tick [s]; default: 0.001")
    # true values, which observers do not use
    process_std: Size | list[Size] | NumberRows | None = Field(
        None,
        description="standard deviation of the noise added to each state at every tick; a list if the states differ, or "
        "[n, n] a root of its covariance if the noises are correlated",
    )
    parameters: TomlTable | None = Field(None, description="true parameters of the plant that differ from its defaults")
    # input and controller
    controller: str | None = Field(None, description="control law of a closed loop; empty: open loop")
    control: TomlTable | None = Field(None, description="options of the control law")
    # measurement
    prefilled: Switch | None = Field(
        None, description="sampling begins before t = 0, so that the first sample arrives at t = 0"
    )
    delay_sine: list[Number] | None = Field(
        None, min_length=2, max_length=2, description="a [s] and w [rad/s] of a delay that varies as delay + a sin(w t)"
    )
    continuous: Switch | None = Field(None, description="continuous measurement, without noise or delay")
    # assumed values
    model: TomlTable | None = Field(
        None, description="parameters that observers assume, if they differ from the plant's defaults"
    )
    drift_intensity: Size | None = Field(
        None, description="process noise through the input that designs assume for a drifting plant [1/s]"
    )
    unknown0: Number | list[Number] | None = Field(
        None, description="initial estimate of each unknown input or parameter; default: 0"
    )
    assumed_noise_std: Size | list[Size] | None = Field(
        None, description="[q] noise that designs assume for channels without noise"
    )
    initial_box: Size | list[Size] | None = Field(
        None, description="[n] largest distance of a random xhat(0) from x(0)"
    )
    # scoring
    signals: list[str] | None = Field(None, description='[n] names of states with units, such as "angle [rad]"')
    unknowns: list[str] | None = Field(None, description="names of unknown inputs or parameters with units")
    headline: list[str] | None = Field(None, description="signals of the closing table")
    options: dict[str, TomlTable] | None = Field(None, description="options by observer or label")
