"""The command that says what there is."""

import json
from typing import Annotated

import typer

from pcbench.cli.shared import AsJson, console


def list_(
    what: Annotated[
        str | None,
        typer.Argument(
            help="observers, scenarios, plants, studies, axes, metrics or choices [default: the first four]"
        ),
    ] = None,
    name: Annotated[str | None, typer.Argument(help="one of them, in full: with options and ranges")] = None,
    as_json: AsJson = False,
) -> None:
    """List what there is, or one thing in full.

    Example: pcbench list observers pccebo
    """
    from pcbench.cli.catalogue import TITLES, WITHOUT_WORD, found
    from pcbench.cli.screen import listing

    said = {kind: found(kind, name) for kind in ([what] if what is not None else WITHOUT_WORD)}
    if as_json:
        print(json.dumps(said, indent=2))
    elif what is not None and name is not None:
        listing.whole(name, said[what][name], console())
    else:
        for kind, rows in said.items():
            listing.lines(TITLES.get(kind, kind), rows, console())
        kind = what or "observers"
        console().print(
            f"One of them in full: pcbench list {kind} {next(iter(said[kind]))}", highlight=False, markup=False
        )
        if what is None:
            console().print("There are also: pcbench list axes, metrics, choices", highlight=False, markup=False)
