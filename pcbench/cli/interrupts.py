"""Ctrl-C and SIGTERM: noted, raised, and raised again where a library swallows it; during a compiled call the process ends."""

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.machinery import ExtensionFileLoader
from threading import Thread
from time import sleep
from types import FrameType
from typing import Any

from pcbench.runtime import ending
from pcbench.runtime.progress import Progress

STOPPED = 130  # the exit code of a program that Ctrl-C has ended; SIGTERM: 143
SOON = 0.05  # [s] until it is tried again
GRACE = 1.0  # [s] for the main thread to end the process itself
SENTENCE = "stopped; every file already written is complete."
CURSOR = "\r\x1b[K\x1b[?25h"  # of a terminal: clear the line of a progress bar, and show the cursor that it hides
_ASKED: list[int] = []


def interrupt(number: int, frame: FrameType | None) -> None:
    """Stop: the handler of SIGINT and SIGTERM; a second SIGTERM ends the process at once.

    While an extension module is being loaded it waits: some crash, or raise an error of their own, where Python is interrupted.
    """
    _ASKED.append(number)
    if number == signal.SIGTERM:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "setitimer") and _loads_an_extension(frame):
        signal.signal(signal.SIGALRM, interrupt)
        signal.setitimer(signal.ITIMER_REAL, SOON)
        return
    raise KeyboardInterrupt


def watch() -> None:
    """Start a thread that ends the process `GRACE` after Ctrl-C or SIGTERM, if the main thread has not done so by then.

    Python runs a signal's handler between two instructions of the main thread. During a compiled call there are none, and a
    call cannot be cancelled, so what waits for one waits until it returns. Files are written to their end before.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    Thread(target=_watch, args=(reader,), name="pcbench-signals", daemon=True).start()


def _watch(reader: int) -> None:
    """End the process some time after a signal whose number arrives."""
    number = os.read(reader, 1)[0]
    while number not in (signal.SIGINT, signal.SIGTERM):
        number = os.read(reader, 1)[0]
    sleep(GRACE)
    if ending.begin():
        cursor = CURSOR if sys.stderr.isatty() else ""
        with suppress(OSError, ValueError):
            print(f"{cursor}pcbench: {SENTENCE}", file=sys.stderr)
        ending.end(128 + number)


def _loads_an_extension(frame: FrameType | None) -> bool:
    while frame is not None:
        loading = frame.f_code.co_name in ("create_module", "exec_module")
        if loading and isinstance(frame.f_locals.get("self"), ExtensionFileLoader):
            return True
        frame = frame.f_back
    return False


def unraisable(found: Any) -> None:
    """Report what Python could not raise, as Python does, except a Ctrl-C: that is noted and raised later."""
    if not issubclass(found.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(found)


def is_interrupted() -> bool:
    """Say whether Ctrl-C was pressed."""
    return bool(_ASKED)


def exit_code() -> int:
    """Return the exit code of a program that was stopped: 128 and the number of the signal."""
    return 128 + _ASKED[0] if _ASKED else STOPPED


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt where Ctrl-C was pressed and a library has swallowed it."""
    if is_interrupted():
        raise KeyboardInterrupt


def stoppable(progress: Progress) -> Progress:
    """Return a Progress that hears the same, and stops where Ctrl-C was pressed."""

    def stopping(hear: Callable[..., None]) -> Callable[..., None]:
        def heard(*said: object) -> None:
            stop_if_asked()
            hear(*said)

        return heard

    return Progress(stopping(progress.begin), stopping(progress.step), stopping(progress.note))
