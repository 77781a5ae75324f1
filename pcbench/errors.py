"""User errors, and exceptions in user code, as one sentence: the place, the value, what was expected, and how to correct it."""

import difflib
import errno
import os
import re
import sysconfig
import traceback
from collections.abc import Iterable
from reprlib import Repr

HARMLESS_PARAMETER = re.compile(
    r"(region|scheme|allow_bucket_creation|allow_bucket_deletion)=[\w-]*"
)  # query parameters that may be shown in an address
LONGEST = 100  # largest length of a quoted value
LIBRARIES = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")})
OURS = os.path.dirname(os.path.realpath(__file__))


def printable(text: str, but: str = "") -> str:
    """Return a text with escapes for characters that cannot be printed, except `but`."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c in but else ascii(c)[1:-1] for c in text)


class UserError(ValueError):
    """A mistake that the user can correct, as one sentence. The command line prints it and exits with code 2.

    The sentence is one line: characters that cannot be printed are escaped.
    """

    def __init__(self, sentence: str):
        super().__init__(printable(sentence))


class DigitsError(UserError):
    """A state so large that rounding dominates the errors. The sentence names the grid point and the size."""


class DesignError(UserError):
    """Gains that were not found or not certified. The sentence has the margin and the solver's status."""


def nearest_name(got: str, valid: Iterable[str], cutoff: float = 0.5) -> str:
    """Return the valid name most similar to `got`, ignoring case; empty if no similarity reaches `cutoff` (0 to 1)."""
    lower = {name.lower(): name for name in valid}
    matches = difflib.get_close_matches(got[:LONGEST].lower(), lower, n=1, cutoff=cutoff)
    return lower[matches[0]] if matches else ""


def unknown(where: str, kind: str, got: str, valid: Iterable[str]) -> UserError:
    """Return an error that `got` is not a valid `kind`, with the nearest valid name and all of them."""
    names = sorted(valid)
    nearest = nearest_name(got, names)
    hint = f"did you mean '{nearest}'? " if nearest else ""
    return UserError(f"{where}: '{short(got)}' is no {kind}; {hint}valid: {', '.join(names) or 'none'}.")


EXTRAS = {"distributed": "dask", "control": "control"} | dict.fromkeys(
    ("rosbags", "mcap", "mcap-ros2", "pyulog", "h5py"), "logs"
)  # by package, the extra of pcbench that installs it


def missing(module: str) -> str:
    """Return a message that a library is not installed, with the command that installs it."""
    package = module.split(".")[0].replace("_", "-")
    requirement = f"'pcbench[{EXTRAS[package]}]'" if package in EXTRAS else package
    return f"got no package '{package}', expected it for this command; install it: pip install {requirement}."


def short(text: str) -> str:
    """Return a text for quotation in a sentence: a long text is shortened in the middle."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 23]}...{text[-20:]}"


def redact_address(text: str) -> str:
    """Return an address without secrets, for a sentence or a file.

    Everything between the scheme and the last `@` is left out, and all of its query except a few harmless parameters.
    """
    scheme, mark, address = text.partition("://")
    if not mark:
        return text
    place, _, query = address.rpartition("@")[2].partition("#")[0].partition("?")
    parameters = [p for p in query.split("&") if HARMLESS_PARAMETER.fullmatch(p)]
    return f"{scheme}://{place}" + (f"?{'&'.join(parameters)}" if parameters else "")


def first_sentence(error: object) -> str:
    """Return the first sentence of another library's message, without its full stop."""
    return short(re.split(r"\.\s|\n", str(error).strip())[0].rstrip("."))


def out_of_memory(error: BaseException) -> bool:
    """Return whether an error means that memory ran out: from Python, the system, a library or a compiled program."""
    of_system = isinstance(error, OSError) and error.errno == errno.ENOMEM
    return isinstance(error, MemoryError) or of_system or str(error).startswith("RESOURCE_EXHAUSTED")


def unreadable(error: BaseException, where: str, instead: str) -> UserError:
    """Return an error for an unreadable file: out of memory, or the reader's message with what was expected `instead`."""
    reason = first_sentence(error) if str(error) else "it ends too early"
    if out_of_memory(error):
        return UserError(f"{where}: memory ran out while it was read ({reason}), expected more; end other programs.")
    return UserError(f"{where}: {reason}; expected {instead}.")


def brief_repr(value: object) -> str:
    """Return the repr of a value for quotation in a sentence, shortened if necessary."""
    brief = Repr()
    brief.maxstring = brief.maxother = brief.maxlong = LONGEST
    brief.maxlist = brief.maxtuple = brief.maxdict = 8
    brief.maxlevel = 4
    try:
        return short(brief.repr(value))
    except ValueError:  # an integer with too many digits
        return f"a value of type {type(value).__name__} that is too long to be written here"


def describe_exception(error: BaseException) -> str:
    """Return `Type: message, file line n`, for the last line in user code."""
    try:
        message = first_sentence(error)
    except Exception:  # an exception whose message raises
        message = "without a message that can be read"
    place = line_of(error)
    return f"{type(error).__name__}{': ' if message else ''}{message}" + (f", {place}" if place else "")


def is_ours(definition: object) -> bool:
    """Return whether a function or a class is part of pcbench."""
    return str(getattr(definition, "__module__", "")).split(".")[0] == "pcbench"


def line_of(error: BaseException) -> str:
    """Return `file line n` of the user code that raised an exception; empty if there is none."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{os.path.basename(error.filename)} line {error.lineno}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if _users(f.filename)]
    return f"{os.path.basename(frames[-1].filename)} line {frames[-1].lineno}" if frames else ""


def _users(file: str) -> bool:
    return not file.startswith("<frozen") and not os.path.realpath(file).startswith((*LIBRARIES, OURS + os.sep))
