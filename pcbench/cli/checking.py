"""The command that checks a user's own observer."""

import contextlib
import json
import sys
import tomllib
from typing import Annotated, Any

import typer

from pcbench.cli.shared import AsJson, console, setup
from pcbench.errors import UserError, short


def check(
    observer: Annotated[
        str, typer.Argument(metavar="MODULE:OBSERVER", help="a module's name or a .py file, and an observer in it")
    ],
    scenario: Annotated[str, typer.Option(help="the scenario whose plant it is tried on")] = "cart/white",
    options: Annotated[
        list[str] | None, typer.Option("--set", metavar="OPTION=VALUE", help="an option of the observer (repeatable)")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check an observer of your own against the protocol. Exit code 1 where a check fails.

    Example: pcbench check mine.py:nudge --set share=0.2
    """
    given = dict(map(_option, options or []))
    setup()
    from pcbench import checking
    from pcbench.cli.screen import gains

    with contextlib.redirect_stdout(sys.stderr):  # what the user's code prints is no part of the answer
        label, found = checking.check(observer, scenario, given)
    if as_json:
        print(json.dumps({"observer": label, "scenario": scenario, "checks": [f._asdict() for f in found]}, indent=2))
    else:
        gains.checked(f"{label} on {scenario}", found, console())
    if any(f.verdict == "fails" for f in found):
        raise typer.Exit(1)


def _option(text: str) -> tuple[str, Any]:
    """Return the name and the value of OPTION=VALUE; a value is TOML, or a plain word."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UserError(f"check --set: got '{short(text)}', expected OPTION=VALUE such as share=0.2; write it so.")
    try:
        return name.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name.strip(), value.strip()
