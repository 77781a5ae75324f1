"""One line of a reproduction: a claim or a printed number, what comes out, and the verdict.

Verdicts are four. `reproduced`: it comes out, and the evidence says how closely. `misprint`: another reading comes out, the
printed one does not. `does not hold`: it was computed as the paper says, and is not so. `not determinable`: the paper does not
say enough to compute it. What stands in no paper is a `finding`: ours, without a verdict, counted apart.

REPRODUCTION.md: every claim with its verdict and its evidence, as a page that is the same wherever it is made.

Nothing in it depends on the day, the machine or how long anything took; where digits of the evidence do, a claim brings a
`steady` text for the page.

All papers at once: one process a paper, as many at a time as there are cores.
"""

import multiprocessing
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import NamedTuple

from pcbench.engine import runner
from pcbench.papers import PAPERS
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress

REPRODUCED, MISPRINT, FALSE, OPEN = "reproduced", "misprint", "does not hold", "not determinable"
VERDICTS = (REPRODUCED, MISPRINT, FALSE, OPEN)
FINDING = "finding"
OURS = "not in the paper"
TINY = 1e-12


class Claim(NamedTuple):
    """What a paper says, what comes out, and the verdict."""

    claim: str
    printed: str
    reproduced: str  # the evidence
    verdict: str  # one of VERDICTS, or FINDING
    steady: str = ""  # the evidence in a page that stands: given where digits depend on the last bits of a machine


def counts(rows: Iterable[Claim]) -> dict[str, int]:
    """Count verdicts, each of them named, and findings last."""
    found = Counter(row.verdict for row in rows)
    return {name: found[name] for name in (*VERDICTS, FINDING)}


def found(what: str, text: str, steady: str = "") -> Claim:
    """Return something that the paper does not say."""
    return Claim(what, OURS, text, FINDING, steady)


def statement(claim: str, printed: str, reproduced: str, true: bool, steady: str = "") -> Claim:
    """Say whether a claim in words comes out."""
    return Claim(claim, printed, reproduced, REPRODUCED if true else FALSE, steady)


def digits(claim: str, printed: str, value: float, failed: str = FALSE) -> Claim:
    """Compare a printed decimal number with a value rounded to as many decimals."""
    many = len(printed.replace("-", "").replace(".", "").lstrip("0"))
    same = rounds_to(printed, value)
    how = f"to {many} digits" if many else "zero to every decimal"
    shown = f"{value:.8g}" if abs(value) > TINY else f"below {TINY:g}"
    return Claim(claim, printed, f"{shown}, {how}" if same else shown, REPRODUCED if same else failed)


def rounds_to(printed: str, value: float) -> bool:
    """Say whether a value rounds to a printed decimal number, to half a unit of its last digit."""
    return abs(value - float(printed)) <= 0.5 * unit(printed) * (1 + 1e-9)


def unit(printed: str) -> float:
    """Return what the last digit of a printed decimal number counts."""
    decimal, _, exponent = printed.partition("e")
    return 10.0 ** (int(exponent or 0) - len(decimal.partition(".")[2]))


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


LONGEST_FIRST = ("arm", "helicopter", "pi-pco", "chain", "cart")  # measured; only how long it takes depends on it


def claims(progress: Progress = SILENT) -> dict[str, list[Claim]]:
    """Return the claims of every paper, in the order of PAPERS."""
    names = sorted(PAPERS, key=lambda name: LONGEST_FIRST.index(name) if name in LONGEST_FIRST else -1)
    progress.begin("papers", len(names))
    fresh = multiprocessing.get_context("spawn")  # a forked process has jax's threads in an unknown state
    found = {}
    with ProcessPoolExecutor(min(len(names), runner.cores()), fresh) as pool:
        waiting = {pool.submit(of, name): name for name in names}
        try:
            for done in as_completed(waiting):
                found[waiting[done]] = done.result()
                progress.step(1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {name: found[name] for name in PAPERS}


def of(paper: str) -> list[Claim]:
    """Return the claims of one paper, in a process that is pcbench's own."""
    config.setup()
    return PAPERS[paper][1]()
