"""Commands for results (`report`, `tables`, `cite`) and for the claims of papers (`reproduce`)."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcbench.cli.options import RANK, Folder, Journal, Json, Metric, PageFolder, Quiet, Signals
from pcbench.cli.shared import (
    argument,
    console,
    option,
    out,
    parse_signals,
    require_effect,
    setup,
    show_progress,
    write,
)
from pcbench.errors import UserError, printable, unknown

if TYPE_CHECKING:
    from pcbench.papers.claim import Claim

ALL_PAPERS = "all"


def report(
    folder: PageFolder,
    file: Annotated[str | None, out("HTML file to write [default: report.html in the folder]")] = None,
    figures: Annotated[str | None, option("Folder for the figures as files, instead of the page")] = None,
    formats: Annotated[
        str | None, option("Comma-separated file formats (with --figures) [default: svg,pdf,png]")
    ] = None,
    journal: Annotated[
        Journal | None, option("Journal whose column widths and fonts the figures have (with --figures)")
    ] = None,
    width: Annotated[float | None, option("Column width in inches (with --figures) [default: 3.75]")] = None,
    size: Annotated[float | None, option("Font size in points (with --figures) [default: 9]")] = None,
    font: Annotated[str | None, option("Font family (with --figures) [default: DejaVu Sans]")] = None,
    metric: Metric = RANK,
    signal: Signals = None,
    grid_point: Annotated[
        int | None,
        option("Grid point of the figures: column `cell` in stats.parquet [default: the one with the largest lead]"),
    ] = None,
    seed: Annotated[int | None, option("Seed of the run shown over time [default: the study's first]")] = None,
    threshold: Annotated[
        float | None,
        option("Limit of the metric, to report the values of each axis below it [default: twice the least]"),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the results of a study or a replay as one HTML page that opens offline, or its figures as files.

    Examples: pcbench report results/quick --metric steady_rmse --signal velocity;  pcbench report replayed
    """
    of_figures = {"--formats": formats, "--journal": journal, "--width": width, "--size": size, "--font": font}
    if figures is None:
        require_effect(of_figures, "without --figures", "add --figures, or leave it out")
    setup()
    from pcbench import statistics
    from pcbench.plots import replay_frames
    from pcbench.plots.layout import JOURNALS, PAPER
    from pcbench.report.figures import FigureOptions
    from pcbench.runtime import config

    is_replay = replay_frames.is_replay(folder)
    if is_replay:
        chosen_metric = None if metric == RANK else metric
        run_options = {"--metric": chosen_metric, "--grid-point": grid_point, "--seed": seed, "--threshold": threshold}
        require_effect(run_options, "with a replay", "leave it out")
    statistics.require_metric(metric, "--metric")
    if threshold is not None and not threshold > 0:
        raise UserError(
            f"--threshold: got {threshold:g}, expected a positive limit of {metric}; write --threshold 0.05."
        )
    if file is not None and figures is not None:
        raise UserError(
            f"--out: got {file} together with --figures {figures}, expected the page or its figures; leave one out."
        )
    options = FigureOptions(
        metric=metric, signals=parse_signals(signal), cell=grid_point, seed=seed, threshold=threshold
    )
    with config.float64(), show_progress(quiet) as progress:
        if figures is not None:
            from pcbench.dataset.result import open_result
            from pcbench.report import figures as pictures
            from pcbench.report import replay_page

            kinds = pictures.kinds_of("svg,pdf,png" if formats is None else formats)
            base = JOURNALS[journal] if journal else PAPER
            paper = base._replace(
                width=base.width if width is None else width,
                size=base.size if size is None else size,
                font=base.font if font is None else font,
            ).validate()
            if is_replay:
                paths = replay_page.write_figures(folder, figures, options._replace(paper=paper), kinds)
            else:
                paths = pictures.write(open_result(folder), figures, progress, options._replace(paper=paper), kinds)
            where, text = figures, f"{len(paths)} figures as {', '.join(k.upper() for k in kinds)} in {figures}"
        else:
            from pcbench.report import page, replay_page

            where = f"{folder.rstrip('/')}/report.html" if file is None else file
            if is_replay:
                n_bytes = page.write_page(replay_page.page(replay_frames.open_replay(folder), options.signals), where)
            else:
                n_bytes = page.write(folder, where, progress, options)
            bytes_ = f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.0f} kB"
            text = f"{where}: one page of {bytes_}, which opens in any browser"
    print(where if quiet else text)


SUFFIXES = {".tex": "latex", ".md": "markdown", ".csv": "csv"}


