"""One line of a reproduction: a claim or a printed number, what comes out, and the verdict.

Verdicts are four. `reproduced`: it comes out, and the evidence says how closely. `misprint`: another reading comes out, the
printed one does not. `does not hold`: it was computed as the paper says, and is not so. `not determinable`: the paper does not
say enough to compute it. What is in no paper is a `finding`: ours, without a verdict, counted apart. A number whose source
nobody could read is `not obtained`, without a verdict too.
"""

import re
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

REPRODUCED, MISPRINT, FALSE, OPEN = "reproduced", "misprint", "does not hold", "not determinable"
VERDICTS = (REPRODUCED, MISPRINT, FALSE, OPEN)
FINDING = "finding"
NOT_OBTAINED = "not obtained"
OURS = "not in the paper"
TINY = 1e-12
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


class Claim(NamedTuple):
    """What a paper says, what comes out, and the verdict."""

    claim: str
    printed: str
    reproduced: str  # the evidence
    verdict: str  # one of VERDICTS, FINDING or NOT_OBTAINED
    steady: str = ""  # the evidence in a page that stands: given where digits depend on the last bits of a machine
    source: str = ""  # the source and the mark of the number, where a collection has several sources


def counts(rows: Iterable[Claim]) -> dict[str, int]:
    """Count verdicts, each of them named, then findings and numbers that were not obtained."""
    found = Counter(row.verdict for row in rows)
    return {name: found[name] for name in (*VERDICTS, FINDING, NOT_OBTAINED)}


def report_finding(what: str, text: str, steady: str = "") -> Claim:
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


def all_digits(claim: str, printed: str, values: ArrayLike, source: str = "", failed: str = FALSE) -> Claim:
    """Compare every number of a printed text with a value, as `digits` does; a complex value counts as two numbers."""
    want, found = NUMBER.findall(printed), np.atleast_1d(np.asarray(values)).ravel()
    if np.iscomplexobj(found):
        found = np.array([part for z in found for part in ((z.real, z.imag) if z.imag else (z.real,))])
    same = len(want) == len(found) and all(rounds_to(text, value) for text, value in zip(want, found, strict=True))
    more = 0 if found.dtype.kind == "i" else 1
    shown = ", ".join(
        f"{round(value, decimals(text) + more) + 0.0:.{decimals(text) + more}f}"
        for value, text in zip(found, want, strict=False)
    )
    return Claim(claim, printed, shown, REPRODUCED if same else failed, source=source)


def rounds_to(printed: str, value: float) -> bool:
    """Say whether a value rounds to a printed decimal number, to half a unit of its last digit."""
    return abs(value - float(printed)) <= 0.5 * unit(printed) * (1 + 1e-9)


def unit(printed: str) -> float:
    """Return what the last digit of a printed decimal number counts."""
    return 10.0 ** -decimals(printed)


def decimals(printed: str) -> int:
    """Return the place of the last digit of a printed decimal number: 2 of 0.25, -1 of 3e1."""
    decimal, _, exponent = printed.partition("e")
    return len(decimal.partition(".")[2]) - int(exponent or 0)
