"""The command that looks at papers: what they print and claim against what comes out."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcbench.cli.interrupts import stoppable
from pcbench.cli.shared import AsJson, Quiet, console, setup
from pcbench.errors import UserError, unknown

if TYPE_CHECKING:
    from pcbench.papers.claim import Claim

ALL = "all"


def reproduce(
    paper: Annotated[str, typer.Argument(help="a paper's short name, or all")] = ALL,
    page: Annotated[
        Path | None, typer.Option(help="Markdown file to write, of all papers; the same wherever it is made")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare what papers print and claim with what comes out: every claim with a verdict and its evidence.

    Example: pcbench reproduce all --page REPRODUCTION.md
    """
    from pcbench.papers import PAPERS

    if paper != ALL and paper not in PAPERS:
        raise unknown("reproduce", "paper", paper, [*PAPERS, ALL])
    if page is not None and paper != ALL:
        raise UserError(f"--page: got the paper '{paper}' alone, expected all of them; write pcbench reproduce all.")
    setup()
    from pcbench.cli.render import folder
    from pcbench.cli.render.progress import bar
    from pcbench.dataset import storage
    from pcbench.papers import every
    from pcbench.papers.claim import counts
    from pcbench.papers.page import page as text_of

    if paper != ALL:
        title, claims = PAPERS[paper]
        rows = claims()
        if as_json:
            print(json.dumps(_data(paper, title, rows), indent=2))
        elif not quiet:
            folder.claims(title, rows, console())
        return
    if page is not None:
        storage.make(storage.target(page.parent))  # a folder that cannot be written is said before the work
    with bar(quiet or as_json) as progress:
        found = every.claims(stoppable(progress))
    if page is not None:
        storage.put(storage.target(page.parent), page.name, text_of(found).encode())
    if as_json:
        papers = [_data(name, PAPERS[name][0], rows) for name, rows in found.items()]
        print(json.dumps({"papers": papers, "verdicts": counts(r for rows in found.values() for r in rows)}, indent=2))
    elif not quiet:
        screen = console()
        folder.every(found, {name: title for name, (title, _) in PAPERS.items()}, screen)
        if page is not None:
            screen.print(f"The page: {page}")


def _data(paper: str, title: str, rows: "list[Claim]") -> dict[str, object]:
    keys = ("claim", "printed", "reproduced", "verdict")
    return {"paper": paper, "source": title, "claims": [{k: getattr(row, k) for k in keys} for row in rows]}
