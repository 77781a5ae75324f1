"""The options that several commands take, and what they mean."""

from typing import Annotated, Any

import typer

from pcbench.errors import UserError

RANK = "steady_rmse"  # what ranks observers unless said otherwise: the error once a run has settled


def _require_name(out: str | None) -> str | None:
    """Raise UserError for an empty name, before any work."""
    if out is not None and not out.strip():
        raise UserError(
            "--out: got an empty name, expected a file, a folder or a URI; give one, or leave the option out."
        )
    return out


def out(text: str) -> Any:
    """Return the option that says where a result goes."""
    return typer.Option("--out", "-o", help=text, callback=_require_name)


Json = Annotated[bool, typer.Option("--json", help="print JSON for a program instead of a table")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no table: only where the result is")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="change the study, e.g. axes.noise_std=0.1 (repeatable)"),
]
Folder = Annotated[str, typer.Argument(help="a folder or URI that pcbench run has made")]
Study = Annotated[str, typer.Argument(help="a study, a scenario or a TOML file")]
Scenario = Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")]
Observer = Annotated[str, typer.Argument(help="an observer's name")]
Observers = Annotated[str | None, typer.Option(help="comma-separated names, or all that can run")]
Signals = Annotated[
    str | None,
    typer.Option("--signal", help="which signals to show, with commas, or all [default: those a scenario is known by]"),
]
Signal = Annotated[str | None, typer.Option(help="of which signal [default: the first of a closing table]")]
Metric = Annotated[str, typer.Option(help="metric that ranks observers: pcbench list metrics")]
Late = Annotated[float | None, typer.Option(help="how late every sample is [s], where the log does not say")]
Start = Annotated[float | None, typer.Option(help="time of the log that is t = 0 [s] [default: its first]")]
