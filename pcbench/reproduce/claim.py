"""One line of a reproduction."""

from typing import NamedTuple


class Claim(NamedTuple):
    """What a paper says, what comes out, and the verdict."""

    claim: str
    printed: str
    reproduced: str
    verdict: str  # reproduced | holds | misprint | does not reproduce | does not hold | not determinable | finding; of a table:
    # digits (rounds to the print) | close | band (the print lies among runs from starts nearby) | differs


def digits(claim: str, printed: str, value: float, failed: str = "does not reproduce") -> Claim:
    """Compare a printed decimal number with a value rounded to as many decimals."""
    places = len(printed.partition(".")[2])
    same = f"{value:.{places}f}" == f"{float(printed):.{places}f}"
    return Claim(claim, printed, f"{value:.10g}", "reproduced" if same else failed)


def statement(claim: str, printed: str, reproduced: str, true: bool) -> Claim:
    """Say whether a claim in words holds."""
    return Claim(claim, printed, reproduced, "holds" if true else "does not hold")
