"""What a user did wrong, as one sentence: where, what was found, what was expected, what to do."""

import difflib
from collections.abc import Iterable


class UserError(ValueError):
    """A mistake the user can mend. The CLI prints the sentence and exits with code 2."""


class DesignError(UserError):
    """A gain that could not be found or certified: the sentence names the margin and the solver's status."""


def unknown(where: str, kind: str, got: str, valid: Iterable[str]) -> UserError:
    """Say that `got` is no `kind`, with the nearest valid name and all of them."""
    names = sorted(valid)
    lower = {name.lower(): name for name in names}
    near = difflib.get_close_matches(got.lower(), lower, n=1, cutoff=0.4)
    hint = f"did you mean '{lower[near[0]]}'? " if near else ""
    return UserError(f"{where}: '{got}' is no {kind}; {hint}valid: {', '.join(names)}.")
