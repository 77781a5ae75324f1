"""The command that answers what suffices."""

import re
from pathlib import Path
from typing import Annotated

import typer

from pcbench.cli.options import RANKS, AsJson, Observers, Quiet, Set, Signal, names, out
from pcbench.cli.shared import console, say, setup, working


def find_limit(
    study: Annotated[str, typer.Argument(help="a study of one scenario, a scenario or a TOML file")],
    threshold: Annotated[float, typer.Option(help="the limit, in the unit of the metric")],
    axis: Annotated[
        list[str],
        typer.Option(
            metavar="AXIS",
            help="sampling_period, delay[0], plant.lam ...: pcbench list axes; given twice: for each value of the first axis "
            "the largest of the second",
        ),
    ],
    metric: Annotated[str, typer.Option(help="what is to stay below: pcbench list metrics")] = RANKS,
    signal: Signal = None,
    between: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--range",
            metavar="LOW HIGH",
            help="where to search, of two axes the first [default: as the study or the scenario suggests]",
        ),
    ] = None,
    tol: Annotated[
        float | None, typer.Option(help="how precisely, in the axis' unit [default: 5 % of the value]")
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="noise seeds for each value")] = None,
    max_seeds: Annotated[
        int | None, typer.Option(help="of a value whose interval holds the limit [default: 16 times the study's]")
    ] = None,
    observers: Observers = None,
    changes: Set = None,
    folder: Annotated[
        str | None, out("folder or URI for all that is run; asked again, it goes on [default: results/STUDY-AXIS]")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="remove what stands there, and start over")] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Find the largest period, delay, loss ... at which an error surely stays below a limit, for each observer.

    Example: pcbench find-limit cart/white --threshold 0.1 --axis sampling_period
    """
    setup()
    from pcbench.cli.render import limits
    from pcbench.cli.render.tables import readable
    from pcbench.limits import find_limit
    from pcbench.study import parse

    into = folder
    if into is None:
        name = f"{parse.outline(study, changes or []).name}-{'-'.join(axis)}"
        into = str(Path("results") / re.sub(r"[^\w.+-]+", "-", name).strip("-"))
    with working(quiet or as_json, "designing gains") as progress:
        table = find_limit.find_limit(
            study,
            axis=axis[0] if len(axis) == 1 else axis,
            threshold=threshold,
            metric=metric,
            signal=signal,
            between=between,
            tol=tol,
            seeds=seeds,
            max_seeds=max_seeds,
            observers=None if observers is None else names(observers),
            out=into,
            overrides=changes,
            overwrite=overwrite,
            progress=progress,
            say=say,
        )
    if as_json:
        print(readable(table.attrs | {"answers": table.to_dict("records")}))
    elif quiet:
        print(into)
    elif len(axis) > 1:
        limits.frontier(table, console())
        console().say(f"Each value has its own study in {into}")
    else:
        limits.answers(table, console())
        console().say(f"Now look at it: pcbench report {into}")
