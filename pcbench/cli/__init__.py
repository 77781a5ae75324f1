"""The command line: parse, call, print. Whatever the user can mend is one sentence and exit code 2."""

import atexit
import gc
import os
import signal
import sys
from threading import Event

from pcbench.cli import interrupts
from pcbench.cli.interrupts import STOPPED, exit_code, interrupt, is_interrupted, stop_if_asked, unraisable
from pcbench.errors import UserError, first_sentence, missing, out_of_memory, printable
from pcbench.runtime import ending, thread_pools

__all__ = ["main", "program"]
MANY = 100_000  # new objects before Python looks for cycles: by thousands it does so all the time that it imports


def program() -> None:
    """Run `main` in a process of its own, and end it without the destructors of compiled libraries.

    While a thread of a library still waits, these abort now and then, after all is done. Files are closed and functions of
    `atexit` called as always.
    """
    code = [1]  # of a fault of ours, which Python prints
    atexit.register(lambda: ending.end(code[0]))  # the first that is registered is called last
    try:
        main()
    except SystemExit as done:
        code[0] = done.code if isinstance(done.code, int) else 1
        raise


def main() -> None:
    """Run the command line and exit: 0 done, 1 a check found something wrong, 2 a mistake to mend, 130 stopped, 143 by SIGTERM.

    Everything is imported here, so that Ctrl-C is heard from the start.
    """
    code = 0
    gc.set_threshold(MANY)
    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    interrupts.watch()
    sys.unraisablehook = unraisable
    thread_pools.one()
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # no lines of XLA about slow compiling through the progress bar
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it would read the metadata of all packages
    try:
        from pcbench.cli.commands import app
        from pcbench.cli.shared import speak

        speak()
        code = app(sys.argv[1:] or ["--help"], prog_name="pcbench", standalone_mode=False) or 0
        stop_if_asked()
        if code == STOPPED:  # some releases of the command-line library turn Ctrl-C into an exit code themselves
            raise KeyboardInterrupt
    except UserError as error:
        code = _complain(str(error))
    except KeyboardInterrupt:
        code = _exit_interrupted()
    except BrokenPipeError:
        code = 141
    except ModuleNotFoundError as error:
        if (error.name or "pcbench").split(".")[0] == "pcbench":  # ours: a fault of ours
            raise
        code = _complain(missing(str(error.name)))
    except Exception as error:
        if is_interrupted():  # what a library makes of it
            code = _exit_interrupted()
        elif out_of_memory(error):
            code = _complain(
                f"memory ran out ({first_sentence(error)}), expected more; end other programs, or compute less at a time."
            )
        elif hasattr(error, "format_message"):  # as the command line's own usage errors have
            code = _complain(_of_usage(error))
        else:
            raise
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is done is done
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # the interpreter takes a third of a second to look once more through all that was imported
    if code == exit_code():
        ending.end(code)  # a program that computes in another thread crashes the interpreter that ends beside it
    sys.exit(code)


def _of_usage(error: Exception) -> str:
    """A usage error as one sentence, with the help that tells more."""
    text = str(error.format_message()).strip()  # type: ignore[attr-defined]
    text = (
        text.replace("Value error, ", "")
        .replace(". Did you mean", "; did you mean")
        .replace(" Did you mean", "; did you mean")
    )
    context = getattr(error, "ctx", None)
    return f"{text.rstrip('.?')}; see {context.command_path if context else 'pcbench'} --help."


def _exit_interrupted() -> int:
    if not ending.begin():
        Event().wait()  # another thread says so, and ends the process
    return _complain(interrupts.SENTENCE, exit_code())


def _complain(sentence: str, code: int = 2) -> int:
    print(f"pcbench: {printable(sentence)}", file=sys.stderr)
    return code
