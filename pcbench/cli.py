"""The command line: parse, call, print. Whatever the user can mend is one sentence and exit code 2."""

import json
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from pcbench.errors import UserError, unknown

app = typer.Typer(
    name="pcbench",
    help="Which observer should I use when my measurements are sampled, late, noisy or lost, and how sure am I?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
STOPPED = 130  # the exit code of a program that Ctrl-C has ended
AsJson = Annotated[bool, typer.Option("--json", help="print JSON for a program instead of a table")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="change the study, e.g. axes.noise_std=0.1 (repeatable)"),
]


def main() -> None:
    """Run the command line and exit: 0 done, 2 a mistake that the user can mend, 130 stopped."""
    code = 0
    signal.signal(signal.SIGINT, _interrupt)
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False) or 0
        if code == STOPPED:  # some releases of the command-line library turn Ctrl-C into an exit code themselves
            raise KeyboardInterrupt
    except UserError as error:
        code = _complain(str(error))
    except (KeyboardInterrupt, typer.Abort):
        code = _complain("stopped; every file already written is complete.", STOPPED)
    except BrokenPipeError:
        code = 141
    except Exception as error:
        if not hasattr(error, "format_message"):  # the command line's own usage errors have one
            raise
        code = _complain(error.format_message().rstrip(".") + "; see pcbench --help.")
    sys.exit(code)


_INTERRUPTED: list[int] = []


def _interrupt(number: int, frame: Any) -> None:
    """Stop at Ctrl-C; where a library swallows the exception, `_stop_if_asked` raises it again."""
    _INTERRUPTED.append(number)
    raise KeyboardInterrupt


def _stop_if_asked() -> None:
    if _INTERRUPTED:
        raise KeyboardInterrupt


def _say(sentence: str) -> None:
    print(f"pcbench: {sentence}", file=sys.stderr)


def _complain(sentence: str, code: int = 2) -> int:
    print(f"pcbench: {sentence}", file=sys.stderr)
    return code


def _console() -> Any:
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=160)


def _setup() -> None:
    from pcbench import machine

    machine.setup()


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
        show.listing(kind, rows, heads, _console())


@app.command()
def run(
    study: Annotated[str, typer.Argument(help="a study, a scenario or a TOML file")],
    seeds: Annotated[int | None, typer.Option(help="noise seeds for each cell")] = None,
    first_seed: Annotated[int | None, typer.Option(help="the first of them [default: 0]")] = None,
    observers: Annotated[str | None, typer.Option(help="comma-separated names")] = None,
    changes: Set = None,
    out: Annotated[
        str | None, typer.Option(help="folder or URI for the tables; run again, it goes on [default: results/STUDY]")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="remove what an earlier run left there, and start over")
    ] = False,
    until_se: Annotated[
        str | None, typer.Option(metavar="METRIC=VALUE", help="add seeds until every standard error is so small")
    ] = None,
    max_seeds: Annotated[
        int | None, typer.Option(help="of a cell, with --until-se [default: 100 times the study's]")
    ] = None,
    dask: Annotated[str | None, typer.Option(help="a Dask scheduler's address, or local")] = None,
    workers: Annotated[int | None, typer.Option(help="processes of --dask local [default: one a core]")] = None,
    memory: Annotated[
        str | None, typer.Option(help="what results may take at a time, e.g. 2GiB [default: a quarter of the memory]")
    ] = None,
    block: Annotated[int | None, typer.Option(help="seeds a file; of no influence on any number")] = None,
    metric: Annotated[str, typer.Option(help="metric that ranks the closing table")] = "mae",
    quiet: Annotated[bool, typer.Option("--quiet", help="no progress and no table")] = False,
    as_json: AsJson = False,
) -> None:
    """Run a study and leave its tables in a folder.

    Example: pcbench run quick --seeds 512 --out first-look
    """
    _setup()
    from pcbench import bench, show, statistics, study_file

    statistics.compared(metric, "--metric")
    chosen = study_file.load(study, changes)
    folder = out or str(Path("results") / chosen.name.replace("/", "-"))
    names = None if observers is None else [name.strip() for name in observers.split(",")]
    with show.progress(quiet or as_json) as draw:

        def tell(event: str, value: float) -> None:
            _stop_if_asked()
            draw(event, value)

        result = bench.run(
            chosen,
            seeds=seeds,
            first_seed=first_seed,
            observers=names,
            out=folder,
            fresh=fresh,
            until_se=until_se,
            max_seeds=max_seeds,
            dask=dask,
            workers=workers,
            block=block,
            memory=memory,
            tell=tell,
            say=_say,
        )
    if as_json:
        stats = json.loads(result.stats.to_json(orient="records"))
        summary = {"study": chosen.name, "out": str(folder), "provenance": result.provenance, "stats": stats}
        print(json.dumps(summary, indent=2))
    elif not quiet:
        console = _console()
        show.closing(result, console, metric)
        console.print(
            "... - best: paired over the same draws; '=' is not distinguishable (Holm, 5 %).", highlight=False
        )
        console.print(show.effort(result, folder), highlight=False)


