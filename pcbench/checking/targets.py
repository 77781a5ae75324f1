"""The kind of a check's target, and the order of the checks.

A target is an observer, a plant, a controller, a scenario, or a study in a file. The result of a check is its name, its
verdict and the reason.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

from pcbench.errors import UserError, describe_exception, short, unknown
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES
from pcbench.study.plugins import user_code
from pcbench.study.plugins.registry import KINDS, describe_kind

WHERE = "check"
STUDY = "study"


def kind_of(target: str) -> str:
    """Return the kind of MODULE:NAME, or `study`; raise UserError if it has no kind, or does not exist.

    A study is a TOML file, a built-in study, or a built-in scenario.
    """
    if target.endswith(".toml") or target in STUDIES or target in SCENARIOS:
        return STUDY
    if not user_code.is_reference(target):
        raise UserError(
            f"{WHERE}: got '{short(target)}', expected MODULE:NAME such as mine.py:nudge, or a study file such as motor.toml; "
            "name the module, or its file, and what it is called in it."
        )
    code = user_code.code_of(target, WHERE)
    folder = Path(user_code.split(target, WHERE)[0]).resolve().parent if code.files else None
    types = tuple(t for kind in KINDS.values() for t in kind.types)
    candidate, names = user_code.attribute_of(user_code.module_of(code, WHERE, folder), code.name, types)
    if candidate is None:
        raise unknown(f"{WHERE} {code.module}", f"{', '.join([*KINDS][:-1])} or {[*KINDS][-1]} there", code.name, names)
    for name, kind in KINDS.items():
        if isinstance(candidate, kind.types):
            return name
    expected = " or ".join(
        f"{'an' if name[0] in 'aeiou' else 'a'} {name} ({kind.expected})" for name, kind in KINDS.items()
    )
    raise UserError(
        f"{WHERE}: got {describe_kind(candidate)} called {code.name}, expected {expected}; name one of those."
    )


PASSES, FAILS, SKIPPED, NOTE = "passes", "fails", "skipped", "note"
T = TypeVar("T")  # what the checks of a kind take: a trial, or a study's grid


class Finding(NamedTuple):
    """The result of one check."""

    check: str
    verdict: str  # passes, fails, skipped, or note: no mistake, but it has consequences
    why: str  # passes: what was checked; fails: what is wrong and what to do; skipped: why it was not checked


class SkipCheck(Exception):
    """A check that does not apply; the message is the reason."""


class CheckNote(Exception):
    """A result that is no mistake but has consequences; the message names them."""


def require(holds: bool, sentence: str) -> None:
    """Raise UserError with this message if a condition does not hold."""
    if not holds:
        raise UserError(sentence)


def run_checks(
    first: str,
    make: Callable[[], tuple[T, str]],
    checks: Mapping[str, Callable[[T], str]],
    needs: Mapping[str, Sequence[str]],
) -> list[Finding]:
    """Return the results of the check `first`, which makes the trial, and of all other checks, in their order.

    A check runs if `first` and the checks of its entry in `needs` have passed; the entry "" is for checks without one.
    Exceptions of a user's code become a verdict with a reason.
    """
    trials: list[T] = []

    def make_trial() -> str:
        trial, why = make()
        trials.append(trial)
        return why

    out = [_verdict(first, make_trial)]
    for name, check in checks.items():
        failures = [f.check for f in out if f.verdict == FAILS]
        missing = next((n for n in (first, *needs.get(name, needs[""])) if n in failures), None)
        if missing:
            out.append(Finding(name, SKIPPED, f"not run: {missing} has not passed"))
        else:
            out.append(_verdict(name, partial(check, trials[0])))
    return out


def _verdict(name: str, check: Callable[[], str]) -> Finding:
    try:
        return Finding(name, PASSES, check())
    except SkipCheck as reason:
        return Finding(name, SKIPPED, str(reason))
    except CheckNote as reason:
        return Finding(name, NOTE, str(reason))
    except UserError as error:
        return Finding(name, FAILS, str(error))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return Finding(
            name, FAILS, f"{name}: got {describe_exception(error)}, expected code that can be run; correct that line."
        )
