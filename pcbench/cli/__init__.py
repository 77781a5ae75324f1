"""The command line: parse, call, print. Whatever the user can mend is one sentence and exit code 2."""

import signal
import sys

import typer

from pcbench.cli import checking, datasets, observers, papers, reports, runs, tuning
from pcbench.cli.shared import app, say, speak
from pcbench.cli.stopping import STOPPED, asked, interrupt, stop_if_asked, unraisable
from pcbench.errors import UserError

__all__ = ["main"]
COMMANDS = (observers, checking, runs, reports, tuning, datasets, papers)  # each registers its own


def main() -> None:
    """Run the command line and exit: 0 done, 2 a mistake that the user can mend, 130 stopped."""
    code = 0
    signal.signal(signal.SIGINT, interrupt)
    speak()
    sys.unraisablehook = unraisable
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False) or 0
        stop_if_asked()
        if code == STOPPED:  # some releases of the command-line library turn Ctrl-C into an exit code themselves
            raise KeyboardInterrupt
    except UserError as error:
        code = _complain(str(error))
    except (KeyboardInterrupt, typer.Abort):
        code = _stopped()
    except BrokenPipeError:
        code = 141
    except Exception as error:
        if asked():  # what a library makes of it
            sys.exit(_stopped())
        if not hasattr(error, "format_message"):  # the command line's own usage errors have one
            raise
        code = _complain(error.format_message().rstrip(".") + "; see pcbench --help.")
    sys.exit(code)


def _stopped() -> int:
    return _complain("stopped; every file already written is complete.", STOPPED)


def _complain(sentence: str, code: int = 2) -> int:
    say(sentence)
    return code
