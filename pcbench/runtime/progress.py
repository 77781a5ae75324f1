"""How long work says how far it is: what has begun, how many steps of it are done, what is being done now. No jax."""

from collections.abc import Callable
from typing import Any, NamedTuple


def _ignore(*said: Any) -> None:
    """Hear and do nothing."""


class Progress(NamedTuple):
    """Who hears of progress: three functions, each of which may be left out.

    `begin` takes what begins and how many steps it has (None: not known); begun again, the same work has so many more. `step`
    takes how many more are done, `note` what is being done now.
    """

    begin: Callable[[str, int | None], None] = _ignore
    step: Callable[[int], None] = _ignore
    note: Callable[[str], None] = _ignore


SILENT = Progress()
