"""Commands that look after a study's folder: how far it is, several made one, computed again, two compared."""

import json
from typing import Annotated

import typer

from pcbench.cli.shared import AsJson, Folder, Quiet, console, out, require_effect, setup

SAMPLE = 4  # blocks that are computed again


def status(
    folder: Folder,
    as_json: AsJson = False,
) -> None:
    """Show how far a study is, and which files cannot be read. Exit code 1 where one is damaged; `verify` reads every number.

    Example: pcbench status results/quick
    """
    from pcbench.cli.render import folder as screen
    from pcbench.dataset import verify

    found = verify.status(folder)
    if as_json:
        print(json.dumps(found._asdict() | {"shares": [s._asdict() for s in found.shares]}, indent=2))
    else:
        screen.status(found, folder, console())
    if found.damaged or found.doubled:
        raise typer.Exit(1)


def merge(
    folders: Annotated[
        list[str], typer.Argument(help="folders or URIs of one study, with other seeds or from other machines")
    ],
    into: Annotated[str, out("new folder or URI")],
    quiet: Quiet = False,
) -> None:
    """Make one dataset of several; what two of them hold must be equal.

    Example: pcbench merge monday tuesday --out both
    """
    from pcbench.cli.render.progress import bar
    from pcbench.dataset import merge

    with bar(quiet) as progress:
        made = merge.merge(folders, into, progress)
    again = f" {made.doubled:,} runs stood in more than one, all of them equal." if made.doubled else ""
    lack = (
        f" {made.missing:,} runs are missing: pcbench run {into}/study.toml --out {into} fills them."
        if made.missing
        else ""
    )
    print(f"{made.blocks:,} blocks in {into}.{again}{lack}")


def verify(
    folder: Folder,
    sample: Annotated[
        int | None, typer.Option(min=0, help="blocks to compute again, and cells with exact numbers [default: 4]")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="compute every block again")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="draws the blocks [default: 0]")] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="compare simulated means with their exact values, in standard errors")
    ] = False,
    figure: Annotated[str | None, typer.Option(help="with --exact: a quantile plot, .svg, .pdf or .png")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Check every file, and compute some blocks again: they must come out bit for bit. Exit code 1 where they do not.

    Exact numbers must come out again to rounding.

    With --exact simulated means are compared with their exact values instead, wherever there are such.

    Example: pcbench verify results/quick --sample 8
    """
    drawn = {"--sample": sample, "--seed": seed}
    if exact:
        require_effect(
            drawn | {"--all": every},
            "with --exact",
            "blocks to compute again, or a comparison with exact values; leave one out",
        )
    if every:
        require_effect(drawn, "with --all", "every block, or some; leave one out")
    if not exact:
        require_effect({"--figure": figure}, "without --exact", "both; add --exact, or leave it out")
    setup()
    if exact:
        return _against_exact(folder, figure, quiet, as_json)
    from pcbench.cli.render import folder as screen
    from pcbench.cli.render.progress import bar
    from pcbench.dataset import verify

    with bar(quiet or as_json) as progress:
        found = verify.verify(folder, None if every else SAMPLE if sample is None else sample, seed or 0, progress)
    if as_json:
        print(json.dumps(found._asdict(), indent=2))
    elif not quiet:
        screen.verdict(found, folder, console())
    if found.wrong or found.differing or found.unlike:
        raise typer.Exit(1)


def _against_exact(folder: str, figure: str | None, quiet: bool, as_json: bool) -> None:
    """Compare simulated means with exact values, draw the figure that is asked for, and say what came of it."""
    from pcbench.cli.render import folder as screen
    from pcbench.cli.render.json import readable
    from pcbench.dataset import validate_exact

    found = validate_exact.check(folder)
    if figure is not None:
        from pcbench import plots

        plots.save(plots.quantiles(found), figure)
    if as_json:
        said = {"verdict": found.verdict, "limit": found.limit, "refused": found.refused}
        print(readable(said | {"rows": found.rows.to_dict("records")}))
    elif not quiet:
        screen.against_exact(found, console())
    if len(found.wrong):
        raise typer.Exit(1)


def compare(
    there: Annotated[str, typer.Argument(help="a folder or URI that pcbench run has made")],
    here: Annotated[str, typer.Argument(help="another, of the same study: another release, another machine")],
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Say what changed beyond its interval between two results of one study. Exit code 1 where something did.

    Example: pcbench compare results/quick elsewhere/quick
    """
    from pcbench.cli.render.json import readable
    from pcbench.dataset import compare

    found = compare.compare(there, here)
    if as_json:
        said = {"rows": len(found.rows), "changed": found.changed, "only": found.only, "made_by": found.made_by}
        drawn = {"same_draws": int(found.rows.same_draws.sum()), "identical": found.identical, "largest": found.largest}
        moved = found.rows[found.rows.changed].to_dict("records")
        print(readable(said | drawn | {"moved": moved}))
    elif not quiet:
        from pcbench.cli.render.comparison import comparison

        comparison(found, there, here, console())
    if found.changed:
        raise typer.Exit(1)
