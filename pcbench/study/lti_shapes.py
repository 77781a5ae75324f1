"""The numbers of a study's `[lti]` table: their types, and whether matrices, vectors and names fit together."""

from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, Strict, ValidationInfo

from pcbench.dynamics import expression
from pcbench.errors import UserError, shown
from pcbench.signal_names import names_and_units
from pcbench.study import axes

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
