"""The command that checks what is a user's own: an observer, a plant, a controller, a scenario, a study."""

import contextlib
import json
import sys
from typing import Annotated, Any

import typer

from pcbench import toml_text
from pcbench.cli.shared import AsJson, console, setup
from pcbench.errors import UserError, short


def check(
    target: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:NAME|FILE.toml",
            help="a module's name or a .py file and an observer, a plant, a controller or a scenario in it; or a study file",
        ),
    ],
    scenario: Annotated[
        str | None,
        typer.Option(
            help="what it is tried on: a scenario, a study file or MODULE:NAME with one; default: cart/white, a plant alone"
        ),
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="an option of the observer or controller, a number of the plant (repeatable)",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check what is your own: does it keep to the protocol, does the loop settle? Exit code 1 where a check fails.

    Examples: pcbench check mine.py:nudge --set share=0.2;  pcbench check mine.py:pendulum;  pcbench check motor.toml
    """
    given = dict(map(_option, options or []))
    setup()
    from pcbench import checking
    from pcbench.checking.targets import FAILS
    from pcbench.cli.render import gains

    with contextlib.redirect_stdout(sys.stderr):  # what the user's code prints is no part of the answer
        kind, label, on, found = checking.check(target, scenario, given)
    if as_json:
        said = {"kind": kind, kind: label} | ({"scenario": on} if on and kind != "scenario" else {})
        print(json.dumps(said | {"checks": [f._asdict() for f in found]}, indent=2))
    else:
        gains.checked(f"{kind} {label}" + (f" on {on}" if on else ""), found, console())
    if any(f.verdict == FAILS for f in found):
        raise typer.Exit(1)


def _option(text: str) -> tuple[str, Any]:
    """Return the name and the value of KEY=VALUE; a value is TOML, or a plain word."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UserError(f"check --set: got '{short(text)}', expected KEY=VALUE such as share=0.2; write it so.")
    try:
        return name.strip(), toml_text.parse(f"value = {value}")["value"]
    except ValueError:
        return name.strip(), value.strip()
