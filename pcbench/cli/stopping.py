"""Ctrl-C: noted, raised, and raised again where a library swallows it."""

import sys
from collections.abc import Callable
from typing import Any

STOPPED = 130  # the exit code of a program that Ctrl-C has ended
_ASKED: list[int] = []


def interrupt(number: int, frame: Any) -> None:
    """Stop: the handler of SIGINT."""
    _ASKED.append(number)
    raise KeyboardInterrupt


def unraisable(found: Any) -> None:
    """Say what Python could not raise, as it does, but for a Ctrl-C: that is noted and raised later."""
    if not issubclass(found.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(found)


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt where Ctrl-C was pressed and a library has swallowed it."""
    if _ASKED:
        raise KeyboardInterrupt


def stoppable(draw: Callable[[str, float], None]) -> Callable[[str, float], None]:
    """Return a `tell` that draws what it hears, and stops where that was asked for."""

    def tell(event: str, value: float) -> None:
        stop_if_asked()
        draw(event, value)

    return tell
