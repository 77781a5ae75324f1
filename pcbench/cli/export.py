"""Observers outside of pcbench: one taken out as C, and those that live elsewhere, on the same draws."""

from typing import TYPE_CHECKING, Annotated

from pcbench.cli.interrupts import stop_if_asked
from pcbench.cli.options import RANK, Folder, Late, Metric, Quiet, Set, Signals, Start, Study
from pcbench.cli.shared import argument, chosen, console, names, option, out, say, setup, working
from pcbench.errors import UserError
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    from pcbench.dataset.result import Result

Name = Annotated[str, option("what the tables call it")]


def export(
    study: Annotated[str, argument("a scenario, or a study of one cell")],
    observer: Annotated[str, argument("an observer's name, or its label in the study")],
    folder: Annotated[str, out("folder for the files")],
    seed: Annotated[int, option("run that becomes the test vector, without --log", min=0, max=2**32 - 1)] = 0,
    log: Annotated[
        str | None, option("recording that the C has room for, and is tested on [default: none, a simulated run]")
    ] = None,
    delay: Late = None,
    start: Start = None,
    changes: Set = None,
    quiet: Quiet = False,
) -> None:
    """Write an observer as C99 with its gains, a run to test it by, and the program that replays it.

    If there is a C compiler, the program is compiled and run. A table shows how far its estimates are from those of the
    simulation, or with --log from those of `pcbench replay`.

    Example: pcbench export cart/white kf --out kf-in-c
    """
    setup()
    from pcbench.export import files

    files.require_place(folder)
    if log is None and (delay is not None or start is not None):
        raise UserError(
            "--delay and --start are for recordings: got no --log, expected one; give it, or leave them out."
        )
    found = files.export_observer(study, observer, seed, changes, log=log, delay=delay, start=start)
    stop_if_asked()
    made = files.write(found, folder)
    if quiet:
        print(folder)
        return
    if files.compiler() is None:
        say("there is no C compiler here, so nothing was compiled; the header contains the command.")
    else:
        from pcbench.cli.render import recordings

        double, single = (files.run_compiled(found, single=each) or "" for each in (False, True))
        of = "a simulated run" if log is None else log
        recordings.table(found, files.parse_replay(double), files.parse_replay(single), of, console())
        print(double.splitlines()[-1] + ", in double precision")
    label = found.about.label
    print(f"{len(made)} files in {folder}. Compile: cc -std=c99 -O2 -o replay {label}.c main.c -lm && ./replay")


def prepare(
    study: Study,
    folder: Annotated[str, out("folder, which becomes the study's")],
    seeds: Annotated[int | None, option("noise seeds for each cell")] = None,
    observers: Annotated[str | None, option("comma-separated names, or all that can run, to compare with")] = None,
    changes: Set = None,
    csv: Annotated[bool, option("the tables as CSV files too", "--csv")] = False,
    quiet: Quiet = False,
) -> None:
    """Write what every run measures and when it arrives, for a program in any language.

    Example: pcbench external prepare cart/white --seeds 16 --out cart
    """
    setup()
    from pcbench.external import export_draws
    from pcbench.planning import all_observers

    asked: TomlTable = {"seeds": seeds, "observers": names(observers) if observers else None}
    with working(quiet) as progress:
        export_draws.write(all_observers.grid_of(study, asked, changes or []), folder, csv, progress)
    print(f"{folder}/draws: samples, inputs and starts; columns, units and what to leave stand in its README.md")


def score(
    folder: Folder,
    estimates: Annotated[str, argument("a .parquet or .csv file with a row for each tick of each run")],
    name: Name,
    metric: Metric = RANK,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Add estimates made elsewhere to a study's tables, as one more observer.

    Example: pcbench external score cart estimates.parquet --name matlab-ekf
    """
    setup()
    from pcbench.external import score

    with working(quiet) as progress:
        result = score.score(folder, estimates, name, progress, say)
    _print_export(result, folder, metric, signal, quiet)


def run(
    folder: Folder,
    reference: Annotated[str, argument("make(cell, xhat0), such as mine.py:make", metavar="MODULE:NAME")],
    name: Name,
    metric: Metric = RANK,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Run an object in Python on a study's draws, one run at a time, and add it to the tables as one more observer.

    Example: pcbench external run cart mine.py:make --name filterpy-kf
    """
    setup()
    from pcbench.external import score

    with working(quiet) as progress:
        result = score.run(folder, reference, name, progress, say)
    _print_export(result, folder, metric, signal, quiet)


def _print_export(result: "Result", folder: str, metric: str, signal: str | None, quiet: bool) -> None:
    if quiet:
        print(folder)
        return
    from pcbench.cli.render import results

    results.closing(result, console(), metric, chosen(signal))
