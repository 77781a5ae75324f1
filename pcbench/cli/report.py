"""The command that makes results something to look at."""

from typing import Annotated

import typer

from pcbench.cli.interrupts import stoppable
from pcbench.cli.shared import RANKS, Folder, Metric, Quiet, Signals, chosen, out, require_effect, setup
from pcbench.errors import UserError


def report(
    folder: Folder,
    file: Annotated[str | None, out("HTML file to write [default: report.html in the folder]")] = None,
    figures: Annotated[str | None, typer.Option(help="folder for the pictures as files, in place of the page")] = None,
    formats: Annotated[str | None, typer.Option(help="of --figures, with commas [default: svg,pdf,png]")] = None,
    width: Annotated[float | None, typer.Option(help="of --figures: inches of a column [default: 3.75]")] = None,
    size: Annotated[float | None, typer.Option(help="of --figures: points of text [default: 9]")] = None,
    font: Annotated[str | None, typer.Option(help="of --figures: its family [default: DejaVu Sans]")] = None,
    metric: Metric = RANKS,
    signal: Signals = None,
    grid_point: Annotated[
        int | None,
        typer.Option(help="at which pictures stand: number in stats.parquet [default: the one that tells most]"),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="of the run shown in time [default: the study's first]")] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="limit of --metric, to say what suffices over each axis [default: twice the least]"),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make one HTML page of a study's results that opens anywhere, or its pictures as files.

    Example: pcbench report results/quick --metric steady_rmse --signal velocity
    """
    of_figures = {"--formats": formats, "--width": width, "--size": size, "--font": font}
    if figures is None:
        require_effect(of_figures, "without --figures", "both; add --figures, or leave it out")
    setup()
    from pcbench import statistics
    from pcbench.cli.render.progress import bar
    from pcbench.plots import Paper
    from pcbench.report.figures import Shown
    from pcbench.runtime import config

    statistics.compared(metric, "--metric")
    if threshold is not None and not threshold > 0:
        raise UserError(
            f"--threshold: got {threshold:g}, expected a positive limit of {metric}; write --threshold 0.05."
        )
    if file is not None and figures is not None:
        raise UserError(
            f"--out: got {file} beside --figures {figures}, expected the page or its pictures; leave one out."
        )
    where = f"{folder.rstrip('/')}/report.html" if file is None else file
    shown = Shown(metric=metric, signals=chosen(signal), cell=grid_point, seed=seed, threshold=threshold)
    with config.float64(), bar(quiet) as drawn:
        progress = stoppable(drawn)
        if figures is not None:
            from pcbench.dataset.result import open_result
            from pcbench.report import export_figures

            known = export_figures.kinds_of("svg,pdf,png" if formats is None else formats)
            paper = Paper(
                3.75 if width is None else width, 9.0 if size is None else size, "DejaVu Sans" if font is None else font
            ).checked()
            made = export_figures.write(open_result(folder), figures, progress, shown._replace(paper=paper), known)
            where, said = figures, f"{len(made)} figures as {', '.join(k.upper() for k in known)} in {figures}"
        else:
            from pcbench.report import page

            written = page.write(folder, where, progress, shown)
            large = f"{written / 1e6:.1f} MB" if written >= 1e5 else f"{written / 1e3:.0f} kB"
            said = f"{where}: one page of {large}, which opens in any browser"
    print(where if quiet else said)