def tables(
    folder: Folder,
    latex: Annotated[bool, option("LaTeX with booktabs and siunitx", "--latex")] = False,
    markdown: Annotated[bool, option("Markdown [default, unless --out ends in .tex or .csv]", "--markdown")] = False,
    csv: Annotated[bool, option("CSV: one row per estimate, with all digits", "--csv")] = False,
    plain: Annotated[bool, option("LaTeX without packages", "--plain")] = False,
    journal: Annotated[
        Journal | None, option("Journal whose columns the tables fit (with LaTeX) [default: ieee]")
    ] = None,
    metric: Metric = RANK,
    signal: Signals = None,
    file: Annotated[str | None, out("File to write: .tex, .md or .csv [default: the terminal]")] = None,
) -> None:
    """Print a study's results as tables for a paper: means with intervals, and the best in bold.

    Example: pcbench tables results/quick --latex --signal all --out tables.tex
    """
    forms = [form for form, flag in (("latex", latex or plain), ("markdown", markdown), ("csv", csv)) if flag]
    suffix = Path(file).suffix.lower() if file else ".md"
    if len(forms) > 1:
        raise UserError(f"tables: got --{' and --'.join(forms)}, expected one form; leave the others out.")
    if not forms and suffix not in SUFFIXES:
        raise UserError(
            f"--out {file}: got no form by its name, expected one of {', '.join(SUFFIXES)}; add --latex, --markdown or --csv."
        )
    form = forms[0] if forms else SUFFIXES[suffix]
    if form != "latex":
        require_effect({"--journal": journal}, f"with {form}", "add --latex, or leave it out")
    from pcbench.dataset.result import open_result
    from pcbench.tables import latex as tex
    from pcbench.tables import layout, text

    layouts = layout.tables(open_result(folder), metric, parse_signals(signal))
    if not layouts:
        raise UserError(f"--metric: got {metric}, which the selected signals do not have; use another.")
    if form == "latex":
        _put(tex.latex(layouts, plain, journal or "ieee"), file)
    else:
        _put(text.markdown(layouts) if form == "markdown" else text.values(layouts), file)


def _put(content: str, file: str | None) -> None:
    """Print a text or write it to a file, with unprintable characters escaped."""
    content = printable(content, but="\n")
    if file is None:
        write(content)
        return
    try:
        Path(file).write_text(content, encoding="utf-8")
    except OSError as error:
        raise UserError(
            f"--out {file}: cannot be written ({error.strerror}), expected a writable file; use another name."
        ) from None
    print(file)


def cite(
    target: Annotated[
        str | None, argument("Folder of a result, or study [default: everything]", metavar="[DIR|STUDY]")
    ] = None,
    file: Annotated[str | None, out("File to write [default: the terminal]")] = None,
) -> None:
    """Print BibTeX of the sources that a study used: papers of observers and scenarios, solvers, libraries, and pcbench.

    Example: pcbench cite results/quick --out quick.bib
    """
    from pcbench import citing

    _put(citing.bibtex(target), file)


def reproduce(
    paper: Annotated[
        str, argument("Short name of a paper, field (standard examples of the field), or all")
    ] = ALL_PAPERS,
    page: Annotated[Path | None, option("Markdown file for all claims (with all)")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare published numbers and claims with pcbench's results.

    Example: pcbench reproduce all --page REPRODUCTION.md
    """
    from pcbench.papers import PAPERS

    if paper != ALL_PAPERS and paper not in PAPERS:
        raise unknown("reproduce", "paper", paper, [*PAPERS, ALL_PAPERS])
    if page is not None and paper != ALL_PAPERS:
        raise UserError(f"--page: got the paper '{paper}' alone, expected all of them; write pcbench reproduce all.")
    setup()
    from pcbench.cli.render import folder
    from pcbench.dataset import storage
    from pcbench.papers import all_papers
    from pcbench.papers.claim import counts
    from pcbench.papers.page import page as text_of

    if paper != ALL_PAPERS:
        title, claims = PAPERS[paper]
        rows = claims()
        if as_json:
            print(json.dumps(_data(paper, title, rows), indent=2))
        elif not quiet:
            folder.claims(title, rows, console())
        return
    if page is not None:
        storage.create_folder(storage.target(page.parent))  # an unwritable folder is reported before the work
    with show_progress(quiet or as_json) as progress:
        by_paper = all_papers.claims(progress)
    if page is not None:
        storage.write_file(storage.target(page.parent), page.name, text_of(by_paper).encode())
    if as_json:
        papers = [_data(name, PAPERS[name][0], rows) for name, rows in by_paper.items()]
        print(
            json.dumps({"papers": papers, "verdicts": counts(r for rows in by_paper.values() for r in rows)}, indent=2)
        )
    elif not quiet:
        screen = console()
        folder.all_claims(by_paper, {name: title for name, (title, _) in PAPERS.items()}, screen)
        if page is not None:
            screen.print(f"Page written: {page}")


def _data(paper: str, title: str, rows: "list[Claim]") -> dict[str, object]:
    keys = ("claim", "printed", "reproduced", "verdict", *(["source"] if any(row.source for row in rows) else []))
    return {"paper": paper, "source": title, "claims": [{k: getattr(row, k) for k in keys} for row in rows]}
