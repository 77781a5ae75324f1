"""What a user's code raised, in one sentence: the exception's type, its message, and the user's own line."""

import os
import sysconfig
import traceback

from pcbench.errors import said

LIBRARIES = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")})
OURS = os.path.dirname(os.path.realpath(__file__))


def raised(error: BaseException) -> str:
    """Return `Type: message, file line n`, of the last line that is neither pcbench's nor a library's."""
    try:
        message = said(error)
    except Exception:  # of an exception that cannot even say what it is
        message = "without a message that can be read"
    place = line_of(error)
    return f"{type(error).__name__}{': ' if message else ''}{message}" + (f", {place}" if place else "")


def line_of(error: BaseException) -> str:
    """Return `file line n` of the user's code that an exception came from; empty where there is none."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{os.path.basename(error.filename)} line {error.lineno}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if _users(f.filename)]
    return f"{os.path.basename(frames[-1].filename)} line {frames[-1].lineno}" if frames else ""


def _users(file: str) -> bool:
    return not file.startswith("<frozen") and not os.path.realpath(file).startswith((*LIBRARIES, OURS + os.sep))
