"""One line of a reproduction: a claim or a printed number, the computed result, and the verdict.

The four verdicts:

- `reproduced`: the result agrees; the evidence shows how closely
- `misprint`: another reading agrees, the printed one does not
- `does not hold`: computed as in the paper, the claim is false
- `not determinable`: the paper does not contain enough to compute it

Without a verdict are a `finding`, a result that no paper contains, and `not obtained`, a number whose source could not be read.
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
NOT_IN_PAPER = "not in the paper"
TINY = 1e-12
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


class Claim(NamedTuple):
    """A claim of a paper, the computed result, and the verdict."""

    claim: str
    printed: str
    reproduced: str  # the evidence
    verdict: str  # one of VERDICTS, FINDING or NOT_OBTAINED
    steady: str = ""  # the evidence in REPRODUCTION.md, if digits depend on the machine
    source: str = ""  # source and mark of the number, in a collection with several sources


def counts(rows: Iterable[Claim]) -> dict[str, int]:
    """Return the counts of each verdict, then of findings and of numbers that were not obtained."""
    counter = Counter(row.verdict for row in rows)
    return {name: counter[name] for name in (*VERDICTS, FINDING, NOT_OBTAINED)}


def report_finding(claim: str, text: str, steady: str = "") -> Claim:
    """Return a result that the paper does not contain."""
    return Claim(claim, NOT_IN_PAPER, text, FINDING, steady)


def statement(claim: str, printed: str, reproduced: str, true: bool, steady: str = "") -> Claim:
    """Return the claim in words with its verdict."""
    return Claim(claim, printed, reproduced, REPRODUCED if true else FALSE, steady)


def digits(claim: str, printed: str, value: float, mismatch: str = FALSE) -> Claim:
    """Return the comparison of a printed decimal number with a value rounded to as many decimals."""
    n_digits = len(printed.replace("-", "").replace(".", "").lstrip("0"))
    agrees = rounds_to(printed, value)
    precision = f"to {n_digits} digits" if n_digits else "zero to every decimal"
    text = f"{value:.8g}" if abs(value) > TINY else f"below {TINY:g}"
    return Claim(claim, printed, f"{text}, {precision}" if agrees else text, REPRODUCED if agrees else mismatch)


def all_digits(claim: str, printed: str, values: ArrayLike, source: str = "", mismatch: str = FALSE) -> Claim:
    """Return the comparison of every number of a printed text with a value, as in `digits`; a complex value counts as two."""
    words, numbers = NUMBER.findall(printed), np.atleast_1d(np.asarray(values)).ravel()
    if np.iscomplexobj(numbers):
        numbers = np.array([part for z in numbers for part in ((z.real, z.imag) if z.imag else (z.real,))])
    agrees = len(words) == len(numbers) and all(
        rounds_to(text, value) for text, value in zip(words, numbers, strict=True)
    )
    extra_digits = 0 if numbers.dtype.kind == "i" else 1
    computed = ", ".join(
        f"{round(value, decimals(text) + extra_digits) + 0.0:.{decimals(text) + extra_digits}f}"
        for value, text in zip(numbers, words, strict=False)
    )
    return Claim(claim, printed, computed, REPRODUCED if agrees else mismatch, source=source)


def rounds_to(printed: str, value: float) -> bool:
    """Return whether a value rounds to a printed decimal number, to half a unit of its last digit."""
    return abs(value - float(printed)) <= 0.5 * unit(printed) * (1 + 1e-9)


def unit(printed: str) -> float:
    """Return the unit of the last digit of a printed decimal number."""
    return 10.0 ** -decimals(printed)


def decimals(printed: str) -> int:
    """Return the position of the last digit of a printed decimal number: 2 for 0.25, -1 for 3e1."""
    decimal, _, exponent = printed.partition("e")
    return len(decimal.partition(".")[2]) - int(exponent or 0)
