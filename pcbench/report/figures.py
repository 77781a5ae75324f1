"""The figures of a study with their captions: the page shows them, and `--figures` writes them as SVG, PDF and PNG files."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pcbench import plots
from pcbench.dataset import storage
from pcbench.dataset.result import Result
from pcbench.errors import unknown
from pcbench.plants import signals_of
from pcbench.plots import (
    calibration_curves,
    crossings,
    errors_over_time,
    fault_tolerance,
    frames,
    observer_costs,
    one_run,
    scenario_errors,
    time_series,
)
from pcbench.plots.labels import KINDS, describe_metric, render_figure, unit_of
from pcbench.plots.layout import PAPER, Paper
from pcbench.plots.lines import CROSSED
from pcbench.plots.paired_ratios import ratios_of
from pcbench.plots.regret_matrix import regrets_of
from pcbench.report import captions, summary
from pcbench.runtime import thread_pools
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import scenarios_of, title_of_scenario
from pcbench.toml_text import TomlTable


class FigureOptions(NamedTuple):
    """Selection of the figures."""

    metric: str = frames.METRIC  # that ranks observers
    signals: list[str] | None = None  # None: the main signals of each scenario; []: all
    cell: int | None = None  # grid point of the axes that a figure does not show; None: largest lead
    seed: int | None = None  # of the run over time; None: the study's first
    paper: Paper = PAPER
    threshold: float | None = None  # limit of the error; None: twice the least mean of an axis


DEFAULTS = FigureOptions()
NEES = "nees"  # metric


class Picture(NamedTuple):
    """A figure with its texts."""

    name: str  # of a file, without its suffix
    title: str
    figure: Figure
    text: str  # what it shows, for readers who cannot see it
    note: str = ""  # how to read it


def cell_of(result: Result, scenario: str, options: FigureOptions) -> int:
    """Return the number of the grid point of the figures."""
    if options.cell is not None:
        return options.cell
    if result.study.vary == "one-at-a-time":  # the first values of all axes
        return 0
    signals = frames.signals_with_metric(result, scenario, options.signals, options.metric)
    return frames.key_cell(result, scenario, signals[0], options.metric) if signals else 0


class ScenarioData(NamedTuple):
    """A scenario with what its figures show: a grid point, its run over time, and operation counts."""

    result: Result
    scenario: str
    cell: int
    run: pd.DataFrame | None  # over time; None: it is not stored, and its code is not loaded
    costs: pd.DataFrame | None  # of its observers; None: the same, or nothing is sampled
    options: FigureOptions
    is_brief: bool = False  # only the comparison of the observers, and figures over axes


def scenario_data(
    result: Result,
    scenarios: list[str],
    options: FigureOptions,
    progress: Progress = SILENT,
    detailed: list[str] | None = None,
) -> dict[str, ScenarioData]:
    """Return scenarios with their runs over time and operation counts; what is not stored is computed.

    Scenarios that are not `detailed` (None: all are) have no runs over time, and fewer figures.
    """
    at = {scenario: cell_of(result, scenario, options) for scenario in scenarios}
    detailed = scenarios if detailed is None else detailed
    with thread_pools.pool(1) as threads:  # costs are counted while programs are compiled
        costs = {name: threads.submit(observer_costs.frame_of, result.study, name, result.out, at[name]) for name in at}
        shown = {name: at[name] for name in detailed}
        runs = one_run.of_scenarios(result.study, shown, result.out, options.seed, progress)
        return {
            name: ScenarioData(
                result, name, cell, runs.get(name), costs[name].result(), options, is_brief=name not in shown
            )
            for name, cell in at.items()
        }


def of_scenario(source: ScenarioData) -> Iterator[tuple[str | None, Iterator[Picture]]]:
    """Yield the figures of each signal of a scenario, and those of all signals (None)."""
    for signal in frames.signals_with_metric(
        source.result, source.scenario, source.options.signals, source.options.metric
    ):
        yield signal, of_signal(source, signal)
    yield None, of_all_signals(source)


def of_signal(source: ScenarioData, signal: str) -> Iterator[Picture]:
    """Yield the figures of one signal of a scenario, in the order of the page."""
    result, scenario, cell, run, costs, options, is_brief = source
    selection: TomlTable = {"scenario": scenario, "signal": signal, "metric": options.metric, "paper": options.paper}
    name = f"{title_of_scenario(result.study, scenario).replace('/', '-')}-{signal}"
    stats = frames.rows(result, scenario, signal, options.metric)
    part, axes = stats[stats.cell == cell], frames.varying_axes(stats)
    at, titles = frames.values_at(stats, cell), frames.axis_titles(result, stats)
    words, unit = describe_metric(options.metric, signal), unit_of(stats)
    title = words[0].upper() + words[1:]
    if table := ratios_of(result, scenario, signal, options.metric, cell):
        figure, text, note = plots.ratios(result, cell=cell, **selection), captions.ratios(table), captions.best(table)
        yield Picture(f"{name}-ratios", f"{title} relative to the best", figure, text, note)
    seed = result.study.first_seed if options.seed is None else options.seed
    if run is not None:
        figure = time_series.draw_run(result, run, scenario, signal, cell, seed, options.paper)
        exact = time_series.exactly(result, scenario, cell)
        text, note = captions.time(run[run.signal == signal], unit_of_signal(result, scenario, signal), figure, exact)
        yield Picture(f"{name}-time", "One run over time", figure, text, note)
    if run is not None and errors_over_time.has_bands(run, signal):
        figure = errors_over_time.draw_bands(result, run, scenario, signal, cell, seed, options.paper)
        text = captions.bands(run[run.signal == signal], unit_of_signal(result, scenario, signal))
        yield Picture(f"{name}-bands", "Size of the error over time", figure, text, captions.bands_note(figure))
    if result.study.vary == "one-at-a-time" and axes and fault_tolerance.MODEL_ONLY in set(stats.observer):
        alone = fault_tolerance.ratio_to_model_only(result, scenario, signal, options.metric)
        text = captions.tolerances(fault_tolerance.tolerances(alone))
        figure = plots.bearing(result, **selection)
        yield Picture(f"{name}-bearing", "Error relative to model-only over each axis", figure, text, captions.BEARING)
    if len(axes) >= 2 and result.study.vary == "all":
        x, y = frames.map_axes(stats)
        axes_text = f"{frames.label(x, titles)} and {frames.label(y, titles)}"
        figure, standings = (
            plots.winners(result, **selection),
            frames.standings(result, scenario, signal, options.metric),
        )
        note = captions.winners_note(standings, figure, frames.count_runs(stats))
        yield Picture(f"{name}-winners", f"Winners over {axes_text}", figure, captions.winners(standings), note)
        other_values = {a: v for a, v in at.items() if a not in (x, y)}
        figure = plots.heatmaps(result, at=other_values, **selection)
        text = captions.ranges(frames.fix_axes(stats, [x, y], other_values), unit)
        yield Picture(f"{name}-map", f"{title} over {axes_text}", figure, text, captions.map_note(figure))
    for axis in axes:
        other_values = {a: v for a, v in at.items() if a != axis}
        values = frames.fix_axes(stats, [axis], other_values)
        limit = captions.describe_limit(values, axis, unit, options.threshold)
        figure = plots.curves(result, axis, at=other_values, **selection)
        axis_selection: TomlTable = {
            "scenario": scenario,
            "signal": signal,
            "metric": options.metric,
            "at": other_values,
        }
        changes = captions.crossings(crossings.changes(result, axis, **axis_selection)) if axis in CROSSED else ""
        yield Picture(
            name=f"{name}-over-{axis.replace('.', '-')}",
            title=f"{title} over {frames.label(axis, titles)}",
            figure=figure,
            text=captions.curve(values, axis, unit),
            note=captions.curves_note(figure, " ".join(filter(None, [limit, changes])), values),
        )
    if is_brief:
        return
    if frames.has_spread(part):
        figure, caption = plots.distributions(result, cell=cell, **selection), f"Distribution over runs: {words}"
        note = captions.distribution_note(part)
        yield Picture(f"{name}-distribution", caption, figure, captions.medians(part, unit), note)
        text = captions.convergence(frames.convergence(result, scenario, signal, options.metric, cell))
        figure = plots.convergence(result, cell=cell, **selection)
        yield Picture(
            f"{name}-convergence",
            "Width of the interval against the number of runs",
            figure,
            text,
            captions.CONVERGENCE,
        )
    if costs is not None and (costs["sample"] > 0).sum() > 1:
        figure = plots.cost(result, costs, cell=cell, **selection)
        note = captions.costs_note(figure, costs, part)
        yield Picture(f"{name}-cost", f"{title} against operations", figure, captions.costs(costs), note)


def of_all_signals(source: ScenarioData) -> Iterator[Picture]:
    """Yield the figures of a scenario that belong to no signal: diverged runs, filter consistency, and kinds of gains."""
    result, scenario, cell, run, _, options, is_brief = source
    name = title_of_scenario(result.study, scenario).replace("/", "-")
    stats = frames.rows(result, scenario, None, "divergence_rate")
    if result.study.vary == "all" and len(frames.varying_axes(stats)) >= 2 and (stats["mean"] > 0).any():
        x, y = frames.map_axes(stats)
        other_values = {a: v for a, v in frames.values_at(stats, cell).items() if a not in (x, y)}
        figure = plots.divergence(result, scenario=scenario, at=other_values, paper=options.paper)
        part = frames.fix_axes(stats, [x, y], other_values)
        titles = frames.axis_titles(result, stats)
        title = f"Diverged runs over {frames.label(x, titles)} and {frames.label(y, titles)}"
        text = captions.ranges(part.assign(mean=100 * part["mean"]), "%")
        yield Picture(f"{name}-divergence", title, figure, text, captions.divergence_note(part))
    yield from _consistency(source)
    if run is not None and one_run.has_nees(run):
        seed = result.study.first_seed if options.seed is None else options.seed
        figure = time_series.draw_nees(result, run, scenario, cell, seed, options.paper)
        note = captions.consistency_note(run)
        yield Picture(f"{name}-nees", "Consistency of the filters", figure, captions.consistency(run), note)
    if not is_brief and (transforms := calibration_curves.transforms_of(result, scenario, cell)):
        figure = plots.calibration(result, scenario=scenario, cell=cell, paper=options.paper)
        text = captions.calibration(transforms)
        yield Picture(f"{name}-calibration", "Calibration of the filters", figure, text, captions.CALIBRATION)
    if result.fair is not None and scenario in set(result.fair.scenario):
        figure = plots.fair(result, paper=options.paper)
        text, note = captions.fair(result.fair), "Lower is better. Lines are 95 % intervals."
        yield Picture("fair", "Published, designed and tuned gains", figure, text, note)


def _consistency(source: ScenarioData) -> Iterator[Picture]:
    """Yield the NEES of the filters over each axis, if there is any: exact moments may have no answer."""
    result, scenario, cell, _, _, options, _ = source
    stats = result.stats[(result.stats.scenario == scenario) & (result.stats.metric == NEES)]
    if not np.isfinite(stats["mean"]).any():
        return
    nees_stats = frames.rows(result, scenario, None, NEES)
    for axis in frames.varying_axes(nees_stats):
        other_values = {a: v for a, v in frames.values_at(nees_stats, cell).items() if a != axis}
        name = f"{title_of_scenario(result.study, scenario).replace('/', '-')}-nees-over-{axis.replace('.', '-')}"
        yield Picture(
            name,
            f"Consistency over {frames.label(axis, frames.axis_titles(result, nees_stats))}",
            plots.curves(result, axis, scenario=scenario, metric=NEES, at=other_values, paper=options.paper),
            captions.curve(frames.fix_axes(nees_stats, [axis], other_values), axis, ""),
            captions.NEES,
        )


def of_study(result: Result, options: FigureOptions) -> Iterator[Picture]:
    """Yield the figures of all scenarios and grid points together."""
    if matrix := regrets_of(result, options.metric, options.signals):
        figure = plots.regrets(result, metric=options.metric, signals=options.signals, paper=options.paper)
        yield Picture("regrets", "Error relative to the best in each situation", figure, *captions.regrets(matrix))
        if list(matrix.counts.values()).count(len(matrix.situations)) > 1:  # else observers share no situations
            figure = plots.profiles(result, metric=options.metric, signals=options.signals, paper=options.paper)
            yield Picture(
                "profiles",
                "Performance profile and ranks",
                figure,
                captions.profiles(matrix),
                captions.profiles_note(figure, matrix),
            )
    elif len(result.scenarios) > 1 and result.stats.observer.nunique() == 1:
        yield from _scenario_errors(result, options)
    yield from _scenario_consistency(result, options)


def _scenario_consistency(result: Result, options: FigureOptions) -> Iterator[Picture]:
    """Yield the NEES of the filters in each scenario, if two scenarios or more have the signal of the first."""
    first = result.scenarios[0]
    if len(result.scenarios) < 2 or not frames.signals_with_metric(result, first, None, NEES):
        return
    cell = cell_of(result, first, options)
    table = scenario_errors.rows_of(result, metric=NEES, cell=cell)
    table = table[np.isfinite(table["mean"])]
    if table.scenario.nunique() > 1:
        figure = plots.scenarios(result, metric=NEES, cell=cell, paper=options.paper)
        title = "Consistency of the filters in each scenario"
        yield Picture("scenarios-nees", title, figure, captions.scenarios(table), captions.NEES)


def _scenario_errors(result: Result, options: FigureOptions) -> Iterator[Picture]:
    """Yield the error in each scenario, of a loop from its set point, if two scenarios or more have a signal."""
    first = result.scenarios[0]
    tracks = summary.LOOP in set(result.stats_of(first, result.signals(first)[0]).metric)
    metric = summary.LOOP if tracks else options.metric
    for signal in frames.signals_with_metric(result, first, options.signals, metric):
        cell = cell_of(result, first, options)
        table = scenario_errors.rows_of(result, signal, metric, cell)
        if table.scenario.nunique() > 1:
            words = describe_metric(metric, signal)
            yield Picture(
                f"scenarios-{signal}",
                f"{words[0].upper()}{words[1:]} in each scenario",
                plots.scenarios(result, signal=signal, metric=metric, cell=cell, paper=options.paper),
                captions.scenarios(table),
                "Lower is better.",
            )


def unit_of_signal(result: Result, scenario: str, signal: str) -> str:
    """Return the unit of a signal."""
    return dict(signals_of(scenarios_of(result.study)[scenario]))[signal]


def write(
    result: Result,
    out: str | Path,
    progress: Progress = SILENT,
    options: FigureOptions = DEFAULTS,
    formats: tuple[str, ...] = KINDS,
) -> list[str]:
    """Write every figure of the page, and return the names of the files, without their suffix."""
    return put_figures(_all(result, options, progress), out, formats, progress)


def _all(result: Result, options: FigureOptions, progress: Progress) -> Iterator[Picture]:
    """Yield every figure; the runs that they show are simulated before the first one."""
    for place in scenario_data(result, result.scenarios, options, progress).values():
        for _, pictures in of_scenario(place):
            yield from pictures
    yield from of_study(result, options)


def put_figures(
    pictures: Iterable[Picture], out: str | Path, formats: tuple[str, ...], progress: Progress = SILENT
) -> list[str]:
    """Write figures into a folder, and return the names of the files, without their suffix."""
    target, names = storage.target(str(out)), []
    storage.create_folder(target)
    progress.begin("figures", None)
    for picture in pictures:
        for kind in formats:
            storage.write_file(target, f"{picture.name}.{kind}", render_figure(picture.figure, kind))
        names.append(picture.name)
        progress.step(1)
    return names


def kinds_of(text: str) -> tuple[str, ...]:
    """Return the file formats of a comma-separated list; raise UserError for an unknown one."""
    kinds = tuple(dict.fromkeys(kind.strip().lower() for kind in text.split(",")))
    for kind in kinds:
        if kind not in KINDS:
            raise unknown("--formats", "file format", kind, KINDS)
    return kinds
