"""REPRODUCTION.md: every claim with its verdict and its evidence, as a page that is the same wherever it is made.

Nothing in it depends on the day, the machine or how long anything took; where digits of the evidence do, a claim brings a
`steady` text for the page.
"""

from pcbench.papers import PAPERS
from pcbench.papers.claim import FINDING, VERDICTS, Claim, counts

HEAD = """# Reproduction

What five papers claim and print, against what comes out here. Made by `pcbench reproduce all --page REPRODUCTION.md`; a test
makes it again and compares. Every number under "what comes out" is computed when the page is made.

- **reproduced**: it comes out; the evidence says how closely.
- **misprint**: another reading comes out, the printed one does not.
- **does not hold**: computed as the paper says, it is not so.
- **not determinable**: the paper does not say enough to compute it.

Findings stand in no paper: they are ours, and have no verdict.
"""


def page(every: dict[str, list[Claim]]) -> str:
    """Return the page of the claims of all papers."""
    return "\n".join([HEAD, *_summary(every), *(line for name in every for line in _paper(name, every[name]))]) + "\n"


def _summary(every: dict[str, list[Claim]]) -> list[str]:
    heads = [*VERDICTS, "findings"]
    rows = [[name, *map(str, counts(rows).values())] for name, rows in every.items()]
    total = counts(row for rows in every.values() for row in rows)
    return [*_table(["paper", *heads], [*rows, ["all", *map(str, total.values())]]), ""]


def _paper(name: str, rows: list[Claim]) -> list[str]:
    said = [[r.claim, r.printed, r.steady or r.reproduced, r.verdict] for r in rows if r.verdict != FINDING]
    ours = [[r.claim, r.steady or r.reproduced] for r in rows if r.verdict == FINDING]
    out = [f"## {name}", "", PAPERS[name][0] + ".", ""]
    out += [*_table(["claim", "printed", "what comes out", "verdict"], said), ""]
    return out + (["### Findings", "", *_table(["what", "what comes out"], ours), ""] if ours else [])


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    lines = [heads, ["---"] * len(heads), *([_cell(c) for c in row] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in lines]


def _cell(text: str) -> str:
    """A text as it reads the same in Markdown: no bar ends a cell, nothing is taken for emphasis."""
    for mark in "\\|*_<":
        text = text.replace(mark, "\\" + mark)
    return text
