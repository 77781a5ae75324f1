"""What a check says: its name, its verdict, and why; and how checks are asked one after the other."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

from pcbench.errors import UserError, raised

PASSES, FAILS, SKIPPED, NOTE = "passes", "fails", "skipped", "note"
T = TypeVar("T")  # what is asked about


class Finding(NamedTuple):
    """What one check says."""

    check: str
    verdict: str  # passes, fails, skipped, or note: nothing is wrong, but it is to be known
    why: str  # what was asked, where it passes; what was found and what to do, where it fails; why it was not asked


class Skipped(Exception):
    """A check that cannot be asked; the sentence says why."""


class Noted(Exception):
    """What is no mistake, but has consequences; the sentence says which."""


def require(holds: bool, sentence: str) -> None:
    """Raise UserError with a sentence where something does not hold."""
    if not holds:
        raise UserError(sentence)


def ask(
    first: str,
    make: Callable[[], tuple[T, str]],
    checks: Mapping[str, Callable[[T], str]],
    needs: Mapping[str, Sequence[str]],
) -> list[Finding]:
    """Return what the `first` check, which makes what is asked, and every other one say, in their order.

    A check is asked once the first one passes and those that it `needs`; one that is not named there needs those of "".
    Nothing that a user's code raises comes out but in a sentence.
    """
    made: list[T] = []

    def making() -> str:
        it, why = make()
        made.append(it)
        return why

    out = [_verdict(first, making)]
    for name, check in checks.items():
        failed = [f.check for f in out if f.verdict == FAILS]
        lacking = next((need for need in (first, *needs.get(name, needs[""])) if need in failed), None)
        if lacking:
            out.append(Finding(name, SKIPPED, f"not asked before {lacking} passes"))
        else:
            out.append(_verdict(name, partial(check, made[0])))
    return out


def _verdict(name: str, check: Callable[[], str]) -> Finding:
    try:
        return Finding(name, PASSES, check())
    except Skipped as reason:
        return Finding(name, SKIPPED, str(reason))
    except Noted as reason:
        return Finding(name, NOTE, str(reason))
    except UserError as error:
        return Finding(name, FAILS, str(error))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return Finding(name, FAILS, f"{name}: got {raised(error)}, expected code that can be run; mend that line.")
