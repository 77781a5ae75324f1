"""The command that takes an observer out of pcbench: as C, with its gains and a run to test it by."""

from typing import Annotated

import typer

from pcbench.cli.shared import Quiet, Set, console, out, say, setup
from pcbench.cli.stopping import stop_if_asked


def export(
    study: Annotated[str, typer.Argument(help="a scenario, or a study of one cell")],
    observer: Annotated[str, typer.Argument(help="an observer's name, or its label in the study")],
    folder: Annotated[str, out("folder for the files")],
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="which run becomes the test vector")] = 0,
    changes: Set = None,
    quiet: Quiet = False,
) -> None:
    """Write an observer as C99 with its gains, a run to test it by, and the program that replays it.

    Where there is a C compiler, the program is compiled and run: a table says how far the estimates are from the simulation's.

    Example: pcbench export cart/white dkf --out dkf-in-c
    """
    setup()
    from pcbench.export import files

    files.require_place(folder)
    found = files.exported(study, observer, seed, changes)
    stop_if_asked()
    made = files.write(found, folder)
    if quiet:
        print(folder)
        return
    if files.compiler() is None:
        say("there is no C compiler here, so nothing was compiled; the line to do it stands in the header.")
    else:
        from pcbench.cli.screen import replays

        double, single = (files.replayed(found, single=each) or "" for each in (False, True))
        replays.table(found, files.said(double), files.said(single), console())
        print(double.splitlines()[-1] + ", in double precision")
    label = found.about.label
    print(f"{len(made)} files in {folder}. Compile: cc -std=c99 -O2 -o replay {label}.c main.c -lm && ./replay")
