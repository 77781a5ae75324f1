"""Commands that simulate: a study into a folder, or one run tick by tick."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from pcbench.cli.shared import AsJson, Quiet, Set, app, console, names, say, setup
from pcbench.cli.stopping import stoppable

LONG = 30.0  # s of a study


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
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run a study and leave its tables in a folder.

    Example: pcbench run quick --seeds 512 --out first-look
    """
    setup()
    from pcbench import bench, show, statistics, study_file

    statistics.compared(metric, "--metric")
    chosen = study_file.load(study, changes)
    folder = str(Path("results") / chosen.name.replace("/", "-")) if out is None else out
    with show.progress(quiet or as_json) as draw:
        result = bench.run(
            chosen,
            seeds=seeds,
            first_seed=first_seed,
            observers=None if observers is None else names(observers),
            out=folder,
            fresh=fresh,
            until_se=until_se,
            max_seeds=max_seeds,
            dask=dask,
            workers=workers,
            block=block,
            memory=memory,
            tell=stoppable(draw),
            say=say,
        )
    if (
        result.effort.runs and result.provenance["wall_seconds"] > LONG
    ):  # little beside the study: a report is quicker then
        _examples(result, quiet or as_json)
    if as_json:
        stats = json.loads(result.stats.to_json(orient="records"))
        summary = {"study": chosen.name, "out": str(folder), "provenance": result.provenance, "stats": stats}
        if result.fair is not None:
            summary["fair"] = json.loads(result.fair.to_json(orient="records"))
        print(json.dumps(summary, indent=2))
    elif not quiet:
        screen = console()
        show.closing(result, screen, metric)
        if result.fair is not None:
            show.fair(result.fair, screen)
        screen.print("... - best: paired over the same draws; '=' is not distinguishable (Holm, 5 %).", highlight=False)
        screen.print(show.effort(result, folder), highlight=False)


def _examples(result: Any, quiet: bool) -> None:
    """Leave one run of each scenario tick by tick, for a report."""
    from pcbench import examples, machine, show

    names = list(dict.fromkeys(result.stats.scenario))
    with machine.float64(), show.counting(quiet) as draw:
        tell = stoppable(draw)
        tell("examples", float(len(names)))
        for name in names:
            examples.of(result.study, name, result.out)
            tell("checked", 1.0)


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
    setup()
    from pcbench import bench, study_file, tables
    from pcbench.dataset import store
    from pcbench.plants import signals_of

    frame = bench.trace(scenario, names(observer), seed=seed, overrides=changes)
    place = store.target(out.parent)
    store.make(place)
    store.put_table(place, out.name, tables.trace_table(frame, signals_of(study_file.scenario_of(scenario, changes))))
    print(f"{len(frame)} ticks, columns {', '.join(frame.columns)}: {out}")
