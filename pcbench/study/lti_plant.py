"""The matrices of a study's table `[lti]`: the assumed plant, and the true values that differ from it (`[lti.plant]`).

The module checks that matrices, named numbers and formulas fit together.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from pcbench import expression
from pcbench.errors import UserError, brief_repr, short, unknown
from pcbench.plants import numbers_of, replace_numbers
from pcbench.plants.lti import MATRICES, Numbers, actual
from pcbench.scenarios import Scenario
from pcbench.study.scenario_schema import LEAST, Number, NumberRows, Positive, Size, rows_only
from pcbench.study.times import to_ticks
from pcbench.toml_text import TomlTable

# powers of ten by which a plant may grow over the run, so that powers of its map, up to the eighth, stay finite
GROWTH = 30
MAX_SIZE = 50  # limit for states, inputs, outputs and unknown inputs
RESERVED = {*Numbers._fields, "own", "x0"}  # names that a parameter cannot have


def _formula(text: str) -> str:
    """Return a formula unchanged; raise ValueError with the expected form if it is invalid."""
    expression.parse_formula(text)
    return text


Rows = Annotated[list[list[Number | Annotated[str, AfterValidator(_formula)]]], BeforeValidator(rows_only)]
Intensity = Size | list[Size] | list[list[Number]]


class PlantDeviations(BaseModel):
    """`[lti.plant]`: true values that the design does not use: any of the matrices or of the named numbers."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    __pydantic_extra__: dict[str, Number]
    A: Rows | None = Field(None, description="[n, n]")
    B: Rows | None = Field(None, description="[n, m]")
    C: Rows | None = Field(None, description="[q, n]")
    D: Rows | None = Field(None, description="[q, m]")
    E: Rows | None = Field(None, description="[n, r]")

    def as_table(self) -> TomlTable:
        """Return the given values by letter and by name."""
        return self.model_dump(exclude_none=True)


