"""Commands that simulate, and that look after a study's folder.

A study into a folder, a search for what suffices, one run tick by tick; how far a folder is, several made one, computed again,
two compared.
"""

import json
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from time import perf_counter
from typing import Annotated

import typer

from pcbench.cli.options import RANK, Folder, Json, Metric, Observers, Quiet, Scenario, Set, Signal, Signals, Study
from pcbench.cli.shared import argument, chosen, console, names, option, out, require_effect, say, setup, working
from pcbench.errors import UserError
from pcbench.runtime.progress import Progress

AHEAD = ("scipy.special", "pandas")  # what statistics need, and pyarrow, which looks for pandas before it takes a list
SAMPLE = 4  # blocks that are computed again


def run(
    study: Study,
    seeds: Annotated[int | None, option("noise seeds for each cell")] = None,
    first_seed: Annotated[int | None, option("the first of them [default: 0]")] = None,
    observers: Observers = None,
    changes: Set = None,
    folder: Annotated[
        str | None, out("folder or URI for the tables; run again, it goes on [default: results/STUDY]")
    ] = None,
    evaluation: Annotated[
        str | None, option("runs, exact (expected values, without a seed) or both [default: the study's]")
    ] = None,
    overwrite: Annotated[bool, option("remove what an earlier run left there, and start over", "--overwrite")] = False,
    until_se: Annotated[
        str | None, option("add seeds until every standard error is so small", metavar="METRIC=VALUE")
    ] = None,
    max_seeds: Annotated[int | None, option("of a cell, with --until-se [default: 100 times the study's]")] = None,
    dask: Annotated[str | None, option("a Dask scheduler's address, or local")] = None,
    workers: Annotated[int | None, option("processes of --dask local [default: one a core]")] = None,
    memory: Annotated[
        str | None, option("what results may take at a time, e.g. 2GiB [default: a quarter of the memory]")
    ] = None,
    block_size: Annotated[int | None, option("seeds a file; of no influence on any number")] = None,
    metric: Metric = RANK,
    signal: Signals = None,
    costs: Annotated[
        bool, option("say in the tables what observers cost: multiplications and bytes", "--operations")
    ] = False,
    timings: Annotated[bool, option("say where the time went", "--timings")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run a study and leave its tables in a folder.

    Example: pcbench run quick --seeds 512 --out first-look
    """
    began = perf_counter()
    drawn = {"--seeds": seeds, "--first-seed": first_seed, "--until-se": until_se, "--max-seeds": max_seeds}
    simulated = drawn | {"--block-size": block_size}, "exact values without seeds, or simulated runs; leave one out"
    if evaluation == "exact":
        require_effect(simulated[0], "with --evaluation exact", simulated[1])
    if quiet or as_json:
        tables, beside = {"--operations": costs, "--timings": timings}, f"with {'--quiet' if quiet else '--json'}"
        require_effect(tables, beside, "it where tables are printed; leave one out")
    setup()
    from pcbench import api, statistics
    from pcbench.study import parse

    statistics.require_metric(metric, "--metric")
    asked, where = parse.outline(study, changes or []), chosen(signal)
    parse.require_signals(asked, where, "--signal")
    if (evaluation or asked.evaluation) == "exact":
        require_effect(simulated[0], 'with a study of evaluation "exact"', simulated[1])
        _require_exact(metric)
    into = str(Path("results") / asked.name.replace("/", "-")) if folder is None else folder
    with working(quiet or as_json, "designing gains") as progress:
        result = api.run(
            study,
            overrides=changes,
            seeds=seeds,
            first_seed=first_seed,
            observers=None if observers is None else names(observers),
            evaluation=evaluation,
            out=into,
            overwrite=overwrite,
            until_se=until_se,
            max_seeds=max_seeds,
            dask=dask,
            workers=workers,
            block_size=block_size,
            memory=memory,
            progress=_importing_ahead(progress, quiet),
            say=say,
        )
    if result.study.custom_observers and find_spec("matplotlib"):
        from pcbench.report import figures

        shown = figures.FigureOptions(metric=metric, signals=where)
        figures.places(result, list(result.study.scenarios), shown)  # while the user's own code is at hand
    if as_json:
        stats = json.loads(result.stats.to_json(orient="records"))
        summary = {"study": asked.name, "out": into, "provenance": result.provenance, "stats": stats}
        if result.fair is not None:
            summary["fair"] = json.loads(result.fair.to_json(orient="records"))
        print(json.dumps(summary, indent=2))
    elif quiet:
        print(into)
    else:
        from pcbench.cli.render import results

        screen = console()
        results.closing(result, screen, metric, where, api.operation_counts(result.study) if costs else None)
        if result.fair is not None:
            from pcbench.cli.render import gains

            gains.fair(result.fair, screen)
        screen.say(results.sentence(result, into))
        screen.say(*(results.timings(result, perf_counter() - began) if timings else []))
        screen.say(f"Now look at it: pcbench report {into}")


def _importing_ahead(progress: Progress, quiet: bool) -> Progress:
    """A Progress that hears the same, and once work has begun has modules imported beside it that closing and printing need."""
    modules = AHEAD if quiet else (*AHEAD, "pcbench.cli.render.results")

    def begin(what: str, steps: int | None) -> None:
        progress.begin(what, steps)
        Thread(target=lambda: [import_module(name) for name in modules], name="importing").start()

    return progress._replace(begin=begin)


def _require_exact(metric: str) -> None:
    """Raise UserError where the metric that is to rank observers has no exact value, nor has its pooled form."""
    from pcbench.moments.stats_rows import ORDER, RUNS_ONLY
    from pcbench.statistics import COMPARED

    def has_one(metric: str) -> bool:
        steady = "steady_" if metric.startswith("steady_") else ""
        return metric not in RUNS_ONLY or f"{steady}pooled_{metric.removeprefix(steady)}" in ORDER

    if not has_one(metric):
        raise UserError(
            f"--metric: got {metric}, which has no exact value ({RUNS_ONLY[metric]}), expected one of "
            f"{', '.join(filter(has_one, COMPARED))}; write one of them, or simulate runs."
        )


def find_limit(
    study: Annotated[str, argument("a study of one scenario, a scenario or a TOML file")],
    threshold: Annotated[float, option("the limit, in the unit of the metric")],
    axis: Annotated[
        list[str],
        option(
            "sampling_period, delay[0], plant.lam ...: pcbench list axes; given twice: for each value of the first axis "
            "the largest of the second",
            metavar="AXIS",
        ),
    ],
    metric: Annotated[str, option("what is to stay below: pcbench list metrics")] = RANK,
    signal: Signal = None,
    between: Annotated[
        tuple[float, float] | None,
        option(
            "where to search, of two axes the first [default: as the study or the scenario suggests]",
            "--range",
            metavar="LOW HIGH",
        ),
    ] = None,
    tol: Annotated[float | None, option("how precisely, in the axis' unit [default: 5 % of the value]")] = None,
    seeds: Annotated[int | None, option("noise seeds for each value")] = None,
    max_seeds: Annotated[
        int | None, option("of a value whose interval holds the limit [default: 16 times the study's]")
    ] = None,
    observers: Observers = None,
    changes: Set = None,
    folder: Annotated[
        str | None, out("folder or URI for all that is run; asked again, it goes on [default: results/STUDY-AXIS]")
    ] = None,
    overwrite: Annotated[bool, option("remove the dataset that is there, and start over", "--overwrite")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Find the largest period, delay, loss ... at which an error is significantly below a limit, for each observer.

    Example: pcbench find-limit cart/white --threshold 0.1 --axis sampling_period
    """
    setup()
    from pcbench.cli.render import limits
    from pcbench.cli.render.tables import readable
    from pcbench.limits import find_limit
    from pcbench.study import parse

    into = folder
    if into is None:
        name = f"{parse.outline(study, changes or []).name}-{'-'.join(axis)}"
        into = str(Path("results") / re.sub(r"[^\w.+-]+", "-", name).strip("-"))
    with working(quiet or as_json, "designing gains") as progress:
        table = find_limit.find_limit(
            study,
            axis=axis[0] if len(axis) == 1 else axis,
            threshold=threshold,
            metric=metric,
            signal=signal,
            between=between,
            tol=tol,
            seeds=seeds,
            max_seeds=max_seeds,
            observers=None if observers is None else names(observers),
            out=into,
            overrides=changes,
            overwrite=overwrite,
            progress=progress,
            say=say,
        )
    if as_json:
        print(readable(table.attrs | {"answers": table.to_dict("records")}))
    elif quiet:
        print(into)
    elif len(axis) > 1:
        limits.frontier(table, console())
        console().say(f"Each value has its own study in {into}")
    else:
        limits.answers(table, console())
        console().say(f"Now look at it: pcbench report {into}")


def simulate(
    scenario: Scenario,
    observer: Annotated[str, option("an observer's name, several with commas, or all that can run")],
    file: Annotated[str, out("file to write, .parquet or .csv")],
    seed: Annotated[int, option("seed index")] = 0,
    log: Annotated[
        str | None, option("folder for what was measured, put in and true, as pcbench replay reads it")
    ] = None,
    changes: Set = None,
) -> None:
    """Write one run tick by tick, as Parquet or CSV.

    Example: pcbench simulate cart/white --observer kfbo --seed 3 --out trace.csv
    """
    setup()
    from pcbench import api
    from pcbench.dataset import single_table
    from pcbench.planning import all_observers
    from pcbench.plants import signals_of
    from pcbench.study import parse

    single_table.kind_of(file)
    frame = api.simulate(scenario, names(observer), seed=seed, overrides=changes, log=log)
    say(*all_observers.sentences(frame.attrs["excluded"]))
    single_table.put(file, single_table.trace_table(frame, signals_of(parse.scenario_of(scenario, changes))))
    print(f"{len(frame):,} ticks, columns {', '.join(frame.columns)}: {file}")


def status(folder: Folder, as_json: Json = False) -> None:
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
    folders: Annotated[list[str], argument("folders or URIs of one study, with other seeds or from other machines")],
    into: Annotated[str, out("new folder or URI")],
    quiet: Quiet = False,
) -> None:
    """Make one dataset of several; what two of them hold must be equal.

    Example: pcbench merge monday tuesday --out both
    """
    from pcbench.dataset import merge

    with working(quiet) as progress:
        made = merge.merge(folders, into, progress)
    again = f" {made.doubled:,} runs stood in more than one, all of them equal." if made.doubled else ""
    fills = f"pcbench run {into}/study.toml --out {into} fills them"
    missing = f" {made.missing:,} runs are missing: {fills}." if made.missing else ""
    print(f"{made.blocks:,} blocks in {into}.{again}{missing}")


def verify(
    folder: Folder,
    sample: Annotated[
        int | None, option("blocks to compute again, and cells with exact numbers [default: 4]", min=0)
    ] = None,
    every: Annotated[bool, option("compute every block again", "--all")] = False,
    seed: Annotated[int | None, option("draws the blocks [default: 0]", min=0)] = None,
    exact: Annotated[
        bool, option("compare simulated means with their exact values, in standard errors", "--exact")
    ] = False,
    figure: Annotated[str | None, option("with --exact: a quantile plot, .svg, .pdf or .png")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Check every file, and compute some blocks again: they must come out bit for bit. Exit code 1 where they do not.

    Exact numbers must come out again to rounding.

    With --exact simulated means are compared with their exact values instead, wherever there are such.

    Example: pcbench verify results/quick --sample 8
    """
    drawn = {"--sample": sample, "--seed": seed}
    if exact:
        either = "blocks to compute again, or a comparison with exact values; leave one out"
        require_effect(drawn | {"--all": every}, "with --exact", either)
    if every:
        require_effect(drawn, "with --all", "every block, or some; leave one out")
    if not exact:
        require_effect({"--figure": figure}, "without --exact", "both; add --exact, or leave it out")
    setup()
    if exact:
        return _against_exact(folder, figure, quiet, as_json)
    from pcbench.cli.render import folder as screen
    from pcbench.dataset import verify

    with working(quiet or as_json) as progress:
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
    from pcbench.cli.render.tables import readable
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
    there: Annotated[str, argument("a folder or URI that pcbench run has made")],
    here: Annotated[str, argument("another, of the same study: another release, another machine")],
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Say what changed beyond its interval between two results of one study. Exit code 1 where something did.

    Example: pcbench compare results/quick elsewhere/quick
    """
    from pcbench.cli.render.tables import readable
    from pcbench.dataset import compare

    found = compare.compare(there, here)
    if as_json:
        said = {"rows": len(found.rows), "changed": found.changed, "only": found.only, "made_by": found.made_by}
        drawn = {"same_draws": int(found.rows.same_draws.sum()), "identical": found.identical, "largest": found.largest}
        moved = found.rows[found.rows.changed].to_dict("records")
        print(readable(said | drawn | {"moved": moved}))
    elif not quiet:
        from pcbench.cli.render import folder

        folder.comparison(found, there, here, console())
    if found.changed:
        raise typer.Exit(1)
