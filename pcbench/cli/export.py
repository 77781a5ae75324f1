"""Commands for observers outside pcbench: `export` to C, and `external` for other programs."""

from typing import TYPE_CHECKING, Annotated

from pcbench.cli.interrupts import stop_if_interrupted
from pcbench.cli.options import RANK, DrawsFolder, Late, Metric, Quiet, Set, Signals, Start, Study
from pcbench.cli.shared import argument, console, names, option, out, parse_signals, say, setup, show_progress
from pcbench.errors import UserError
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    from pcbench.dataset.result import Result

Name = Annotated[str, option("Name in the tables")]


def export(
    study: Annotated[str, argument("Scenario, or study with one grid point")],
    observer: Annotated[str, argument("Name of an observer, or its label in the study")],
    folder: Annotated[str, out("Folder for the files")],
    seed: Annotated[int, option("Seed of the run for the test (without --log)", min=0, max=2**32 - 1)] = 0,
    log: Annotated[
        str | None, option("Recording for the test and for the size of the buffers [default: a simulated run]")
    ] = None,
    delay: Late = None,
    start: Start = None,
    changes: Set = None,
    quiet: Quiet = False,
) -> None:
    """Write an observer as C99 with its gains, a test run, and a program that replays this run.

    If a C compiler is installed, pcbench compiles the program and runs it. A table shows the differences between its estimates
    and those of the simulation, or with --log those of `pcbench replay`.

    Example: pcbench export cart/white kf --out kf-in-c
    """
    setup()
    from pcbench.export import files

    files.require_place(folder)
    if log is None and (delay is not None or start is not None):
        raise UserError("--delay and --start have an effect only with --log; add --log, or leave them out.")
    result = files.export_observer(study, observer, seed, changes, log=log, delay=delay, start=start)
    stop_if_interrupted()
    paths = files.write(result, folder)
    if quiet:
        print(folder)
        return
    if files.compiler() is None:
        say("No C compiler was found, so nothing was compiled; the header contains the command.")
    else:
        from pcbench.cli.render import recordings

        double, single = (files.run_compiled(result, single=is_single) or "" for is_single in (False, True))
        source = "a simulated run" if log is None else log
        recordings.export_table(result, files.parse_replay(double), files.parse_replay(single), source, console())
        print(double.splitlines()[-1] + ", in double precision")
    label = result.about.label
    print(f"{len(paths)} files in {folder}. Compile: cc -std=c99 -O2 -o replay {label}.c main.c -lm && ./replay")


def prepare(
    study: Study,
    folder: Annotated[str, out("Folder for the study")],
    seeds: Annotated[int | None, option("Runs per grid point [default: the study's]")] = None,
    observers: Annotated[
        str | None, option("Comma-separated names of observers to compare with, or all (that support the study)")
    ] = None,
    changes: Set = None,
    csv: Annotated[bool, option("Write the tables also as CSV files", "--csv")] = False,
    quiet: Quiet = False,
) -> None:
    """Write the measurements of all runs with their arrival times, for a program in any language.

    Example: pcbench external prepare cart/white --seeds 16 --out cart
    """
    setup()
    from pcbench.external import export_draws
    from pcbench.planning import all_observers

    keys: TomlTable = {"seeds": seeds, "observers": names(observers) if observers else None}
    with show_progress(quiet) as progress:
        export_draws.write(all_observers.grid_of(study, keys, changes or []), folder, csv, progress)
    print(
        f"{folder}/draws contains samples, inputs and initial states. Its README.md explains the columns and your "
        "estimates file."
    )


def score(
    folder: DrawsFolder,
    estimates: Annotated[str, argument("Parquet or CSV file with one row per tick of each run")],
    name: Name,
    metric: Metric = RANK,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Add the estimates of another program to a study's tables, as one more observer.

    Example: pcbench external score cart estimates.parquet --name matlab-ekf
    """
    setup()
    from pcbench.external import score

    with show_progress(quiet) as progress:
        result = score.score(folder, estimates, name, progress, say)
    _print_export(result, folder, metric, signal, quiet)


def run(
    folder: DrawsFolder,
    reference: Annotated[str, argument("Function make(cell, xhat0), such as mine.py:make", metavar="MODULE:NAME")],
    name: Name,
    metric: Metric = RANK,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Run your own Python object on a study's measurements, one run at a time, and add it to the tables.

    Example: pcbench external run cart mine.py:make --name filterpy-kf
    """
    setup()
    from pcbench.external import score

    with show_progress(quiet) as progress:
        result = score.run(folder, reference, name, progress, say)
    _print_export(result, folder, metric, signal, quiet)


def _print_export(result: "Result", folder: str, metric: str, signal: str | None, quiet: bool) -> None:
    if quiet:
        print(folder)
        return
    from pcbench.cli.render import results

    results.closing(result, console(), metric, parse_signals(signal))
