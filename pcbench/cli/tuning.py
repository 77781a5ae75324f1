"""The command that tunes."""

import json
from typing import Annotated, Any

import typer

from pcbench.cli.shared import AsJson, Quiet, Set, console, names, out, setup
from pcbench.cli.stopping import stoppable
from pcbench.dataset.seeds import Seeds
from pcbench.errors import UserError

SeedRange = Annotated[str | None, typer.Option(metavar="FIRST:END", help="seeds, the end left out")]


def tune(
    scenario: Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")],
    observer: Annotated[str, typer.Argument(help="an observer's name")],
    budget: Annotated[int | None, typer.Option(help="times that all training runs are simulated [default: 60]")] = None,
    objective: Annotated[
        str | None, typer.Option(help="metric of the tables to make small [default: rmse; exact: pooled_rmse]")
    ] = None,
    signal: Annotated[str | None, typer.Option(help="of which signal [default: the first of a closing table]")] = None,
    method: Annotated[str | None, typer.Option(help="descent (with gradients) or search [default: as can be]")] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="its expected value over all noise: no training seeds, no judging seeds")
    ] = False,
    only: Annotated[str | None, typer.Option(help="comma-separated options to tune [default: all that can be]")] = None,
    train: SeedRange = None,
    judge: SeedRange = None,
    changes: Set = None,
    folder: Annotated[str | None, out("folder for tuned.toml and the history; run again, it goes on")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Tune an observer's free parameters on some seeds, and judge them on others.

    Example: pcbench tune cart/gaussian pccebo --objective tail_rmse --out tuned
    """
    setup()
    from pcbench.cli.screen import gains
    from pcbench.cli.screen.progress import bar
    from pcbench.gains import history, tune

    with bar(quiet or as_json, "designing gains") as progress:
        found = tune.tune(
            scenario,
            observer,
            budget=tune.BUDGET if budget is None else budget,
            objective=objective,
            signal=signal,
            method=method,
            exact=exact,
            only=None if only is None else names(only),
            training=_seeds(train, "--train", tune.TRAINING),
            judges=_seeds(judge, "--judge", tune.JUDGES),
            out=folder,
            overrides=changes,
            progress=stoppable(progress),
        )
    if as_json:
        judged = [history.plain(j) for j in found.judged]
        goal = {"metric": found.objective.metric, "signal": found.objective.name, "unit": found.objective.unit}
        summary: dict[str, Any] = {
            "start": found.start,
            "found": found.found,
            "kept_start": found.kept_start,
            "goal": goal,
        }
        summary |= {"certified": found.certified, "exact": found.exact}
        print(json.dumps(summary | {"judged": judged, "points": len(found.points), "method": found.method}, indent=2))
    elif not quiet:
        gains.tuned(found, observer, folder, console())


def _seeds(text: str | None, where: str, default: Seeds) -> Seeds:
    """Return the seeds of FIRST:END."""
    if text is None:
        return default
    first, colon, end = text.partition(":")
    if not (colon and first.strip().isdecimal() and end.strip().isdecimal() and int(first) < int(end)):
        raise UserError(f"{where}: got '{text}', expected FIRST:END such as 0:256; write that.")
    return Seeds(int(first), int(end))
