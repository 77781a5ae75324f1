"""The command that takes an observer out of pcbench: as C, with its gains and a run to test it by."""

from typing import Annotated

import typer

from pcbench.cli.interrupts import stop_if_asked
from pcbench.cli.shared import Late, Quiet, Set, Start, console, out, say, setup
from pcbench.errors import UserError


def export(
    study: Annotated[str, typer.Argument(help="a scenario, or a study of one cell")],
    observer: Annotated[str, typer.Argument(help="an observer's name, or its label in the study")],
    folder: Annotated[str, out("folder for the files")],
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="run that becomes the test vector, without --log")
    ] = 0,
    log: Annotated[
        str | None,
        typer.Option(help="recording that the C has room for, and is tested on [default: none, a simulated run]"),
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
    found = files.exported(study, observer, seed, changes, log=log, delay=delay, start=start)
    stop_if_asked()
    made = files.write(found, folder)
    if quiet:
        print(folder)
        return
    if files.compiler() is None:
        say("there is no C compiler here, so nothing was compiled; the line to do it stands in the header.")
    else:
        from pcbench.cli.render import recordings

        double, single = (files.replayed(found, single=each) or "" for each in (False, True))
        of = "a simulated run" if log is None else log
        recordings.table(found, files.said(double), files.said(single), of, console())
        print(double.splitlines()[-1] + ", in double precision")
    label = found.about.label
    print(f"{len(made)} files in {folder}. Compile: cc -std=c99 -O2 -o replay {label}.c main.c -lm && ./replay")
