"""Commands that look at observers: what there is, their gains, and the papers' numbers."""

import json
from typing import Annotated

import typer

from pcbench.cli.shared import AsJson, Set, app, console, setup
from pcbench.errors import unknown


@app.command("list")
def list_(
    what: Annotated[str | None, typer.Argument(help="plants, observers, scenarios or studies; default all")] = None,
    as_json: AsJson = False,
) -> None:
    """List what there is.

    Example: pcbench list observers
    """
    from pcbench.catalogue import CATALOGUE

    if what is not None and what not in CATALOGUE:
        raise unknown("list", "kind of thing", what, CATALOGUE)
    chosen = {kind: CATALOGUE[kind]() for kind in ([what] if what else CATALOGUE)}
    if as_json:
        out = {
            kind: {n: dict(zip(heads[1:], cells, strict=True)) for n, cells in rows.items()}
            for kind, (heads, rows) in chosen.items()
        }
        print(json.dumps(out, indent=2))
        return
    from pcbench import show

    for kind, (heads, rows) in chosen.items():
        show.listing(kind, rows, heads, console())


@app.command()
def design(
    scenario: Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")],
    observer: Annotated[str, typer.Argument(help="an observer's name")],
    changes: Set = None,
    as_json: AsJson = False,
) -> None:
    """Show an observer's gains and what proves them.

    Example: pcbench design cart/nominal pccebo
    """
    setup()
    from pcbench import bench, machine, show

    found = bench.design(scenario, observer, overrides=changes)
    if as_json:
        print(machine.as_json({"scenario": scenario, "observer": observer} | found.certificate._asdict()))
    else:
        screen = console()
        screen.print(f"{observer} in {scenario}", style="bold", highlight=False)
        show.gains(found, screen)


@app.command()
def reproduce(
    paper: Annotated[str | None, typer.Argument(help="a paper's short name; default all")] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a paper's printed numbers with what comes out.

    Example: pcbench reproduce cart
    """
    setup()
    from pcbench import show
    from pcbench.reproduce import PAPERS

    if paper is not None and paper not in PAPERS:
        raise unknown("reproduce", "paper", paper, PAPERS)
    for name in [paper] if paper else PAPERS:
        title, claims = PAPERS[name]
        rows = claims()
        if as_json:
            print(json.dumps({"paper": name, "source": title, "claims": [row._asdict() for row in rows]}, indent=2))
        else:
            show.claims(title, rows, console())
