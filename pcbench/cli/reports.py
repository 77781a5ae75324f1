"""The command that makes results something to look at."""

from pathlib import Path
from typing import Annotated

import typer

from pcbench.cli.shared import Folder, Quiet, app, setup
from pcbench.cli.stopping import stoppable


@app.command()
def report(
    folder: Folder,
    out: Annotated[str | None, typer.Option(help="HTML file to write [default: report.html in the folder]")] = None,
    figures: Annotated[
        str | None, typer.Option(help="folder for the pictures as SVG and PNG, in place of the page")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make one HTML page of a study's results that opens anywhere, or its pictures as files.

    Example: pcbench report results/quick
    """
    setup()
    from pcbench import machine, show

    with machine.float64(), show.counting(quiet) as draw:
        tell = stoppable(draw)
        if figures is not None:
            from pcbench.report import figures as pictures
            from pcbench.result import opened

            tell("figures", 0.0)
            names = pictures.write(opened(folder), figures, tell)
            said = f"{len(names)} figures as SVG and PNG in {figures}"
        else:
            from pcbench.report import page

            where = f"{folder.rstrip('/')}/report.html" if out is None else out
            size = page.write(folder, where, tell)
            said = f"{where}: one page of {size / 1e6:.1f} MB, which opens in any browser"
    if not quiet:
        print(said)
