"""A plant of one's own as observers know it, with its named numbers, and in what it differs from that (`[lti.plant]`).

The numbers of a study's `[lti]` table: their types, and whether matrices, vectors and names fit together.
"""

import re
from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationInfo

from pcbench.dynamics import expression
from pcbench.errors import UserError, short, shown, unknown
from pcbench.plants import numbers_of, varied
from pcbench.plants.lti import MATRICES, Numbers, actual
from pcbench.scenarios import Scenario
from pcbench.signal_names import names_and_units
from pcbench.study import axes
from pcbench.study.times import whole

LEAST = 1e-100  # a number is 0 or at least this, so that its square is not 0
# powers of ten by which a plant may grow over its horizon, so that powers of its map, up to the eighth, stay finite
GROWTH = 30
MOST = 50  # states, inputs, outputs or unknown inputs


def _told_from_zero(number: float) -> float:
    if 0 < abs(number) < LEAST:
        raise ValueError(f"0 or a number of at least {LEAST:g} in size")
    return number


Bounded = Annotated[float, Strict(), Field(ge=-axes.LARGEST, le=axes.LARGEST)]  # Strict: no text, no true or false
Number = Annotated[Bounded, AfterValidator(_told_from_zero)]
Positive = Annotated[Number, Field(ge=axes.SMALLEST)]
Size = Annotated[Number, Field(ge=0)]


def _formula(text: str) -> str:
    """A formula as it stands; raise ValueError, which says what is expected, where it is none."""
    expression.parsed(text)
    return text


def _rows(given: Any, info: ValidationInfo) -> Any:
    """Refuse a flat list of numbers, saying how it is written as a matrix: a column for each input, a row for each output."""
    if isinstance(given, list) and given and not any(isinstance(each, list) for each in given):
        rows = [[each] for each in given] if info.field_name in ("B", "E") else [given]
        raise ValueError(f"a list of rows; write {rows}")
    return given


NumberRows = Annotated[list[list[Number]], BeforeValidator(_rows)]
Rows = Annotated[list[list[Number | Annotated[str, AfterValidator(_formula)]]], BeforeValidator(_rows)]
PerChannel = Number | list[Number]
PerState = Size | list[Size]


class Matrices(Protocol):
    """What has the matrices of a plant, as rows."""

    A: Any
    B: Any
    C: Any
    D: Any
    E: Any


def dimensions(lti: Matrices, where: str) -> tuple[int, int, int]:
    """Return n, m, q; raise UserError naming the matrix whose shape does not fit."""
    n, m, q, r = len(lti.A), len((lti.B or [[]])[0]), len(lti.C), len((lti.E or [[]])[0])
    shapes = {"A": (n, n), "B": (n, m), "C": (q, n), "D": (q, m), "E": (n, max(r, 1))}
    if max(n, m, q, r) > MOST:
        raise UserError(
            f"{where}: got {n} states, {m} inputs, {q} outputs and {r} unknown inputs, expected at most {MOST} of each; reduce "
            "the model."
        )
    for name, shape in shapes.items():
        rows = getattr(lti, name)
        if rows is None:
            continue
        lengths = [len(row) for row in rows]
        widths = sorted(set(lengths)) or [0]
        if 0 in shape or len(rows) != shape[0] or widths != [shape[1]]:
            got = f"{len(rows)} x {widths[0]}" if len(widths) == 1 else f"rows of lengths {shown(lengths)}"
            raise UserError(
                f"{where}.{name}: got {got}, expected {max(shape[0], 1)} x {max(shape[1], 1)} ({n} states, {m} inputs, "
                f"{q} outputs" + (f", {r} unknown inputs)." if lti.E is not None else ").")
            )
    return n, m, q


def require_slow(A: Any, discrete: bool, ticks: int, tick: float, where: str) -> None:
    """Raise UserError where the plant grows so much over its horizon that its map cannot be computed."""
    modes = np.linalg.eigvals(np.array(A, float))
    rate = float(np.log10(max(np.abs(modes).max(), LEAST)) if discrete else modes.real.max() * tick / np.log(10))
    if rate * ticks > GROWTH:
        raise UserError(
            f"{where}.A: got a plant that grows by 1e{rate * ticks:.0f} over the duration of {ticks * tick:g} s, expected "
            f"at most 1e{GROWTH}; shorten the horizon to {GROWTH / rate * tick:.2g} s."
        )


def vector(given: float | list[float] | None, default: Any, n: int, where: str, what: str = "state") -> list[float]:
    """Return a number for each of n things: the default where nothing is given, one number for all of them."""
    if isinstance(given, int | float):
        return [float(given)] * n
    if given is None:
        return list(np.broadcast_to(np.asarray(default, float), n))
    if len(given) != n:
        raise UserError(f"{where}: got {len(given)} numbers, expected {n}, one for each {what}.")
    return given


def signals(states: list[str] | None, n: int, where: str) -> tuple[tuple[str, str], ...]:
    """Return state names and units from texts such as "angle [rad]"."""
    if states is None:
        return tuple((f"x{i + 1}", "1") for i in range(n))
    if len(states) != n:
        raise UserError(f"{where}: got {len(states)} names, expected {n}, one for each state.")
    return names_and_units(states, where)


TAKEN = {*Numbers._fields, "own", "x0"}  # what no named number can be called


