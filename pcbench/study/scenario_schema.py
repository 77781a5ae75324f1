"""What a study's tables `[scenario]` and `[lti]` may say: every field of a scenario, spelled flat.

What both may say is declared once: the axes in `pcbench.fields`, the other keys in `Experiment`.
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

LEAST = 1e-100  # a number is 0 or at least this, so that its square is not 0


def _zero_or_not_tiny(number: float) -> float:
    if 0 < abs(number) < LEAST:
        raise ValueError(f"0 or a number of at least {LEAST:g} in size")
    return number


def rows_only(given: object, info: ValidationInfo) -> object:
    """Refuse a flat list of numbers, saying how it is written as a matrix: a column for each input, a row for each output."""
    if isinstance(given, list) and given and not any(isinstance(each, list) for each in given):
        rows = [[each] for each in given] if info.field_name in ("B", "E") else [given]
        raise ValueError(f"a list of rows; write {rows}")
    return given


Degrees = Annotated[float, Strict(), Field(allow_inf_nan=True)]  # inf: without an end
# Strict: no text, no true or false
Number = Annotated[float, Strict(), Field(ge=-axes.LARGEST, le=axes.LARGEST), AfterValidator(_zero_or_not_tiny)]
Positive = Annotated[
    float, Strict(), Field(le=axes.LARGEST), AfterValidator(_zero_or_not_tiny), Field(ge=axes.SMALLEST)
]
Size = Annotated[float, Strict(), Field(ge=0, le=axes.LARGEST), AfterValidator(_zero_or_not_tiny)]
NumberRows = Annotated[list[list[Number]], BeforeValidator(rows_only)]
Switch = Annotated[bool, Strict()]
Words = Annotated[str, AfterValidator(printable)]

M = TypeVar("M", bound=BaseModel)


def kind(field: fields.Field) -> Any:
    """Return the type of a field's value in a table; its range is checked by `axes.point`."""
    if field.word == "inf":
        return Degrees
    if field.word == "lost":
        return list[Number | Literal["lost"]]
    if field.listed:
        return str | list[Number] if field.word else list[Number]
    if field.per == "state":
        return Size | list[Size]
    one_or_each = Number | list[Number] if field.per else Number
    return one_or_each | str if field.word else one_or_each


def takes_axes(
    required: Sequence[str] = (), without: Sequence[str] = (), defaults: Mapping[str, object] = MappingProxyType({})
) -> Callable[[type[M]], type[M]]:
    """Return a class decorator that adds a key for each field of `fields.FIELDS`, as its record there says.

    What a table leaves out is None, but what is `required`, or has one of the `defaults`; `without`: these it does not have.
    """

    def with_keys(table: type[M]) -> type[M]:
        keys: TomlTable = {}
        for name, value in defaults.items():
            keys[name] = table.model_fields[name].annotation, copy(table.model_fields[name])
            keys[name][1].default = value
        for f in fields.FIELDS:
            about = f.meaning if f.unit in ("", "1") else f"{f.unit}, {f.meaning}"
            if f.name in required:
                keys[f.name] = kind(f), Field(description=about)
            elif f.name not in without:
                keys[f.name] = kind(f) | None, Field(None, description=about)
        made: type[M] = create_model(
            table.__name__, __base__=table, __module__=table.__module__, __doc__=table.__doc__, **keys
        )
        made.__annotations__ = {}  # the API reference looks for fields in the text of the class
        return made

    return with_keys


class Experiment(BaseModel):
    """The keys of both tables that are no axes. n states, s unknowns, q outputs; what is left out has a default.

    One number in place of a list holds for all of them.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    noise_correlation: NumberRows | None = Field(
        None, description="[q][q] between the channels' noise; default: they are independent"
    )
    assumed_process_std: Size | list[Size] | None = Field(None, description="[n] instead of the plant's process noise")
    input: object = Field(
        None,
        description="a signal's name, or one for each input, with commas; or a wave, values, rows, a CSV file; default: sine",
    )
    unknown_input: object = Field(None, description="of what pushes: as `input` says it")
    unknown_std: Positive | list[Positive] | None = Field(
        None, description="[s] typical size of the unknowns; default: ones"
    )
    x0: Number | list[Number] | None = Field(None, description="[n] x(0)")
    xhat0: Number | list[Number] | None = Field(None, description="[n] xhat(0); default: zeros")
    prior_std: Size | list[Size] | None = Field(
        None, description="[n] of x(0) about xhat(0); default: |x0 - xhat0|, or 1"
    )
    settle_band: Size | list[Size] | None = Field(
        None, description="for each signal, |e| of a settled run; default: 5 % of the prior"
    )
    divergence_threshold: Positive | list[Positive] | None = Field(
        None, description="a run has diverged when an |e| leaves it"
    )
    duration: Positive | None = Field(None, description="s; default 10")
    steady_start: Size | None = Field(None, description="s, where the tail starts; default: 30 % of the horizon")
    observers: list[str] | None = Field(None, min_length=1, description="those that run unless a study names others")

    def given(self) -> TomlTable:
        """Return what the table says of the scenario's fields."""
        said = {key: getattr(self, key) for key in type(self).model_fields if key not in ("base", "name")}
        return {key: value for key, value in said.items() if value is not None}


@takes_axes()
class ScenarioTable(Experiment):
    """A scenario of a user's own, or `base` with some fields changed; what is left out is the base's, or a default."""

    base: str | None = Field(None, description="a published scenario, of which the other keys change fields")
    name: str | None = Field(
        None, pattern=r"^\w[\w./+-]*$", max_length=100, description="what tables call it; default: the study's name"
    )
    summary: Words | None = Field(None, description="in a few words")
    source: Words | None = Field(None, description="paper and section")
    plant: str | None = Field(None, description="pcbench list plants")
    dt: Positive | None = Field(None, description="s, the tick; default 0.001")
    # what is true of the plant and told to no observer
    parameters: TomlTable | None = Field(None, description="the plant's, where they differ from its own")
    # what drives the plant
    controller: str | None = Field(None, description="what gives the commands of a closed loop; empty: it is open")
    control: TomlTable | None = Field(None, description="the controller's options")
    # how it is measured
    prefilled: Switch | None = Field(None, description="measuring began before t = 0: the first sample arrives at 0")
    delay_sine: list[Number] | None = Field(
        None, min_length=2, max_length=2, description="(a [s], w [rad/s]): every delay is delay + a sin(w t)"
    )
    continuous: Switch | None = Field(None, description="measured at every stage of the integration, without noise")
    # what designers and observers assume
    model: TomlTable | None = Field(None, description="the plant's parameters as observers know them")
    drift_intensity: Size | None = Field(None, description="1/s, process noise through the input where it drifts")
    unknown0: Number | list[Number] | None = Field(
        None, description="[s] what observers take for the unknowns at the start"
    )
    assumed_noise_std: Size | list[Size] | None = Field(None, description="[q] for channels without noise")
    initial_box: Size | list[Size] | None = Field(
        None, description="[n] a random start draws xhat(0) this close to x(0)"
    )
    # what runs are judged by
    signals: list[str] | None = Field(None, description='[n] names of states with units, such as "angle [rad]"')
    unknowns: list[str] | None = Field(None, description="[s] names of unknowns with units")
    headline: list[str] | None = Field(None, description="signals that a closing table shows")
    options: dict[str, TomlTable] | None = Field(None, description="of observers, by label")
