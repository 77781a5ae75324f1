"""What a user did wrong, as one sentence: where, what was found, what was expected, what to do."""

import difflib
import re
from collections.abc import Iterable
from reprlib import Repr
from typing import Any

LONGEST = 100  # characters of a value that a sentence quotes


class UserError(ValueError):
    """A mistake the user can mend. The CLI prints the sentence and exits with code 2.

    Whatever it quotes, it is one line: what cannot be printed stands as its escape.
    """

    def __init__(self, sentence: str):
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in sentence))


class DesignError(UserError):
    """A gain that could not be found or certified: the sentence names the margin and the solver's status."""


def unknown(where: str, kind: str, got: str, valid: Iterable[str]) -> UserError:
    """Say that `got` is no `kind`, with the nearest valid name and all of them."""
    names = sorted(valid)
    lower = {name.lower(): name for name in names}
    near = difflib.get_close_matches(got[:LONGEST].lower(), lower, n=1, cutoff=0.4)
    hint = f"did you mean '{lower[near[0]]}'? " if near else ""
    return UserError(f"{where}: '{short(got)}' is no {kind}; {hint}valid: {', '.join(names)}.")


def short(text: str) -> str:
    """Return a text that a sentence may quote: what is too long loses its middle."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 23]}...{text[-20:]}"


def said(error: Any) -> str:
    """Return the first sentence of what another library said, without its full stop."""
    return short(re.split(r"\.\s|\n", str(error).strip())[0].rstrip("."))


def shown(value: Any) -> str:
    """Return a value as a sentence quotes it: its repr, of a size that can be read."""
    brief = Repr()
    brief.maxstring = brief.maxother = brief.maxlong = LONGEST
    brief.maxlist = brief.maxtuple = brief.maxdict = 8
    brief.maxlevel = 4
    try:
        return short(brief.repr(value))
    except ValueError:  # of an integer with too many digits to be written
        return f"a value of type {type(value).__name__} that is too long to be written here"
