"""REPRODUCTION.md: every claim with its verdict and its evidence, in a page that does not depend on machine or date.

If digits of the evidence depend on the machine, the claim has a `steady` text for the page.
"""

from pcbench.papers import PAPERS
from pcbench.papers.claim import FINDING, NOT_OBTAINED, VERDICTS, Claim, counts

HEAD = """# Reproduction

This page compares the claims and printed numbers of five papers, and of standard examples of the field, with what pcbench
computes. The command `pcbench reproduce all --page REPRODUCTION.md` writes it and computes every number under "computed". A
test repeats this.

- **reproduced**: the computed result agrees with the claim or number, as closely as the evidence shows.
- **misprint**: the printed value does not agree, but another reading of it does.
- **does not hold**: the claim is not true if you compute it as the paper describes.
- **not determinable**: the paper does not contain enough to compute it.

Findings are results of pcbench that no paper contains, so they have no verdict. In the tables, te and Ts are the sampling
period, d is the delay (in `arm` also the unknown input), and rms is the root mean square. In findings, a number after +- is
half the width of a 95 % interval.

Under `field`, each number has a mark. [S] means that it was seen in a public source. [V] means that it was computed by a
program that shares no code with pcbench. A number whose source could not be obtained is no claim. The last table lists these
numbers.
"""


def page(claims: dict[str, list[Claim]]) -> str:
    """Return the page of the claims of all papers."""
    return (
        "\n".join([HEAD, *_summary(claims), *(line for name in claims for line in _paper(name, claims[name]))]) + "\n"
    )


def _summary(claims: dict[str, list[Claim]]) -> list[str]:
    heads = [*VERDICTS, "findings", NOT_OBTAINED]
    rows = [[name, *map(str, counts(rows).values())] for name, rows in claims.items()]
    total = counts(row for rows in claims.values() for row in rows)
    return [*_table(["paper", *heads], [*rows, ["all", *map(str, total.values())]]), ""]


def _paper(name: str, rows: list[Claim]) -> list[str]:
    judged_rows = [row for row in rows if row.verdict in VERDICTS]
    heads, keys = ["claim", "printed", "computed", "verdict"], ["claim", "printed", "reproduced", "verdict"]
    if any(row.source for row in judged_rows):
        heads, keys = ["claim", "reference", "source", *heads[2:]], ["claim", "printed", "source", *keys[2:]]
    out = [f"## {name}", "", PAPERS[name][0] + ".", ""]
    out += [*_table(heads, _cells(judged_rows, keys)), ""]
    if ours := [row for row in rows if row.verdict == FINDING]:
        out += ["### Findings", "", *_table(["what", "computed"], _cells(ours, ["claim", "reproduced"])), ""]
    if missing := [row for row in rows if row.verdict == NOT_OBTAINED]:
        heads, keys = ["source", "not obtained", "instead"], ["source", "claim", "reproduced"]
        out += ["### Not obtained", "", *_table(heads, _cells(missing, keys)), ""]
    return out


def _cells(rows: list[Claim], keys: list[str]) -> list[list[str]]:
    steady = [row._replace(reproduced=row.steady or row.reproduced) for row in rows]
    return [[getattr(row, key) for key in keys] for row in steady]


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    lines = [heads, ["---"] * len(heads), *([_cell(c) for c in row] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in lines]


def _cell(text: str) -> str:
    """Return a text escaped for a Markdown cell: no bar ends the cell, and nothing is emphasis."""
    for mark in "\\|*_<":
        text = text.replace(mark, "\\" + mark)
    return text
