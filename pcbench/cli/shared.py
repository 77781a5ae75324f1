"""What commands share: the application, options that several take, and where they speak."""

import codecs
import io
import sys
from typing import Annotated, Any

import typer

app = typer.Typer(
    name="pcbench",
    help="Which observer should I use when my measurements are sampled, late, noisy or lost, and how sure am I?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

PLAIN = {"±": "+-", "…": "...", "–": "-", "·": ".", "µ": "u", "²": "^2", "→": "->", "≤": "<=", "≥": ">="}  # in ASCII
AsJson = Annotated[bool, typer.Option("--json", help="print JSON for a program instead of a table")]
Quiet = Annotated[bool, typer.Option("--quiet", help="no progress and no table")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="change the study, e.g. axes.noise_std=0.1 (repeatable)"),
]
Folder = Annotated[str, typer.Argument(help="a folder or URI that pcbench run has made")]


def speak() -> None:
    """Let output never fail for a letter that the terminal's encoding does not have: it stands for itself in ASCII."""
    codecs.register_error("pcbench", _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="pcbench")


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(PLAIN.get(c, "?") for c in error.object[error.start : error.end]), error.end


def say(sentence: str) -> None:
    """Tell the user something, beside what a command prints."""
    print(f"pcbench: {sentence}", file=sys.stderr)


def console() -> Any:
    """Return where tables are printed: as wide as the terminal, or 160 columns into a file."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=160)


def setup() -> None:
    """Set jax up for a command that computes: float64, and where compiled programs are kept."""
    from pcbench import machine

    machine.setup()


def names(text: str) -> list[str]:
    """Return the names of a comma-separated list."""
    return [name.strip() for name in text.split(",")]
