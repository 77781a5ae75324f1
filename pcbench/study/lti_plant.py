"""A plant of one's own as observers know it, with its named numbers, and in what it differs from that (`[lti.plant]`)."""

import re
from typing import Any, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pcbench.dynamics import expression
from pcbench.errors import UserError, short, unknown
from pcbench.plants import numbers_of, varied
from pcbench.plants.lti import MATRICES, Numbers, actual
from pcbench.scenarios import Scenario
from pcbench.study.lti_shapes import Number, Rows, require_slow
from pcbench.study.times import whole

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
