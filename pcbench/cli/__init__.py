"""The command line: parse, call, print. An error that the user can correct is one sentence with exit code 2."""

import atexit
import gc
import os
import signal
import sys
from threading import Event

from pcbench.cli import interrupts
from pcbench.cli.interrupts import STOPPED, exit_code, interrupt, is_interrupted, stop_if_interrupted, unraisable
from pcbench.errors import UserError, first_sentence, missing, out_of_memory, printable
from pcbench.runtime import ending, thread_pools

__all__ = ["main", "program"]
GC_THRESHOLD = 100_000  # new objects before Python's garbage collector runs; its default is too often during imports


def program() -> None:
    """Run `main` in its own process, and end it without the destructors of compiled libraries.

    These sometimes abort at exit while a library's thread still waits. Files are closed and `atexit` functions run as usual.
    """
    code = [1]  # after an internal error, which Python prints
    atexit.register(lambda: ending.end(code[0]))  # the first function registered is called last
    try:
        main()
    except SystemExit as done:
        code[0] = done.code if isinstance(done.code, int) else 1
        raise


def main() -> None:
    """Run the command line and exit: 0 success, 1 a check failed, 2 a user error, 130 interrupted, 143 by SIGTERM.

    Everything is imported here, so that Ctrl-C is handled from the start.
    """
    code = 0
    gc.set_threshold(GC_THRESHOLD)
    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    interrupts.watch()
    sys.unraisablehook = unraisable
    thread_pools.one()
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA's warnings about slow compilation break the progress bar
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # plugins would read the metadata of all packages
    try:
        from pcbench.cli.commands import app
        from pcbench.cli.shared import set_ascii_fallback

        set_ascii_fallback()
        code = app(sys.argv[1:] or ["--help"], prog_name="pcbench", standalone_mode=False) or 0
        stop_if_interrupted()
        if code == STOPPED:  # some releases of the command-line library convert Ctrl-C to an exit code
            raise KeyboardInterrupt
    except UserError as error:
        code = _complain(str(error))
    except KeyboardInterrupt:
        code = _exit_interrupted()
    except BrokenPipeError:
        code = 141
    except ModuleNotFoundError as error:
        if (error.name or "pcbench").split(".")[0] == "pcbench":  # an internal error
            raise
        code = _complain(missing(str(error.name)))
    except Exception as error:
        if is_interrupted():  # a library's exception caused by Ctrl-C
            code = _exit_interrupted()
        elif out_of_memory(error):
            code = _complain(
                f"memory ran out ({first_sentence(error)}), expected more; end other programs, or compute less at a time."
            )
        elif hasattr(error, "format_message"):  # usage errors of the command-line library
            code = _complain(_usage_sentence(error))
        else:
            raise
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the work is complete
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # skips a last garbage collection, which takes a third of a second
    if code == exit_code():
        ending.end(code)  # a program in another thread would crash the interpreter at exit
    sys.exit(code)


def _usage_sentence(error: Exception) -> str:
    """Return a usage error as one sentence, with the help command."""
    text = str(error.format_message()).strip()  # type: ignore[attr-defined]
    text = text.replace("Value error, ", "").replace(". Did you mean", "; did you mean")
    text = text.replace(" Did you mean", "; did you mean")
    context = getattr(error, "ctx", None)
    return f"{text.rstrip('.?')}; see {context.command_path if context else 'pcbench'} --help."


def _exit_interrupted() -> int:
    if not ending.begin():
        Event().wait()  # the other thread reports it, and ends the process
    return _complain(interrupts.SENTENCE, exit_code())


def _complain(sentence: str, code: int = 2) -> int:
    print(f"pcbench: {printable(sentence)}", file=sys.stderr)
    return code
