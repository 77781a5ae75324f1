"""Commands that simulate (`run`, `find-limit`, `simulate`) and that manage results (`status`, `merge`, `verify`, `compare`)."""

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
from pcbench.cli.shared import (
    argument,
    console,
    names,
    option,
    out,
    parse_signals,
    require_effect,
    say,
    setup,
    show_progress,
)
from pcbench.errors import UserError
from pcbench.runtime.progress import Progress

# modules for statistics and output; pyarrow imports pandas when it first converts a list
EARLY_IMPORTS = ("scipy.special", "pandas")
SAMPLE = 4  # blocks that are computed again


def run(
    study: Study,
    seeds: Annotated[int | None, option("Runs per grid point [default: the study's]")] = None,
    first_seed: Annotated[int | None, option("Index of the first seed [default: the study's]")] = None,
    observers: Observers = None,
    changes: Set = None,
    folder: Annotated[
        str | None,
        out("Folder or URI for the tables; the same command continues a stopped run [default: results/STUDY]"),
    ] = None,
    evaluation: Annotated[
        str | None, option("Evaluation: runs, exact (expected values without seeds) or both [default: the study's]")
    ] = None,
    overwrite: Annotated[
        bool, option("Delete the result of an earlier run in this folder first", "--overwrite")
    ] = False,
    until_se: Annotated[
        str | None, option("Standard error to reach at each grid point, by adding runs", metavar="METRIC=VALUE")
    ] = None,
    max_seeds: Annotated[
        int | None, option("Maximum runs per grid point (with --until-se) [default: 100 times the study's]")
    ] = None,
    dask: Annotated[str | None, option("Address of a Dask scheduler, or local")] = None,
    workers: Annotated[int | None, option("Number of processes (with --dask local) [default: one per core]")] = None,
    memory: Annotated[
        str | None, option("Memory for results, such as 2GiB [default: a quarter of the machine's memory]")
    ] = None,
    block_size: Annotated[int | None, option("Runs per file; no effect on any number")] = None,
    metric: Metric = RANK,
    signal: Signals = None,
    costs: Annotated[bool, option("Show the multiplications and the memory of each observer", "--operations")] = False,
    timings: Annotated[bool, option("Show how long each part of the command took", "--timings")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run a study and write its tables to a folder.

    Example: pcbench run quick --seeds 512 --out first-look
    """
    start = perf_counter()
    seed_options = {"--seeds": seeds, "--first-seed": first_seed, "--until-se": until_se, "--max-seeds": max_seeds}
    run_options = seed_options | {"--block-size": block_size}
    advice = "exact values need no runs; leave one of them out"
    if evaluation == "exact":
        require_effect(run_options, "with --evaluation exact", advice)
    if quiet or as_json:
        tables, context = {"--operations": costs, "--timings": timings}, f"with {'--quiet' if quiet else '--json'}"
        require_effect(tables, context, "no table is printed; leave one of them out")
    setup()
    from pcbench import api, statistics
    from pcbench.study import parse

    statistics.require_metric(metric, "--metric")
    outline, signals = parse.outline(study, changes or []), parse_signals(signal)
    parse.require_signals(outline, signals, "--signal")
    if (evaluation or outline.evaluation) == "exact":
        require_effect(run_options, 'in a study with evaluation = "exact"', advice)
        _require_exact(metric)
    into = str(Path("results") / outline.name.replace("/", "-")) if folder is None else folder
    with show_progress(quiet or as_json, "designing gains") as progress:
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
            progress=_with_early_imports(progress, quiet),
            on_warning=say,
        )
    if result.study.custom_observers and find_spec("matplotlib"):
        from pcbench.report import figures

        options = figures.FigureOptions(metric=metric, signals=signals)
        figures.scenario_data(result, list(result.study.scenarios), options)  # while the user's code is loaded
    if as_json:
        stats = json.loads(result.stats.to_json(orient="records"))
        summary = {"study": outline.name, "out": into, "provenance": result.provenance, "stats": stats}
        if result.fair is not None:
            summary["fair"] = json.loads(result.fair.to_json(orient="records"))
        print(json.dumps(summary, indent=2))
    elif quiet:
        print(into)
    else:
        from pcbench.cli.render import results

        screen = console()
        results.closing(result, screen, metric, signals, api.operation_counts(result.study) if costs else None)
        if result.fair is not None:
            from pcbench.cli.render import gains

            gains.fair(result.fair, screen)
        screen.say(results.closing_sentence(result, into))
        screen.say(*(results.timings(result, perf_counter() - start) if timings else []))
        screen.say(f"View the results: pcbench report {into}")


def _with_early_imports(progress: Progress, quiet: bool) -> Progress:
    """Return a Progress that also imports the modules for closing and printing once work has begun."""
    modules = EARLY_IMPORTS if quiet else (*EARLY_IMPORTS, "pcbench.cli.render.results")

    def begin(activity: str, steps: int | None) -> None:
        progress.begin(activity, steps)
        Thread(target=lambda: [import_module(name) for name in modules], name="importing").start()

    return progress._replace(begin=begin)


def _require_exact(metric: str) -> None:
    """Raise UserError if neither the metric that ranks observers nor its pooled form has an exact value."""
    from pcbench.moments.stats_rows import ORDER, RUNS_ONLY
    from pcbench.statistics import COMPARED

    def has_exact(metric: str) -> bool:
        steady = "steady_" if metric.startswith("steady_") else ""
        return metric not in RUNS_ONLY or f"{steady}pooled_{metric.removeprefix(steady)}" in ORDER

    if not has_exact(metric):
        raise UserError(
            f"--metric: got {metric}, which has no exact value ({RUNS_ONLY[metric]}), expected one of "
            f"{', '.join(filter(has_exact, COMPARED))}; write one of them, or simulate runs."
        )


def find_limit(
    study: Annotated[str, argument("Study with one scenario, scenario or TOML file")],
    threshold: Annotated[float, option("Limit of the metric, in its unit")],
    axis: Annotated[
        list[str],
        option(
            "Axis such as sampling_period, delay[0] or plant.lam (see pcbench list axes); given twice: the largest value of "
            "the second axis for each value of the first",
            metavar="AXIS",
        ),
    ],
    metric: Annotated[str, option("Metric to compare with the limit (see pcbench list metrics)")] = RANK,
    signal: Signal = None,
    between: Annotated[
        tuple[float, float] | None,
        option(
            "Range of the axis, or of the first of two axes [default: the study's values, or one that suits the scenario]",
            "--range",
            metavar="LOW HIGH",
        ),
    ] = None,
    tol: Annotated[float | None, option("Precision, in the unit of the axis [default: 5 % of the value]")] = None,
    seeds: Annotated[int | None, option("Runs per value [default: the study's]")] = None,
    max_seeds: Annotated[
        int | None, option("Maximum runs per value, if its interval contains the limit [default: 16 times the study's]")
    ] = None,
    observers: Observers = None,
    changes: Set = None,
    folder: Annotated[
        str | None, out("Folder or URI for the runs, which a later search continues [default: results/STUDY-AXIS]")
    ] = None,
    overwrite: Annotated[bool, option("Delete the earlier runs in this folder first", "--overwrite")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Find for each observer the largest period, delay or loss at which an error is significantly below a limit.

    Example: pcbench find-limit cart/white --threshold 0.1 --axis sampling_period
    """
    setup()
    from pcbench.cli.render import limits
    from pcbench.cli.render.tables import to_json
    from pcbench.limits import find_limit
    from pcbench.study import parse

    into = folder
    if into is None:
        name = f"{parse.outline(study, changes or []).name}-{'-'.join(axis)}"
        into = str(Path("results") / re.sub(r"[^\w.+-]+", "-", name).strip("-"))
    with show_progress(quiet or as_json, "designing gains") as progress:
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
            on_warning=say,
        )
    if as_json:
        print(to_json(table.attrs | {"answers": table.to_dict("records")}))
    elif quiet:
        print(into)
    elif len(axis) > 1:
        limits.frontier(table, console())
        console().say(f"Each value has its own study in {into}.")
    else:
        limits.answers(table, console())
        console().say(f"View the runs: pcbench report {into}")


def simulate(
    scenario: Scenario,
    observer: Annotated[str, option("Comma-separated names of observers, or all (that support the scenario)")],
    file: Annotated[str, out("File to write: .parquet or .csv")],
    seed: Annotated[int, option("Index of the seed")] = 0,
    log: Annotated[
        str | None, option("Folder for measurements, inputs and true states, as a recording for pcbench replay")
    ] = None,
    changes: Set = None,
) -> None:
    """Simulate one run and write it tick by tick, as Parquet or CSV.

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
    single_table.write_table(file, single_table.trace_table(frame, signals_of(parse.scenario_of(scenario, changes))))
    print(f"{file}: {len(frame):,} ticks, columns {', '.join(frame.columns)}")


def status(folder: Folder, as_json: Json = False) -> None:
    """Show how many runs of a study are complete, and which files are damaged. Exit code 1 if one is damaged.

    It does not check numbers. Use `pcbench verify` for that.

    Example: pcbench status results/quick
    """
    from pcbench.cli.render import folder as render
    from pcbench.dataset import verify

    content = verify.status(folder)
    if as_json:
        print(json.dumps(content._asdict() | {"shares": [s._asdict() for s in content.shares]}, indent=2))
    else:
        render.status(content, folder, console())
    if content.damaged or content.doubled:
        raise typer.Exit(1)


def merge(
    folders: Annotated[
        list[str], argument("Folders or URIs of one study, with different seeds or from different machines")
    ],
    into: Annotated[str, out("New folder or URI")],
    quiet: Quiet = False,
) -> None:
    """Merge several datasets of one study. Runs that are in more than one must be equal.

    Example: pcbench merge monday tuesday --out both
    """
    from pcbench.dataset import merge

    with show_progress(quiet) as progress:
        report = merge.merge(folders, into, progress)
    duplicates = (
        f" {report.duplicates:,} runs were in more than one dataset, and are equal." if report.duplicates else ""
    )
    fills = f"pcbench run {into}/study.toml --out {into}"
    missing = f" {report.missing:,} runs are missing. Add them: {fills}" if report.missing else ""
    print(f"{report.blocks:,} blocks in {into}.{duplicates}{missing}")


def verify(
    folder: Folder,
    sample: Annotated[
        int | None,
        option("Number of blocks to compute again, and of grid points with exact numbers [default: 4]", min=0),
    ] = None,
    all_blocks: Annotated[bool, option("Compute every block again", "--all")] = False,
    seed: Annotated[int | None, option("Seed of the selection of blocks [default: 0]", min=0)] = None,
    exact: Annotated[bool, option("Compare simulated means with their exact values instead", "--exact")] = False,
    figure: Annotated[str | None, option("File for a quantile plot (with --exact): .svg, .pdf or .png")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Check every file, and compute some blocks again. Exit code 1 if a file is damaged or a number differs.

    Runs must be equal bit for bit, and exact numbers up to rounding.

    With --exact, compare simulated means with their exact values instead, if they have one.

    Example: pcbench verify results/quick --sample 8
    """
    sample_options = {"--sample": sample, "--seed": seed}
    if exact:
        require_effect(sample_options | {"--all": all_blocks}, "with --exact", "leave one of them out")
    if all_blocks:
        require_effect(sample_options, "with --all", "leave one of them out")
    if not exact:
        require_effect({"--figure": figure}, "without --exact", "add --exact, or leave it out")
    setup()
    if exact:
        return _against_exact(folder, figure, quiet, as_json)
    from pcbench.cli.render import folder as render
    from pcbench.dataset import verify

    with show_progress(quiet or as_json) as progress:
        result = verify.verify(
            folder, None if all_blocks else SAMPLE if sample is None else sample, seed or 0, progress
        )
    if as_json:
        print(json.dumps(result._asdict(), indent=2))
    elif not quiet:
        render.verdict(result, folder, console())
    if result.wrong or result.differing or result.unlike:
        raise typer.Exit(1)


def _against_exact(folder: str, figure: str | None, quiet: bool, as_json: bool) -> None:
    """Compare simulated means with exact values, draw the figure if one is requested, and print the verdict."""
    from pcbench.cli.render import folder as render
    from pcbench.cli.render.tables import to_json
    from pcbench.dataset import validate_exact

    validation = validate_exact.check(folder)
    if figure is not None:
        from pcbench import plots

        plots.save(plots.quantiles(validation), figure)
    if as_json:
        summary = {"verdict": validation.verdict, "limit": validation.limit, "refused": validation.refusals}
        print(to_json(summary | {"rows": validation.rows.to_dict("records")}))
    elif not quiet:
        render.against_exact(validation, console())
    if len(validation.wrong):
        raise typer.Exit(1)


def compare(
    there: Annotated[str, argument("Folder or URI of a result of pcbench run")],
    here: Annotated[
        str, argument("Folder or URI of another result of the same study, from another release or machine")
    ],
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare two results of one study: list numbers that changed beyond their interval. Exit code 1 if there are any.

    Example: pcbench compare results/quick elsewhere/quick
    """
    from pcbench.cli.render.tables import to_json
    from pcbench.dataset import compare

    result = compare.compare(there, here)
    if as_json:
        summary = {"rows": len(result.rows), "changed": result.changed, "only": result.only, "made_by": result.made_by}
        summary |= {"same_draws": int(result.rows.same_draws.sum()), "identical": result.identical}
        moved = result.rows[result.rows.changed].to_dict("records")
        print(to_json(summary | {"largest": result.largest, "moved": moved}))
    elif not quiet:
        from pcbench.cli.render import folder

        folder.comparison(result, there, here, console())
    if result.changed:
        raise typer.Exit(1)
