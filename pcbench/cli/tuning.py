"""The command that tunes."""

import json
from typing import Annotated, Any

import typer

from pcbench.cli.interrupts import stoppable
from pcbench.cli.recordings import Late
from pcbench.cli.shared import AsJson, Quiet, Set, console, names, out, setup
from pcbench.dataset.seed_ranges import Seeds
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
    optimizer: Annotated[
        str | None, typer.Option(help="descent (with gradients) or search [default: as can be]")
    ] = None,
    exact_objective: Annotated[
        bool,
        typer.Option(
            "--exact-objective", help="its expected value over all noise: no training seeds, no judging seeds"
        ),
    ] = False,
    only: Annotated[str | None, typer.Option(help="comma-separated options to tune [default: all that can be]")] = None,
    training_seeds: SeedRange = None,
    validation_seeds: SeedRange = None,
    log: Annotated[
        str | None, typer.Option(help="tune noise intensities by the likelihood of this log, judged on its last part")
    ] = None,
    delay: Late = None,
    changes: Set = None,
    folder: Annotated[str | None, out("folder for tuned.toml and the history; run again, it goes on")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Tune an observer's free parameters on some seeds, and judge them on others.

    Or, with --log, its noise intensities on a recording.

    Example: pcbench tune cart/gaussian pccebo --objective steady_rmse --out tuned
    Example: pcbench tune motor.toml kf --log flight --out tuned
    """
    setup()
    if log is not None:
        others = {
            "--objective": objective,
            "--signal": signal,
            "--optimizer": optimizer,
            "--training-seeds": training_seeds,
            "--validation-seeds": validation_seeds,
        }
        _alone(
            [
                name
                for name, value in (others | {"--exact-objective": exact_objective or None}).items()
                if value is not None
            ]
        )
        _on_log(log, scenario, observer, budget, only, delay, changes, folder, quiet, as_json)
        return
    if delay is not None:
        raise UserError("--delay: got one without --log, expected it with a log alone; leave it out, or give --log.")
    from pcbench.cli.render import gains
    from pcbench.cli.render.progress import bar
    from pcbench.gains import history, tune

    with bar(quiet or as_json, "designing gains") as progress:
        found = tune.tune(
            scenario,
            observer,
            budget=tune.BUDGET if budget is None else budget,
            objective=objective,
            signal=signal,
            optimizer=optimizer,
            exact_objective=exact_objective,
            only=None if only is None else names(only),
            training=_seeds(training_seeds, "--training-seeds", tune.TRAINING),
            judges=_seeds(validation_seeds, "--validation-seeds", tune.JUDGES),
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


def _alone(given: list[str]) -> None:
    """Raise UserError where what is of simulated runs is asked for with a log."""
    if given:
        raise UserError(
            f"{given[0]}: got it with --log, expected it for simulated runs alone: a log is tuned on by its likelihood; leave "
            f"{' and '.join(given)} out, or --log."
        )


def _on_log(
    log: str,
    plant: str,
    observer: str,
    budget: int | None,
    only: str | None,
    delay: float | None,
    changes: Any,
    folder: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Tune on a log and print what was found."""
    from pcbench.cli.render import comparison
    from pcbench.cli.render.progress import bar
    from pcbench.cli.render.tables import readable
    from pcbench.gains.tune import BUDGET
    from pcbench.playback.tuning import tune_log

    with bar(quiet or as_json, "designing gains") as progress:
        found = tune_log(
            log,
            plant,
            observer,
            budget=BUDGET if budget is None else budget,
            only=None if only is None else names(only),
            delay=delay,
            out=folder,
            overrides=changes,
            progress=stoppable(progress),
        )
    if as_json:
        print(readable(comparison.summary(found)))
    elif not quiet:
        comparison.tuned(found, observer, log, folder, console())
