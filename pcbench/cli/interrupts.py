"""Ctrl-C and SIGTERM: recorded, raised again if a library suppresses them; during a compiled call the process ends."""

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

STOPPED = 130  # exit code after Ctrl-C; SIGTERM: 143
SOON = 0.05  # [s] until the next attempt
GRACE = 1.0  # [s] for the main thread to end the process itself
SENTENCE = "stopped; every file already written is complete."
CURSOR = "\r\x1b[K\x1b[?25h"  # terminal codes: clear the line of a progress bar, and show the cursor
_SIGNALS: list[int] = []


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt: the handler of SIGINT and SIGTERM. A second SIGTERM ends the process at once.

    While an extension module is being loaded the interrupt is postponed: some modules crash if Python is interrupted then.
    """
    _SIGNALS.append(number)
    if number == signal.SIGTERM:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "setitimer") and _loads_an_extension(frame):
        signal.signal(signal.SIGALRM, interrupt)
        signal.setitimer(signal.ITIMER_REAL, SOON)
        return
    raise KeyboardInterrupt


def watch() -> None:
    """Start a thread that ends the process `GRACE` after Ctrl-C or SIGTERM, unless the main thread does so before.

    Python runs a signal handler between two instructions of the main thread. A compiled call has none and cannot be cancelled,
    so its handler would wait until the call returns. Files are completed before.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    Thread(target=_watch, args=(reader,), name="pcbench-signals", daemon=True).start()


def _watch(reader: int) -> None:
    """End the process a fixed time after a signal arrives."""
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
        is_loader = frame.f_code.co_name in ("create_module", "exec_module")
        if is_loader and isinstance(frame.f_locals.get("self"), ExtensionFileLoader):
            return True
        frame = frame.f_back
    return False


def unraisable(args: Any) -> None:
    """Report an exception that Python could not raise, as Python does; a Ctrl-C is recorded and raised later instead."""
    if not issubclass(args.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(args)


def is_interrupted() -> bool:
    """Return whether Ctrl-C was pressed."""
    return bool(_SIGNALS)


def exit_code() -> int:
    """Return the exit code of an interrupted program: 128 plus the signal number."""
    return 128 + _SIGNALS[0] if _SIGNALS else STOPPED


def stop_if_interrupted() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed and a library has suppressed it."""
    if is_interrupted():
        raise KeyboardInterrupt


def stoppable(progress: Progress) -> Progress:
    """Return a Progress that also stops if Ctrl-C was pressed."""

    def wrap(report: Callable[..., None]) -> Callable[..., None]:
        def wrapper(*args: object) -> None:
            stop_if_interrupted()
            report(*args)

        return wrapper

    return Progress(wrap(progress.begin), wrap(progress.step), wrap(progress.note))
