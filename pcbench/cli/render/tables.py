"""Tables for the terminal. Numbers are never cut: in a narrow terminal, columns are left out, or printed in a further table.

Also JSON with arrays, complex numbers and tuples.
"""

import json
from collections.abc import Iterable, Sequence
from itertools import takewhile
from typing import Any, Literal, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from pcbench.errors import printable
from pcbench.json_values import json_values
from pcbench.statistics.number_format import UNPROVEN, estimate, mark_uncertified

PROSE = 24  # smallest width of a line of prose, in characters


class Column(NamedTuple):
    """A column of a table that fits the terminal: columns with higher `spare` are left out first; 0 always stays."""

    head: str
    cells: Sequence[str | Text]
    spare: int = 0
    is_text: bool = False  # text, not numbers
    bold: frozenset[int] = frozenset()  # rows in bold
    prose: bool = False  # sentences, which may be broken between words


class Screen(Console):
    """A terminal that prints text literally: a study's text is not markup, and unprintable characters are escaped.

    Styled text is a `rich.text.Text`, or is printed with `style`.
    """

    def __init__(self, **kwargs: Any):
        super().__init__(markup=False, emoji=False, highlight=False, **kwargs)

    def render_str(self, text: str, **kwargs: Any) -> Text:
        """Return a text with its own line breaks."""
        return super().render_str(printable(text, but="\n"), **kwargs)

    def say(self, *sentences: str) -> None:
        """Print sentences, each as one line that the terminal breaks, so that it can be copied."""
        for sentence in sentences:
            self.print(sentence, soft_wrap=True)

    def say_unproven(self, certified: Iterable[object]) -> None:
        """Explain the mark behind a name, if there is one."""
        if mark_uncertified("", certified):
            self.print(f"{UNPROVEN} its gains.")

    def explain_acronyms(self, labels: Iterable[str]) -> None:
        """Spell out the papers' acronyms among observers, if there are any."""
        from pcbench.observers import acronyms

        if names := [f"{name}: {text}" for name, text in acronyms(labels).items()]:
            self.print(f"{'; '.join(names)}.")

    def fit(
        self, title: str, columns: list[Column], sections: list[int] | None = None, named: bool = True
    ) -> list[str]:
        """Print a table as wide as the terminal at most, below its title; return the heads of the columns left out for it.

        Columns that cannot be left out and have no room follow in further tables, after the same first columns. If even these
        have no room, or if there is prose, each row is a block of lines. `sections` are the numbers of rows of each part.
        `named`: a line below the table names the columns that are left out.
        """
        visible, out = list(columns), []
        while self._needs(visible) > self.width:
            spare = max(visible, key=lambda c: c.spare)
            if not spare.spare:
                break
            visible.remove(spare)
            out.append(spare.head.replace("\n", " "))
        self.print(title, style="italic")
        parts = [visible] if any(c.prose for c in visible) else self._parts(visible)
        if any(self._needs(part) > self.width for part in parts):
            self._print_blocks(columns)
            return []
        for part in parts:
            self.print(_table(part, sections, self.width - self._needs(part)))
        if out and named:
            self.print(omission_note(out[::-1]))
        return out[::-1]

    def _parts(self, columns: list[Column]) -> list[list[Column]]:
        """Return columns divided into tables that fit, each with the leading text columns; a table is never empty."""
        first = list(takewhile(lambda c: c.is_text and not c.prose, columns))
        parts = [first]
        for column in columns[len(first) :]:
            if len(parts[-1]) > len(first) and self._needs([*parts[-1], column]) > self.width:
                parts.append(first)
            parts[-1] = [*parts[-1], column]
        return parts

    def _print_blocks(self, columns: list[Column]) -> None:
        """Print each row as lines of a head and its cell, the first in bold."""
        for i in range(len(columns[0].cells)):
            for j, c in enumerate(columns):
                head, cell = " ".join(c.head.split()), c.cells[i]
                text = cell if isinstance(cell, Text) else Text(printable(" ".join(cell.split())))
                if text.plain:
                    line = Text.assemble(f"{printable(head)}: " if head else "", text, style="" if j else "bold")
                    self.print(Padding(line, (0, 0, 0, 2 * bool(j))))
        self.print()

    def fits(self, columns: list[Column]) -> bool:
        """Return whether the columns that cannot be left out fit into the terminal."""
        return self._needs([c for c in columns if not c.spare]) <= self.width

    def _needs(self, columns: list[Column]) -> int:
        """Return the width that a table needs so that no number and no word is cut."""
        return Measurement.get(self, self.options.update_width(10_000), _table(columns, None)).maximum


def omission_note(heads: list[str]) -> str:
    """Return a sentence that names the columns left out."""
    return f"Left out for lack of space: {', '.join(heads)}."


def _table(columns: list[Column], sections: list[int] | None, spare: int = 0) -> Table:
    """Return columns as a table: prose columns have the least width, plus up to `spare` characters."""
    table, cells = Table(box=SIMPLE_HEAD, pad_edge=False), []
    for c in columns:
        width = None
        if c.prose:
            width, natural = _prose_widths(c)
            extra = min(spare, natural - width)
            width, spare = width + extra, spare - extra
        side: Literal["left", "right"] = "left" if c.is_text or c.prose else "right"
        table.add_column(c.head, justify=side, overflow="fold", no_wrap=not c.prose, width=width)
        texts = c.cells if side == "left" else align_intervals([str(cell) for cell in c.cells])
        cells.append(
            [Text(printable(t), "bold") if i in c.bold and isinstance(t, str) else t for i, t in enumerate(texts)]
        )
    rows = list(zip(*cells, strict=True))
    for n in sections or [len(rows)]:
        for row in rows[:n]:
            table.add_row(*row)
        table.add_section()
        rows = rows[n:]
    return table


def _prose_widths(c: Column) -> tuple[int, int]:
    """Return the least width of a prose column without cut words, and the width of its longest text."""
    texts = [Text(printable(str(text), but="\n")) for text in (c.head, *c.cells)]
    natural = max(text.cell_len for text in texts)
    words = max((cell_len(word) for text in texts for word in text.plain.split()), default=1)
    return max(words, min(natural, PROSE)), natural


def align_intervals(cells: Sequence[str], at: str = " ± ") -> list[str]:
    """Return numbers with their intervals aligned at the sign."""
    parts = [cell.partition(at) for cell in cells]
    left = max((len(a) for a, sign, _ in parts if sign), default=0)
    right = max((len(c) for _, sign, c in parts if sign), default=0)
    room = left + len(at) + right
    return [
        a.rjust(left) + sign + c.ljust(right) if sign else a.rjust(left).ljust(room) if right and len(a) <= left else a
        for a, sign, c in parts
    ]


def format_number(value: float | None, form: str = ".4g") -> str:
    """Return a number as text; '-' if there is none."""
    return "-" if value is None or value != value else f"{value:{form}}"


def mean(value: float, se: float, sign: str = "") -> str:
    """Return a mean with two standard errors."""
    return estimate(value, value - 2 * se, value + 2 * se, sign)


def to_json(content: object) -> str:
    """Return arrays, complex numbers and tuples as readable JSON."""
    return json.dumps(json_values(content), indent=2)
