"""Asking runs: a study grows by the values and the seeds that the search wants, and its tables answer.

Every observer runs at every value, so that what is left is a study like any other. An observer that cannot be run over the axis
is left out; one that has no gains at some values is left out there, with the sentence that says why.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from pcbench import planning
from pcbench.dataset import manifest, run_study, storage
from pcbench.dataset.result import Result
from pcbench.errors import DesignError, UserError
from pcbench.limits.search import Look, Question
from pcbench.statistics import limit_search
from pcbench.statistics.limit_search import NULL, REFUSED, Point
from pcbench.study import Study, fits, grid, observers_of
from pcbench.study.grid import Cell, Grid


class Refusals(NamedTuple):
    """Why what is not run is not run."""

    values: dict[float, str]  # no observer runs there: the scenario does not fit together
    observers: dict[str, str]  # it cannot be run over this axis
    gains: dict[tuple[str, float], str]  # it has none there


def stands(folder: str | Path, q: Question) -> list[float]:
    """Return the values of the axis that stand in a folder from earlier; none where it holds no study."""
    target = storage.target(str(folder))
    if storage.text(target, manifest.TEXT) is None:
        return []
    return [q.axis.number(held) for held in manifest.opened(target).study.axes.get(q.axis.name, [])]


def looking(q: Question, folder: str | Path, how: run_study.How) -> Look:
    """Return what runs a study at values of the axis, and says what came out."""
    why, started = Refusals({}, {}, {}), list[bool]()

    def look(values: list[float], seeds: Mapping[float, int]) -> dict[str, list[Point]]:
        now = how._replace(overwrite=how.overwrite and not started)
        result = _run(q, values, seeds, why, folder, now)
        started.append(True)
        return points(q, values, why, result)

    return look


def _run(
    q: Question, values: list[float], seeds: Mapping[float, int], why: Refusals, folder: str | Path, how: run_study.How
) -> Result:
    """Run what can be run; what has no gains is found where a design fails, and left out."""
    while True:
        grid = _grid(q, values, why)
        more = {cell.digest: seeds[v] for v, cell in _by_value(q, grid.cells).items() if v in seeds}
        try:
            return run_study.execute(grid, folder, how._replace(more=more))
        except DesignError:
            found = {
                (o, v): said
                for v, cell in _by_value(q, grid.cells).items()
                for o in cell.options
                if (said := _without_gains(cell, o))
            }
            if not found:
                raise
            why.gains.update(found)


def _without_gains(cell: Cell, observer: str) -> str:
    """Return why an observer has no gains in a cell; empty where it has."""
    try:
        list(planning.drafts([cell._replace(options={observer: cell.options[observer]})]))
    except DesignError as error:
        return str(error)
    return ""


def _grid(q: Question, values: list[float], why: Refusals) -> Grid:
    """Return the study over all values that can be run, each cell with the observers that can; raise UserError where none."""
    name, study = q.scenario.name, q.study
    found: dict[float, Cell] = {}
    for value in values:
        if value in why.values:
            continue
        try:
            (found[value],) = grid.cells(_over(q, [value]), name)
        except UserError as error:
            why.values[value] = str(error)
    for cell in found.values():
        for o in cell.options:
            try:
                fits.works_on(o, cell.entry(o), cell.scenario, study.name)
            except UserError as error:
                why.observers.setdefault(o, str(error))
    able = [o for o in observers_of(study, name) if o not in why.observers]
    kept = {v: [o for o in able if (o, v) not in why.gains] for v in found}
    kept = {v: each for v, each in kept.items() if each}
    if not kept:
        raise UserError(next(iter([*why.observers.values(), *why.values.values(), *why.gains.values()])))
    run = [o for o in able if any(o in each for each in kept.values())]
    grown = _over(q, list(kept)).model_copy(update={"observers": run})
    every = grid.cells(grown, name)
    return Grid(
        grown,
        [
            cell._replace(options={o: given for o, given in cell.options.items() if o in kept[v]})
            for v, cell in _by_value(q, every).items()
        ],
    )


def _over(q: Question, values: list[float]) -> Study:
    """The study with these values of the axis."""
    return q.study.model_copy(update={"axes": q.study.axes | {q.axis.name: [q.axis.put(v) for v in values]}})


def _by_value(q: Question, every: list[Cell]) -> dict[float, Cell]:
    """Cells by their value of the axis."""
    return {q.axis.number(cell.values[q.axis.name]): cell for cell in every}


def points(q: Question, values: list[float], why: Refusals, result: Result) -> dict[str, list[Point]]:
    """Return by observer what came out at every value, or why nothing did."""
    stats = result.stats
    rows: pd.DataFrame = stats[(stats.metric == q.metric) & (stats.signal == q.signal)].copy()
    if rows.empty:
        raise UserError(
            f"--metric: got {q.metric} of {q.signal}, which {q.scenario.name} does not have, expected one that it has; "
            "take another."
        )
    rows[q.axis.called] = [q.axis.number(held) for held in rows[q.axis.name]]
    refused = [(o, Point(v, REFUSED, why=said)) for o, said in why.observers.items() for v in values]
    able = [o for o in observers_of(q.study, q.scenario.name) if o not in why.observers]
    refused += [(o, Point(v, REFUSED, why=said)) for v, said in why.values.items() for o in able]
    refused += [(o, Point(v, REFUSED, why=said)) for (o, v), said in why.gains.items() if v not in why.values]
    found = limit_search.points(rows, q.axis.called, q.threshold, refused)
    there = {o: {p.value for p in each} for o, each in found.items()}
    silent = [
        (o, Point(v, NULL)) for o in able for v in values if v not in there.get(o, set())
    ]  # it does not estimate that
    return limit_search.points(rows, q.axis.called, q.threshold, [*refused, *silent])
