"""Commands for observers that live elsewhere: what runs measure as files, and estimates as one more observer."""

from typing import Annotated, Any

import typer

from pcbench.cli.interrupts import stoppable
from pcbench.cli.shared import (
    RANKS,
    Folder,
    Metric,
    Quiet,
    Set,
    Signals,
    Study,
    chosen,
    console,
    names,
    out,
    say,
    setup,
)

Name = Annotated[str, typer.Option(help="what the tables call it")]


def prepare(
    study: Study,
    folder: Annotated[str, out("folder, which becomes the study's")],
    seeds: Annotated[int | None, typer.Option(help="noise seeds for each cell")] = None,
    observers: Annotated[
        str | None, typer.Option(help="comma-separated names, or all that can run, to compare with")
    ] = None,
    changes: Set = None,
    csv: Annotated[bool, typer.Option("--csv", help="the tables as CSV files too")] = False,
    quiet: Quiet = False,
) -> None:
    """Write what every run measures and when it arrives, for a program in any language.

    Example: pcbench external prepare cart/white --seeds 16 --out cart
    """
    setup()
    from pcbench.cli.render.progress import bar
    from pcbench.external import export_draws
    from pcbench.planning import all_observers

    asked: dict[str, Any] = {"seeds": seeds, "observers": names(observers) if observers else None}
    with bar(quiet) as progress:
        export_draws.write(all_observers.grid_of(study, asked, changes or []), folder, csv, stoppable(progress))
    print(f"{folder}/draws: samples, inputs and starts; columns, units and what to leave stand in its README.md")


def score(
    folder: Folder,
    estimates: Annotated[str, typer.Argument(help="a .parquet or .csv file with a row for each tick of each run")],
    name: Name,
    metric: Metric = RANKS,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Add estimates made elsewhere to a study's tables, as one more observer.

    Example: pcbench external score cart estimates.parquet --name matlab-ekf
    """
    setup()
    from pcbench.cli.render.progress import bar
    from pcbench.external import score

    with bar(quiet) as progress:
        result = score.score(folder, estimates, name, stoppable(progress), say)
    _shown(result, folder, metric, signal, quiet)


def run(
    folder: Folder,
    reference: Annotated[str, typer.Argument(metavar="MODULE:NAME", help="make(cell, xhat0), such as mine.py:make")],
    name: Name,
    metric: Metric = RANKS,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Run an object in Python on a study's draws, one run at a time, and add it to the tables as one more observer.

    Example: pcbench external run cart mine.py:make --name filterpy-kf
    """
    setup()
    from pcbench.cli.render.progress import bar
    from pcbench.external import score

    with bar(quiet) as progress:
        result = score.run(folder, reference, name, stoppable(progress), say)
    _shown(result, folder, metric, signal, quiet)


def _shown(result: Any, folder: str, metric: str, signal: str | None, quiet: bool) -> None:
    if quiet:
        print(folder)
        return
    from pcbench.cli.render import results

    results.closing(result, console(), metric, chosen(signal))
