"""Terminal input and output of commands: tables, sentences, progress, options, in characters that the terminal supports."""

import codecs
import io
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pcbench.cli.interrupts import stoppable
from pcbench.errors import UserError, printable
from pcbench.runtime.progress import Progress

if TYPE_CHECKING:
    from pcbench.cli.render.tables import Screen

ASCII = {"±": "+-", "…": "...", "–": "-", "·": ".", "µ": "u", "²": "^2", "→": "->", "≤": "<=", "≥": ">="}
WIDE = 100  # width of a table in a file, if COLUMNS is not set


def set_ascii_fallback() -> None:
    """Replace characters that the terminal's encoding lacks by ASCII, so that output does not fail."""

    def in_ascii(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        return "".join(ASCII.get(c, "?") for c in error.object[error.start : error.end]), error.end

    codecs.register_error("pcbench", in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="pcbench")


def say(*sentences: str) -> None:
    """Print sentences on standard error."""
    for sentence in sentences:
        print(f"pcbench: {printable(sentence)}", file=sys.stderr)


def write(text: str) -> None:
    """Print a text of several lines unchanged for a program or a file, with unprintable characters escaped."""
    print(printable(text, but="\n\t"), end="")


def write_new(path: Path, text: str, where: str) -> None:
    """Write a text into a file that does not exist; raise UserError if it does, or cannot be written."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise UserError(f"{where}: {path} cannot be written ({error.strerror}); give another name.") from None


def console() -> "Screen":
    """Return the console for tables, as wide as the terminal or as COLUMNS."""
    from pcbench.cli.render.tables import Screen

    width = os.environ.get("COLUMNS", "")
    return Screen() if sys.stdout.isatty() else Screen(width=int(width) if width.isdecimal() and int(width) else WIDE)


@contextmanager
def show_progress(quiet: bool, first: str = "") -> Iterator[Progress]:
    """Yield a Progress that draws lines on standard error, and stops if Ctrl-C was pressed."""
    from pcbench.cli.render.progress import bar

    with bar(quiet, first) as progress:
        yield stoppable(progress)


def setup() -> None:
    """Set jax up for a command that computes: float64, and the caches of traced and compiled programs."""
    from pcbench.runtime import config, program_store

    config.setup()
    program_store.allow()


def require_effect(options: Mapping[str, object], context: str, advice: str) -> None:
    """Raise UserError for an option that has no effect in this `context`, such as "with --quiet"."""
    for name, value in options.items():
        if value is not None and value is not False:
            raise UserError(f"{name} has no effect {context}; {advice}.")


def names(text: str) -> list[str]:
    """Return the names of a comma-separated list."""
    return [name.strip() for name in text.split(",")]


def parse_signals(signals: str | None) -> list[str] | None:
    """Return the requested signals: None if not given, an empty list for all."""
    return None if signals is None else [] if signals.strip() == "all" else names(signals)


def _require_name(out: str | None) -> str | None:
    """Raise UserError for an empty name, before any work."""
    if out is not None and not out.strip():
        raise UserError(
            "--out: got an empty name, expected a file, a folder or a URI; give one, or leave the option out."
        )
    return out


def option(text: str, *names: str, **kwargs: Any) -> Any:
    """Return an option with this help text."""
    return typer.Option(*names, help=text, **kwargs)


def argument(text: str, **kwargs: Any) -> Any:
    """Return an argument with this help text."""
    return typer.Argument(help=text, **kwargs)


def out(text: str) -> Any:
    """Return the option for the output of a command."""
    return option(text, "--out", "-o", callback=_require_name)