class LtiTable(BaseModel):
    """The keys of `[lti]` that are no axes. n states, m inputs, q outputs; r unknown inputs."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    parameters: dict[str, Number] | None = Field(
        None, description='numbers by name; entries of A to E may be formulas of them, such as "-k/m"'
    )
    plant: PlantDeviations | None = Field(
        None, description="true values that differ from the assumed ones: any of A to E, or of the parameters"
    )
    A: Rows = Field(description="[n, n]")
    B: Rows = Field(description="[n, m]")
    C: Rows = Field(description="[q, n]")
    D: Rows | None = Field(None, description="[q, m] direct feedthrough; default: 0")
    E: Rows | None = Field(None, description="[n, r] matrix of an unknown input; default: no unknown input")
    dt: Positive | None = Field(None, description="tick of a discrete plant [s]; default: the plant is continuous")
    tick: Positive | None = Field(None, description="tick of the simulation [s]; default: 0.001, or dt")
    states: list[str] | None = Field(None, description='[n] names of states with units, such as "angle [rad]"')
    G: NumberRows | None = Field(None, description="[n, g] matrix of the process noise; default: identity")
    QN: Intensity | None = Field(
        None,
        description="intensity of the process noise [1/s], with dt its covariance per tick: one number, g numbers, or [g, g]",
    )


def dimensions(lti: "LtiTable", where: str) -> tuple[int, int, int]:
    """Return n, m, q; raise UserError with the matrix whose shape does not fit."""
    n, m, q, r = len(lti.A), len((lti.B or [[]])[0]), len(lti.C), len((lti.E or [[]])[0])
    shapes = {"A": (n, n), "B": (n, m), "C": (q, n), "D": (q, m), "E": (n, max(r, 1))}
    if max(n, m, q, r) > MAX_SIZE:
        raise UserError(
            f"{where}: got {n} states, {m} inputs, {q} outputs and {r} unknown inputs, expected at most {MAX_SIZE} of each; "
            "reduce the model."
        )
    for name, shape in shapes.items():
        rows = getattr(lti, name)
        if rows is None:
            continue
        lengths = [len(row) for row in rows]
        widths = sorted(set(lengths)) or [0]
        if 0 in shape or len(rows) != shape[0] or widths != [shape[1]]:
            got = f"{len(rows)} x {widths[0]}" if len(widths) == 1 else f"rows of lengths {brief_repr(lengths)}"
            raise UserError(
                f"{where}.{name}: got {got}, expected {max(shape[0], 1)} x {max(shape[1], 1)} ({n} states, {m} inputs, "
                f"{q} outputs" + (f", {r} unknown inputs)." if lti.E is not None else ").")
            )
    return n, m, q


def require_slow(A: ArrayLike, discrete: bool, ticks: int, tick: float, where: str) -> None:
    """Raise UserError if the plant grows too much over the run for its map to be computed."""
    modes = np.linalg.eigvals(np.array(A, float))
    rate = float(np.log10(max(np.abs(modes).max(), LEAST)) if discrete else modes.real.max() * tick / np.log(10))
    if rate * ticks > GROWTH:
        raise UserError(
            f"{where}.A: got a plant that grows by 1e{rate * ticks:.0f} over the duration of {ticks * tick:g} s, expected "
            f"at most 1e{GROWTH}; shorten the duration to {GROWTH / rate * tick:.2g} s."
        )


def nominal_numbers(lti: LtiTable, where: str) -> Numbers:
    """Return the plant's parameters as assumed by observers.

    Raises UserError if a formula has an unknown name or no value, or if a parameter enters no matrix.
    """
    parameters, rows = lti.parameters or {}, {letter: getattr(lti, letter) for letter in MATRICES}
    for name in parameters:
        if not re.fullmatch(r"[A-Za-z]\w*", name) or name in RESERVED:
            raise UserError(
                f"{where}.parameters: got a parameter called '{short(name)}', expected a name of letters and digits that the "
                "plant does not have yet; rename it."
            )
    deviations, names = lti.plant.as_table() if lti.plant else {}, set[str]()
    formulas = [(f"{where}.{letter}", text) for letter in MATRICES for text in _formulas(rows[letter])]
    formulas += [(f"{where}.plant.{letter}", text) for letter in MATRICES for text in _formulas(deviations.get(letter))]
    for place, (i, j, text) in formulas:
        for name in sorted(expression.names(expression.parse_formula(text))):
            if not parameters:
                raise UserError(
                    f"{place}[{i}][{j}]: got '{short(text)}', expected a number, or a table [lti.parameters] with {name}."
                )
            if name not in parameters:
                raise unknown(f"{place}[{i}][{j}]", "parameter of lti", name, parameters)
            names.add(name)
    for name in parameters:
        if name not in names:
            raise UserError(
                f"{where}.parameters: got {name}, which enters no matrix, expected one that does; write it into A, B, C, D or "
                "E, or leave it out."
            )
    values: TomlTable = {letter: None if r is None else [list(row) for row in r] for letter, r in rows.items()}
    for letter, numbers in values.items():
        for i, j, text in _formulas(rows[letter]):
            try:
                numbers[i][j] = expression.value(expression.parse_formula(text), parameters)
            except ValueError:
                raise UserError(
                    f"{where}.{letter}[{i}][{j}]: got '{short(text)}', expected a finite number at "
                    f"{_named_values(parameters) or 'all times'}; correct the formula or its parameters."
                ) from None
    formula_rows = {letter: r for letter, r in rows.items() if _formulas(r)}
    return Numbers(**values, discrete=lti.dt is not None, parameters=parameters, formulas=formula_rows)


def plant_deviations(lti: LtiTable, numbers: Numbers, where: str) -> TomlTable:
    """Return the true values that differ from the model: rows by letter, numbers by name; raise UserError for invalid ones."""
    if lti.plant is None:
        return {}
    deviations = lti.plant.as_table()
    if not deviations:
        raise UserError(f"{where}.plant: got an empty table, expected what differs; write A = ... or leave it out.")
    letters = [letter for letter in MATRICES if letter == "D" or getattr(numbers, letter) is not None]
    for name, rows in deviations.items():
        if name not in [*letters, *numbers.parameters]:
            raise unknown(f"{where}.plant", "matrix or parameter of the plant", name, [*letters, *numbers.parameters])
        if name not in MATRICES:
            continue
        shape = (len(numbers.C), len(numbers.B[0])) if name == "D" else np.shape(getattr(numbers, name))
        widths = sorted({len(row) for row in rows})
        if len(rows) != shape[0] or any(width != shape[1] for width in widths):
            raise UserError(
                f"{where}.plant.{name}: got {len(rows)} rows of {', '.join(map(str, widths))} numbers, expected {shape[0]} x "
                f"{shape[1]}, as the model's."
            )
    return deviations


def require_plant(s: Scenario, parameters: TomlTable, where: str) -> None:
    """Raise UserError if a grid point's plant has no finite matrices, or grows too fast to be computed."""
    numbers = replace_numbers(numbers_of(s), {"drift": s.truth.parameter_drift} | parameters)
    try:
        model = actual(numbers)
    except ValueError:
        raise UserError(
            f"{where}: got a plant with {_named_values(numbers.parameters)}, where a formula of a matrix has no finite value, "
            "expected numbers at which each has one; leave that value out."
        ) from None
    if numbers.parameters or numbers.plant:
        require_slow(model.A, model.discrete, to_ticks(s.duration, s), s.dt, f"{where}: the plant's matrix lti")


def _formulas(rows: Sequence[Sequence[float | str]] | None) -> list[tuple[int, int, str]]:
    """Return the entries of a matrix that are formulas, with their indices."""
    return [(i, j, v) for i, row in enumerate(rows or []) for j, v in enumerate(row) if isinstance(v, str)]


def _named_values(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