class Differing(BaseModel):
    """`[lti.plant]`: what is true of the plant and told to no observer; besides the matrices any of the named numbers."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    __pydantic_extra__: dict[str, Number]
    A: Rows | None = Field(None, description="[n, n]")
    B: Rows | None = Field(None, description="[n, m]")
    C: Rows | None = Field(None, description="[q, n]")
    D: Rows | None = Field(None, description="[q, m]")
    E: Rows | None = Field(None, description="[n, r]")

    def given(self) -> dict[str, Any]:
        """Return what it says, by letter and by name."""
        return self.model_dump(exclude_none=True)


class Described(Protocol):
    """What has the matrices of a plant as rows, with named numbers and what is true of the plant."""

    dt: float | None
    parameters: dict[str, float] | None
    plant: Differing | None


def known(lti: Described, where: str) -> Numbers:
    """Return the plant's numbers as observers know them.

    Raises UserError where a formula names what is no parameter or has no value, or a parameter enters no matrix.
    """
    own, rows = lti.parameters or {}, {letter: getattr(lti, letter) for letter in MATRICES}
    for name in own:
        if not re.fullmatch(r"[A-Za-z]\w*", name) or name in TAKEN:
            raise UserError(
                f"{where}.parameters: got a parameter called '{short(name)}', expected a name of letters and digits that the "
                "plant does not have yet; rename it."
            )
    given = lti.plant.given() if lti.plant else {}
    used = set[str]()
    for place, all_rows in (("", rows), (".plant", given)):
        for letter in MATRICES:
            used |= _names(all_rows.get(letter), own, f"{where}{place}.{letter}")
    for name in own:
        if name not in used:
            raise UserError(
                f"{where}.parameters: got {name}, which enters no matrix, expected one that does; write it into A, B, C, D or "
                "E, or leave it out."
            )
    values = {letter: _values(r, own, f"{where}.{letter}") for letter, r in rows.items()}
    written = {letter: r for letter, r in rows.items() if _formulas(r)}
    return Numbers(**values, discrete=lti.dt is not None, own=own, written=written)


def told(numbers: Numbers) -> dict[str, Any]:
    """Return what a scenario's belief says of the plant."""
    out = {letter: getattr(numbers, letter) for letter in MATRICES} | {"discrete": numbers.discrete}
    return out | ({"own": dict(numbers.own), "written": dict(numbers.written)} if numbers.own else {})


def differing(lti: Described, numbers: Numbers, where: str) -> dict[str, Any]:
    """Return in what the plant differs from the model: rows by letter, numbers by name; UserError for what does not fit."""
    if lti.plant is None:
        return {}
    given = lti.plant.given()
    if not given:
        raise UserError(f"{where}.plant: got an empty table, expected what differs; write A = ... or leave it out.")
    there = [letter for letter in MATRICES if letter == "D" or getattr(numbers, letter) is not None]
    for name, value in given.items():
        if name not in [*there, *numbers.own]:
            raise unknown(f"{where}.plant", "matrix or parameter of the plant", name, [*there, *numbers.own])
        if name in MATRICES:
            _same_shape(name, value, numbers, f"{where}.plant.{name}")
    return given


def require_plant(s: Scenario, parameters: dict[str, Any], where: str) -> None:
    """Raise UserError where a cell's plant has no finite matrices, or grows so fast that it cannot be computed."""
    numbers = varied(numbers_of(s), {"drift": s.truth.parameter_drift} | parameters)
    try:
        model = actual(numbers)
    except ValueError:
        raise UserError(
            f"{where}: got a plant with {_said(numbers.own)}, where a formula of a matrix has no finite value, expected "
            "numbers at which each has one; leave that value out."
        ) from None
    if numbers.own or numbers.plant:
        require_slow(model.A, model.discrete, whole(s.duration, s), s.dt, f"{where}: the plant's matrix lti")


def _same_shape(letter: str, rows: list[list[Any]], numbers: Numbers, where: str) -> None:
    want = (len(numbers.C), len(numbers.B[0])) if letter == "D" else np.shape(getattr(numbers, letter))
    if len(rows) != want[0] or any(len(row) != want[1] for row in rows):
        raise UserError(
            f"{where}: got {len(rows)} rows of {', '.join(map(str, sorted({len(row) for row in rows})))} numbers, expected "
            f"{want[0]} x {want[1]}, as the model's."
        )


def _formulas(rows: Any) -> list[tuple[int, int, str]]:
    """The entries of a matrix that are formulas, with their places."""
    return [(i, j, v) for i, row in enumerate(rows or []) for j, v in enumerate(row) if isinstance(v, str)]


def _names(rows: Any, own: dict[str, float], where: str) -> set[str]:
    """The named numbers in a matrix; raise UserError for a name that is none of them."""
    used = set[str]()
    for i, j, text in _formulas(rows):
        for name in sorted(expression.names(expression.parsed(text))):
            if not own:
                raise UserError(
                    f"{where}[{i}][{j}]: got '{short(text)}', expected a number, or a table [lti.parameters] with {name}."
                )
            if name not in own:
                raise unknown(f"{where}[{i}][{j}]", "parameter of lti", name, own)
            used.add(name)
    return used


def _values(rows: Any, own: dict[str, float], where: str) -> Any:
    """Rows with a number in place of every formula; None of None."""
    if rows is None:
        return None
    out = [list(row) for row in rows]
    for i, j, text in _formulas(rows):
        try:
            out[i][j] = expression.value(expression.parsed(text), own)
        except ValueError:
            raise UserError(
                f"{where}[{i}][{j}]: got '{short(text)}', expected a finite number at {_said(own) or 'all times'}; mend the "
                "formula or its parameters."
            ) from None
    return out


def _said(own: Any) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in own.items())
