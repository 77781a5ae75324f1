"""Tables in LaTeX, with booktabs and siunitx, or with neither."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from pcbench.plots.layout import JOURNALS, POINTS_PER_INCH, Paper
from pcbench.tables.layout import Entry, Head, Table

NEEDS = r"% needs \usepackage{booktabs, siunitx}"
TYPE = Paper(size=8, font="cmr10")
WIDER, BOLD = 1.08, 1.2  # widths of 8 pt letters divided by those of `TYPE`, which is drawn for 10 pt
COLSEP = 3.0  # points at either side of a column
LEAST, DAGGER = 24.0, 5.0  # points: of a column, of a mark
LINES = 48  # of a page, those of the head and the notes excluded
LINE_END = r"\\{}"  # with braces, so that a bracket after it is text
PART = re.compile(r"part (\d+) of \d+$")
SPECIAL = {c: rf"\{c}" for c in "{}_%&#$"}
SPECIAL |= {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"}
LETTERS = {"±": r"$\pm$", "²": r"\textsuperscript{2}", "<": r"\textless{}", ">": r"\textgreater{}"}
IN_UNITS = {"*": " ", "·": r"\cdot ", "²": "^{2}", "³": "^{3}", "°": r"{}^{\circ}", "Ω": r"\Omega "}
IN_UNITS |= dict.fromkeys("µμ", r"\mu ")  # the micro sign, and the letter
OF_UNIT = re.compile(r"\^(-?\d+|\([^()]*\))|(.)", re.S)
SYMBOLS = {"degC": (r"\degreeCelsius", r"^\circ\mathrm{C}"), "%": (r"\percent", r"\%")}  # with siunitx, and without
ESTIMATE = re.compile(r"\(?(?P<value>[-+\d.e]+?)(?: ± (?P<half>[\d.]+|\?)\)?)?(?:e(?P<power>[-+]\d+))?")
LEANING = re.compile(r"(?P<value>\S+) \((?P<low>\S+) \.\. (?P<high>\S+)\)")
NUMBER = re.compile(r"([-+]?[\d.]+)(?:e([-+]?\d+))?")


def latex(tables: list[Table], plain: bool = False, journal: str = "ieee") -> str:
    """Return tables as LaTeX for a journal of JOURNALS; `plain`: without packages.

    A table wider than a column is a `table*`. One that is wider than the text, or longer than a page, is split; the captions of
    its parts say so.
    """
    paper = JOURNALS[journal]
    column, page_width = (width * POINTS_PER_INCH for width in (paper.width, paper.full))
    limits = f"% for {journal}: tables are at most {column:.0f} pt (table) or {page_width:.0f} pt (table*) wide"
    body = [_table(part, wide, plain) for t in tables for part, wide in split(t, column, page_width)]
    return "\n".join([*([] if plain else [NEEDS]), limits, "", *body])


def split(t: Table, column: float, page_width: float) -> Iterator[tuple[Table, bool]]:
    """Yield a table's parts, each with whether it is wider than a column; `column` and `page_width` are widths in points."""
    widths = [_values_width(t, i) for i in range(len(t.heads))]
    widths = [max(w, *(_width(_visible(line)) for line in _lines(h, w))) for h, w in zip(t.heads, widths, strict=True)]
    stub = max(_width(words) for words in [t.stub[-1].text, *(words[-1] for words, _ in t.rows)])
    over = _width(_visible(t.over)) if t.over else 0.0
    widest = max(_width(", ".join(f"{h.text} {word} {h.unit}" for h, word in _place(t, words))) for words, _ in t.rows)

    def fits(columns: Sequence[int], room: float) -> bool:
        values = sum(widths[i] + 2 * COLSEP for i in columns)
        return max(stub + max(values, over + COLSEP), widest) <= room

    indices = range(len(widths))
    wide = not fits(indices, column)
    for count in range(1, len(widths) + 1):
        columns = [[int(i) for i in part] for part in np.array_split(indices, count)]
        if all(fits(part, page_width if wide else column) for part in columns):
            break
    parts = [(rows, part) for rows in _pages(t) for part in columns]
    for i, (rows, part) in enumerate(parts, 1):
        title = t.about + (f", part {i} of {len(parts)}" if len(parts) > 1 else "")
        rows = [(words, [entries[k] for k in part]) for words, entries in rows]
        yield t._replace(about=title, heads=[t.heads[k] for k in part], rows=rows), wide and column < page_width


