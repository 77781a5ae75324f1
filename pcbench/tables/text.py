"""Tables as Markdown, and as CSV with one row per estimate and all digits."""

import csv
import io
import re

from pcbench.dataset.columns import axes_of
from pcbench.tables.layout import Entry, Head, Table

NUMBERS = ("n", "diverged", "mean", "ci_low", "ci_high")


def markdown(tables: list[Table]) -> str:
    """Return tables as Markdown."""
    return "\n".join(_table(t) for t in tables)


def _table(t: Table) -> str:
    heads = [_head(h) for h in [*t.stub, *t.heads]]
    lines = [
        f"{t.about}{f', by {_head(t.over)}' if t.over else ''}. {' '.join(t.notes)}",
        "",
        f"| {' | '.join(heads)} |",
        f"|{'|'.join([':---'] * len(t.stub) + ['---:'] * len(t.heads))}|",
        *(f"| {' | '.join([*map(_text, words), *map(_entry, entries)])} |" for words, entries in t.rows),
        "",
    ]
    return "\n".join(lines)


def _head(h: Head) -> str:
    return f"{_text(h.text)} [{h.unit}]" if h.unit not in ("", "1") else _text(h.text)


def _text(words: str) -> str:
    """Return words in which Markdown has no column, tag, link or code."""
    return re.sub(r"[\\|<>`\[\]]", r"\\\g<0>", words)


def _entry(entry: Entry | None) -> str:
    if entry is None:
        return "-"
    mark = "**" if entry.best else ""
    return f"{mark}{entry.text}{mark}{' †' if entry.has_diverged else ''}"


def values(tables: list[Table]) -> str:
    """Return tables as CSV."""
    entries = [e for t in tables for e in t.entries]
    axes = list(dict.fromkeys(a for e in entries for a in axes_of(e.row)))
    names = ["scenario", "signal", "metric", "unit", *axes, "observer", *NUMBERS]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*names, "best"])
    for e in entries:
        writer.writerow([*("" if e.row.get(n) != e.row.get(n) else e.row.get(n) for n in names), e.best])
    return out.getvalue()
