"""What a check says: its name, its verdict, and why."""

from typing import NamedTuple

from pcbench.errors import UserError

PASSES, FAILS, SKIPPED = "passes", "fails", "skipped"


class Finding(NamedTuple):
    """One check of one observer."""

    check: str
    verdict: str  # passes, fails or skipped
    why: str  # what was asked, where it passes; what was found and what to do, where it fails; why it was not asked


class Skipped(Exception):
    """A check that cannot be asked of this observer; the sentence says why."""


def require(holds: bool, sentence: str) -> None:
    """Raise UserError with a sentence where something does not hold."""
    if not holds:
        raise UserError(sentence)