def _pages(t: Table) -> list[list[tuple[list[str], list[Entry | None]]]]:
    """Return the rows of each page; groups of rows are not split."""
    pages, lines = [list[tuple[list[str], list[Entry | None]]]()], 0
    for _, group in groupby(t.rows, key=lambda row: row[0][:-1]):
        rows = list(group)
        lines += len(rows) + 1
        if lines > LINES and pages[-1]:
            pages.append([])
            lines = len(rows) + 1
        pages[-1] += rows
    return pages


def _values_width(t: Table, i: int) -> float:
    """Return the width of the widest value of a column in points."""
    return max([LEAST, *(_entry_width(e) for _, entries in t.rows if (e := entries[i]))])


def _entry_width(e: Entry) -> float:
    text = re.sub(r"e([-+]\d+)", " \u00d7 10\\1", e.text).replace("..", "to")
    return _width(text, e.best) + DAGGER * e.has_diverged


def _width(text: str, bold: bool = False) -> float:
    """Return the width of a text of 8 pt in points, somewhat wider than in Computer Modern, which is wider than Times."""
    return TYPE.width_of(text) * POINTS_PER_INCH * (BOLD if bold else WIDER)


def _visible(h: Head) -> str:
    return f"{h.text} [{h.unit}]" if h.unit not in ("", "1") else h.text


def _lines(h: Head, width: float) -> list[Head]:
    """Return a head in lines, so that it is not wider than its column if its words allow that; the last has the unit."""
    *first, last = TYPE.wrap(h.text, width / POINTS_PER_INCH / WIDER).split("\n")
    ends = [Head(last, h.unit)]
    if _width(_visible(ends[0])) > width and last:
        ends = [Head(last), Head("", h.unit)]
    return [*map(Head, first), *ends]


def _place(t: Table, words: list[str]) -> list[tuple[Head, str]]:
    """Return the axes of a group of rows with their values."""
    return list(zip(t.stub[:-1], words[:-1], strict=True))


def _table(t: Table, wide: bool, plain: bool) -> str:
    top, middle, bottom = (r"\hline",) * 3 if plain else (r"\toprule", r"\midrule", r"\bottomrule")
    heads = [
        _text(t.stub[-1].text),
        *(_multiline_head(_lines(h, _values_width(t, i)), plain) for i, h in enumerate(t.heads)),
    ]
    label = re.sub(r"[^\w-]+", "-", "-".join(filter(None, (t.title, t.signal, *PART.findall(t.about)))))
    environment = "table*" if wide else "table"
    lines = [
        rf"\begin{{{environment}}}",
        r"\centering",
        rf"\caption{{{_text(t.about)}}}",
        rf"\label{{tab:{label}}}",
        rf"\fontsize{{8}}{{9.5}}\selectfont\setlength{{\tabcolsep}}{{{COLSEP:g}pt}}",
        *([] if plain else [r"\sisetup{separate-uncertainty = true, detect-all, group-digits = integer}"]),
        rf"\begin{{tabular}}{{@{{}}l{'r' * len(t.heads)}@{{}}}}",
        top,
        *_over(t, plain),
        rf"{' & '.join(heads)} \\",
        middle,
        *_rows(t, plain),
        bottom,
        r"\end{tabular}",
        rf"\par\vspace{{3pt}}\parbox{{\linewidth}}{{\raggedright {_text(' '.join(t.notes))}}}",
        rf"\end{{{environment}}}",
        "",
    ]
    return "\n".join(lines)


