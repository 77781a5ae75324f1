"""How all tables of pcbench look: a number is never cut; where a terminal is narrow, columns are left out, the least first.

What a program reads: arrays, complex numbers and tuples as JSON.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from pcbench.errors import printable


class Screen(Console):
    """A terminal that prints text as it is: no text of a study is markup, and what cannot be printed is its escape.

    What has a style is a `rich.text.Text`, or is printed with `style`.
    """

    def __init__(self, **given: Any):
        super().__init__(markup=False, emoji=False, **given)

    def render_str(self, text: str, **given: Any) -> Text:
        """Return a text with its own line breaks."""
        return super().render_str(printable(text, but="\n"), **given)


class Column(NamedTuple):
    """A column of a table that fits: it goes before those of a lower `spare`; one of 0 stays."""

    head: str
    cells: list[str]
    spare: int = 0
    left: bool = False  # text, not numbers
    bold: frozenset[int] = frozenset()  # numbers of the rows in which it is


def titled(title: str) -> Table:
    """Return an empty table with its title."""
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)


def printed(title: str, columns: list[Column], console: Console, sections: list[int] | None = None) -> list[str]:
    """Print a table as wide as the terminal at most, below its title; return the heads of the columns left out for it.

    `sections` are the numbers of rows between which a line stands.
    """
    shown, out = list(columns), []
    while width(table := _table(shown, sections), console) > console.width:
        spare = max(shown, key=lambda c: c.spare)
        if not spare.spare:
            break
        shown.remove(spare)
        out.append(spare.head.replace("\n", " "))
    console.print(title, style="italic", highlight=False, markup=False)
    console.print(table)
    return out[::-1]


def fits(columns: list[Column], console: Console) -> bool:
    """Say whether the columns that stay are no wider than the terminal."""
    return width(_table([c for c in columns if not c.spare], None), console) <= console.width


def _table(columns: list[Column], sections: list[int] | None) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column.head, justify="left" if column.left else "right", overflow="fold", no_wrap=True)
    rows = list(zip(*(_cells(c) for c in columns), strict=True))
    for many in sections or [len(rows)]:
        for row in rows[:many]:
            table.add_row(*row)
        table.add_section()
        rows = rows[many:]
    return table


def _cells(column: Column) -> list[str | Text]:
    cells = column.cells if column.left else aligned(column.cells)
    return [Text(printable(cell), "bold") if i in column.bold else cell for i, cell in enumerate(cells)]


def width(table: Table, console: Console) -> int:
    """Return the columns of the terminal that a table needs so that nothing of it is cut."""
    return Measurement.get(console, console.options.update_width(10_000), table).maximum


def aligned(cells: list[str], at: str = " ± ") -> list[str]:
    """Return numbers with their intervals aligned at the sign, so that both can be read down."""
    parts = [cell.partition(at) for cell in cells]
    left = max((len(a) for a, sign, _ in parts if sign), default=0)
    right = max((len(c) for _, sign, c in parts if sign), default=0)
    room = left + len(at) + right
    return [
        a.rjust(left) + sign + c.ljust(right) if sign else a.rjust(left).ljust(room) if right and len(a) <= left else a
        for a, sign, c in parts
    ]


def readable(content: Any) -> str:
    """Return arrays, complex numbers and tuples as readable JSON."""

    def plain(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return plain(value.tolist())
        if isinstance(value, complex):
            return {"real": value.real, "imag": value.imag}
        if isinstance(value, Mapping):
            return {str(k): plain(v) for k, v in value.items()}
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        if isinstance(value, float) and value != value:
            return None
        if value in (float("inf"), float("-inf")):
            return str(value)
        return value

    return json.dumps(plain(content), indent=2)