@app.command()
def trace(
    scenario: Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")],
    observer: Annotated[str, typer.Option(help="an observer's name, or several with commas")],
    out: Annotated[Path, typer.Option(help="Parquet file to write")],
    seed: Annotated[int, typer.Option(help="seed index")] = 0,
    changes: Set = None,
) -> None:
    """Write one run tick by tick.

    Example: pcbench trace cart/white --observer kfbo --seed 3 --out trace.parquet
    """
    _setup()
    from pcbench import bench, tables
    from pcbench.dataset import store
    from pcbench.plants import signals_of

    frame = bench.trace(scenario, [name.strip() for name in observer.split(",")], seed=seed, overrides=changes)
    place = store.target(out.parent)
    store.make(place)
    store.put_table(place, out.name, tables.trace_table(frame, signals_of(bench.scenario_of(scenario, changes))))
    print(f"{len(frame)} ticks, columns {', '.join(frame.columns)}: {out}")


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
    _setup()
    from pcbench import bench, machine, show

    found = bench.design(scenario, observer, overrides=changes)
    if as_json:
        print(machine.as_json({"scenario": scenario, "observer": observer} | found.certificate._asdict()))
    else:
        console = _console()
        console.print(f"{observer} in {scenario}", style="bold", highlight=False)
        show.gains(found, console)


@app.command()
def reproduce(
    paper: Annotated[str | None, typer.Argument(help="a paper's short name; default all")] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a paper's printed numbers with what comes out.

    Example: pcbench reproduce cart
    """
    _setup()
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
            show.claims(title, rows, _console())


@app.command()
def status(
    folder: Annotated[str, typer.Argument(help="a folder or URI that pcbench run has made")], as_json: AsJson = False
) -> None:
    """Show how far a study is, and whether its files are whole.

    Example: pcbench status results/quick
    """
    from pcbench import show
    from pcbench.dataset import inspection

    found = inspection.status(folder)
    if as_json:
        print(json.dumps(found._asdict() | {"shares": [s._asdict() for s in found.shares]}, indent=2))
    else:
        show.status(found, folder, _console())


@app.command()
def merge(
    folders: Annotated[
        list[str], typer.Argument(help="folders or URIs of one study, with other seeds or from other machines")
    ],
    out: Annotated[str, typer.Option(help="new folder or URI")],
    quiet: Annotated[bool, typer.Option("--quiet", help="no progress")] = False,
) -> None:
    """Make one dataset of several; what two of them hold must be equal.

    Example: pcbench merge monday tuesday --out both
    """
    from pcbench import show
    from pcbench.dataset import merging

    with show.counting(quiet) as tell:
        made = merging.merge(folders, out, tell)
    again = f" {made.doubled:,} runs stood in more than one, all of them equal." if made.doubled else ""
    lack = (
        f" {made.missing:,} runs are missing: pcbench run {out}/study.toml --out {out} fills them."
        if made.missing
        else ""
    )
    print(f"{made.blocks:,} blocks in {out}.{again}{lack}")


@app.command()
def verify(
    folder: Annotated[str, typer.Argument(help="a folder or URI that pcbench run has made")],
    sample: Annotated[int, typer.Option(help="blocks to compute again")] = 4,
    every: Annotated[bool, typer.Option("--all", help="compute every block again")] = False,
    seed: Annotated[int, typer.Option(min=0, help="draws the blocks")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", help="no progress")] = False,
    as_json: AsJson = False,
) -> None:
    """Check every file, and compute some blocks again: they must come out bit for bit. Exit code 1 where they do not.

    Example: pcbench verify results/quick --sample 8
    """
    _setup()
    from pcbench import show
    from pcbench.dataset import inspection

    with show.counting(quiet or as_json) as tell:
        found = inspection.verify(folder, None if every else max(sample, 0), seed, tell)
    if as_json:
        print(json.dumps(found._asdict(), indent=2))
    else:
        show.verdict(found, folder, _console())
    if found.wrong or found.differing:
        raise typer.Exit(1)


if __name__ == "__main__":
    main()
