"""One line of a reproduction: a claim or a printed number, what comes out, and the verdict.

Verdicts are four. `reproduced`: it comes out, and the evidence says how closely. `misprint`: another reading comes out, the
printed one does not. `does not hold`: it was computed as the paper says, and is not so. `not determinable`: the paper does not
say enough to compute it. What stands in no paper is a `finding`: ours, without a verdict, counted apart.
"""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

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


def rounds_to(printed: str, value: float) -> bool:
    """Say whether a value rounds to a printed decimal number, to half a unit of its last digit."""
    return abs(value - float(printed)) <= 0.5 * unit(printed) * (1 + 1e-9)


def unit(printed: str) -> float:
    """Return what the last digit of a printed decimal number counts."""
    decimal, _, exponent = printed.partition("e")
    return 10.0 ** (int(exponent or 0) - len(decimal.partition(".")[2]))
