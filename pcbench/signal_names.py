"""Names with units, such as "angle [rad]", validated in one place for files and functions.

A unit is printed in tables, figures, LaTeX and the comments of C, so it has few characters: letters, digits, spaces and
`^ * / % . - ( )`, with `°`, `µ`, `Ω`, `·`, `²` and `³`. After a `^` comes a number or a parenthesis, because `^^` is a code of
TeX. A unit contains neither `/*` nor `*/`, which delimit comments of C.
"""

import re
from collections.abc import Iterable

from pcbench.errors import UserError, short

LONGEST_NAME = 60  # characters
RESERVED = re.compile(
    r"t|[uy]\d+|sigma|scenario|cell|seed|tick"
)  # names of other columns of a trajectory, a recording or a table
LONGEST_UNIT = 40
LONGEST_TEXT = 200  # of a name with its unit and spaces
NAME = re.compile(r"[A-Za-z]\w*")
NAME_WITH_UNIT = re.compile(r"\s*([A-Za-z]\w*)\s*(?:\[([^\[\]]+)\])?\s*")
UNIT = re.compile(r"(?:[A-Za-z0-9 */%.()°µμΩ·²³-]|\^(?=-?\d|\())+")
COMMENTS = ("/*", "*/")


def unit(text: str, where: str) -> str:
    """Return a valid unit unchanged; raise UserError if it has other characters, or is too long."""
    if len(text) > LONGEST_UNIT or not UNIT.fullmatch(text) or any(mark in text for mark in COMMENTS):
        raise UserError(
            f"{where}: got the unit '{short(text)}', expected at most {LONGEST_UNIT} letters, digits and ^ * / % . - ( ), such "
            "as 'rad/s' or 'kg*m^2'; write another."
        )
    return text


def name_and_unit(text: str, where: str) -> tuple[str, str]:
    """Return the name and the unit of a text such as "angle [rad]", "1" if it has none; raise UserError for another text."""
    match = NAME_WITH_UNIT.fullmatch(text) if len(text) <= LONGEST_TEXT else None
    return pair(match[1] if match else text, (match[2] if match else "") or "1", where)


def pair(name: str, measured_in: str, where: str) -> tuple[str, str]:
    """Return a valid name and unit; raise UserError if either is invalid, or the name is that of another column."""
    if len(name) > LONGEST_NAME or not NAME.fullmatch(name):
        raise UserError(
            f"{where}: got '{short(name)}', expected a name with a unit, such as 'angle [rad]', of at most {LONGEST_NAME} "
            "letters and digits; write another."
        )
    if RESERVED.fullmatch(name):
        raise UserError(
            f"{where}: got the name '{name}', which another column of a trace or a recording has, expected another name; "
            f"write one such as '{name}_state'."
        )
    return name, unit(measured_in, where)


def names_and_units(texts: Iterable[str], where: str) -> tuple[tuple[str, str], ...]:
    """Return names and units; raise UserError for an invalid text, or a name that occurs twice."""
    pairs = tuple(name_and_unit(text, where) for text in texts)
    require_different([name for name, _ in pairs], where)
    return pairs


def require_different(names: list[str], where: str, remedy: str = "rename one") -> None:
    """Raise UserError for a name that occurs twice."""
    if len(set(names)) < len(names):
        duplicate = next(name for i, name in enumerate(names) if name in names[:i])
        raise UserError(f"{where}: got '{short(duplicate)}' twice, expected each name once; {remedy}.")
