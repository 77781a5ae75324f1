"""The command that makes results something to look at."""

from typing import Annotated

import typer

from pcbench.cli.shared import RANKS, Folder, Metric, Quiet, Signals, chosen, out, setup
from pcbench.cli.stopping import stoppable


def report(
    folder: Folder,
    file: Annotated[str | None, out("HTML file to write [default: report.html in the folder]")] = None,
    figures: Annotated[
        str | None, typer.Option(help="folder for the pictures as SVG and PNG, in place of the page")
    ] = None,
    metric: Metric = RANKS,
    signal: Signals = None,
    quiet: Quiet = False,
) -> None:
    """Make one HTML page of a study's results that opens anywhere, or its pictures as files.

    Example: pcbench report results/quick --metric tail_rmse --signal velocity
    """
    setup()
    from pcbench import statistics
    from pcbench.cli.screen.progress import bar
    from pcbench.machine import process

    statistics.compared(metric, "--metric")
    where = f"{folder.rstrip('/')}/report.html" if file is None else file
    with process.float64(), bar(quiet) as drawn:
        progress = stoppable(drawn)
        if figures is not None:
            from pcbench.dataset.result import opened
            from pcbench.report import figures as pictures

            names = pictures.write(opened(folder), figures, progress, metric, chosen(signal))
            where, said = figures, f"{len(names)} figures as SVG and PNG in {figures}"
        else:
            from pcbench.report import page

            size = page.write(folder, where, progress, metric, chosen(signal))
            said = f"{where}: one page of {size / 1e6:.1f} MB, which opens in any browser"
    print(where if quiet else said)
