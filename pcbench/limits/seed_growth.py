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
from pcbench.study import fits, grid, observers_of
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
        result = _run(q, values, seeds, why, folder, how._replace(overwrite=how.overwrite and not started))
        started.append(True)
        return points(q, values, why, result)

    return look


def _run(
    q: Question, values: list[float], seeds: Mapping[float, int], why: Refusals, folder: str | Path, how: run_study.How
) -> Result:
    """Run what can be run; what has no gains is found where a design fails, and left out."""
    while True:
        grid = _grid(q, values, why)
        cells = _by_value(q, grid.cells)
        more = {cell.digest: seeds[v] for v, cell in cells.items() if v in seeds}
        try:
            return run_study.execute(grid, folder, how._replace(more=more))
        except DesignError:
            failures = {(o, v): _without_gains(cell, o) for v, cell in cells.items() for o in cell.options}
            if not any(failures.values()):
                raise
            why.gains.update({key: sentence for key, sentence in failures.items() if sentence})


def _without_gains(cell: Cell, observer: str) -> str:
    """Return why an observer has no gains in a cell; empty where it has."""
    try:
        list(planning.drafts([cell._replace(options={observer: cell.options[observer]})]))
    except DesignError as error:
        return str(error)
    return ""


def _grid(q: Question, values: list[float], why: Refusals) -> Grid:
    """Return the study over all values that can be run, each cell with the observers that can; raise UserError where none."""
    name, possible = q.scenario.name, list[float]()
    for value in values:
        if value in why.values:
            continue
        try:
            (cell,) = grid.cells(q.over([value]), name)
        except UserError as error:
            why.values[value] = str(error)
            continue
        possible.append(value)
        for o in cell.options:
            try:
                fits.works_on(o, cell.entry(o), cell.scenario, q.study.name)
            except UserError as error:
                why.observers.setdefault(o, str(error))
    able = [o for o in observers_of(q.study, name) if o not in why.observers]
    kept = {v: each for v in possible if (each := [o for o in able if (o, v) not in why.gains])}
    if not kept:
        raise UserError(next(iter([*why.observers.values(), *why.values.values(), *why.gains.values()])))
    run = [o for o in able if any(o in each for each in kept.values())]
    study = q.over(list(kept)).model_copy(update={"observers": run})
    cells = _by_value(q, grid.cells(study, name))
    return Grid(
        study, [c._replace(options={o: c.options[o] for o in c.options if o in kept[v]}) for v, c in cells.items()]
    )


def _by_value(q: Question, cells: list[Cell]) -> dict[float, Cell]:
    return {q.axis.number(cell.values[q.axis.name]): cell for cell in cells}


def points(q: Question, values: list[float], why: Refusals, result: Result) -> dict[str, list[Point]]:
    """Return by observer what came out at every value, or why nothing did."""
    stats, axis = result.stats, q.axis
    rows: pd.DataFrame = stats[(stats.metric == q.metric) & (stats.signal == q.signal)].copy()
    if rows.empty:
        raise UserError(
            f"--metric: got {q.metric} of {q.signal}, which {q.scenario.name} does not have, expected one that it has; "
            "take another."
        )
    rows[axis.called] = [axis.number(held) for held in rows[axis.name]]
    able = [o for o in observers_of(q.study, q.scenario.name) if o not in why.observers]
    besides = [(o, Point(v, REFUSED, why=sentence)) for o, sentence in why.observers.items() for v in values]
    besides += [(o, Point(v, REFUSED, why=sentence)) for v, sentence in why.values.items() for o in able]
    besides += [(o, Point(v, REFUSED, why=sentence)) for (o, v), sentence in why.gains.items() if v not in why.values]
    answered = {(o, v) for o, v in zip(rows.observer, rows[axis.called], strict=True)} | {
        (o, p.value) for o, p in besides
    }
    besides += [
        (o, Point(v, NULL)) for o in able for v in values if (o, v) not in answered
    ]  # it does not estimate that
    return limit_search.points(rows, axis.called, q.threshold, besides)