def _rows(t: Table, plain: bool) -> Iterator[str]:
    """Yield the rows, each group below the values of its axes."""
    for words, rows in groupby(t.rows, key=lambda row: row[0][:-1]):
        if words:
            place = ", ".join(
                " ".join([_text(h.text), _text(word), *([_unit(h.unit, plain)] if h.unit else [])])
                for h, word in _place(t, [*words, ""])
            )
            yield rf"\multicolumn{{{len(t.heads) + 1}}}{{@{{}}l@{{}}}}{{\itshape {place}}} \\"
        for stub, entries in rows:
            yield rf"{' & '.join([_text(stub[-1]), *(_entry(e, plain) for e in entries)])} \\"


def _over(t: Table, plain: bool) -> list[str]:
    """Return the lines above the heads with the axis whose values the heads are."""
    if not t.over:
        return []
    rule = f"2-{len(t.heads) + 1}"
    line = rf"& \multicolumn{{{len(t.heads)}}}{{c@{{}}}}{{{_head(t.over, plain)}}} \\"
    return [line, rf"\cline{{{rule}}}" if plain else rf"\cmidrule(l){{{rule}}}"]


def _multiline_head(lines: list[Head], plain: bool) -> str:
    """Return the head of a column, one line above the other."""
    heads = [_head(h, plain) for h in lines]
    return rf"\shortstack[r]{{{LINE_END.join(heads)}}}" if heads[1:] else heads[0]


def _head(h: Head, plain: bool) -> str:
    unit = f"[{_unit(h.unit, plain)}]" if h.unit not in ("", "1") else ""
    return " ".join(filter(None, [_text(h.text), unit]))


def _unit(unit: str, plain: bool) -> str:
    with_siunitx, without = SYMBOLS.get(unit) or (_power(unit), rf"\mathrm{{{_power(unit)}}}")
    return f"${without}$" if plain else rf"\unit{{{with_siunitx}}}"


def _power(unit: str) -> str:
    """Return a unit with its exponents in braces and all special characters of LaTeX escaped."""
    return OF_UNIT.sub(
        lambda m: f"^{{{_power(m[1])}}}" if m[1] else IN_UNITS.get(m[2]) or SPECIAL.get(m[2], m[2]), unit
    )


def _text(words: str) -> str:
    return "".join((SPECIAL | LETTERS).get(c, c) for c in words)


def _entry(entry: Entry | None, plain: bool) -> str:
    if entry is None:
        return "--"
    text = _estimate(entry.text, plain)
    if entry.best:
        text = rf"{{\boldmath\bfseries {text}}}"
    return text + (r"\textsuperscript{\dag}" if entry.has_diverged else "")


def _estimate(text: str, plain: bool) -> str:
    """Return an estimate of `number_format` in LaTeX."""
    if asymmetric := LEANING.fullmatch(text):
        value, low, high = (_number(asymmetric[k], plain) for k in ("value", "low", "high"))
        return f"{value} ({low} to {high})"
    match = ESTIMATE.fullmatch(text)
    if not match:
        return "--"
    half, power = match["half"], match["power"]
    if half in (None, "?"):
        return _number(text.removesuffix(" ± ?"), plain)
    if plain:
        formula = rf"{match['value']} \pm {half}"
        return f"$({formula}) \\times 10^{{{int(power)}}}$" if power else f"${formula}$"
    return rf"\num{{{match['value']} \pm {half}{f' e{int(power)}' if power else ''}}}"


def _number(text: str, plain: bool) -> str:
    if not (match := NUMBER.fullmatch(text)):
        return "--"
    if not plain:
        return rf"\num{{{text}}}"
    if not match[2]:
        return f"${text}$"
    return rf"${match[1]} \times 10^{{{int(match[2])}}}$"
