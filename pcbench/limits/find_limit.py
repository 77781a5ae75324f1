"""`pcbench.find_limit`: find limits of a study by a search over runs.

The search adds values and seeds to the study, and reads its tables. Every observer runs at every value, so the result is an
ordinary study. An observer that does not support the axis is left out. One without gains at some values is left out there, with
the reason.

An interval may be evaluated several times as seeds are added, which makes it slightly too narrow
(`pcbench.dataset.adaptive_seeds`).
"""

import re
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from numbers import Real
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from pcbench import planning
from pcbench.dataset import manifest, run_study, storage
from pcbench.dataset.columns import AXIS_UNITS
from pcbench.dataset.result import Result
from pcbench.dataset.run_study import OnWarning, RunOptions
from pcbench.errors import DesignError, UserError
from pcbench.gains import gain_variants
from pcbench.limits.search import Look, Question, axis_of, notes, question, scale_of, search
from pcbench.planning import all_observers
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.statistics import limit_verdicts
from pcbench.statistics.limit_verdicts import NULL, REFUSED, Point
from pcbench.study import fits, grid, observers_of, title_of_scenario
from pcbench.study.grid import Cell, Grid
from pcbench.study.load import StudyLike, raw_of, where_of
from pcbench.study.parse import FROM_HERE, build_study, scenario_in
from pcbench.study.plugins.user_plants import plain
from pcbench.toml_text import TomlTable

METRIC = "steady_rmse"
BUDGET = 16  # times the study's seeds, the default budget


def find_limit(
    study: StudyLike,
    *,
    axis: str | Sequence[str],
    threshold: float,
    metric: str = METRIC,
    signal: str | None = None,
    between: tuple[float, float] | Sequence[tuple[float, float] | None] | None = None,
    tol: float | None = None,
    seeds: int | None = None,
    max_seeds: int | None = None,
    observers: str | list[str] | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    overwrite: bool = False,
    progress: Progress = SILENT,
    on_warning: OnWarning = lambda sentence: None,
) -> pd.DataFrame:
    """Find for each observer the largest value of an axis at which a metric is significantly below a threshold.

    A value passes if the whole 95 % interval of the metric is below the threshold and no run has diverged. If the interval
    contains the threshold, more seeds are run.

    Args:
        study: as in `run`, with one scenario and one value of every other axis.
        axis: an axis of numbers, such as "sampling_period", "plant.lam" or "delay[0]" (the first channel). Two axes give a
            frontier: for each value of the first, the largest value of the second.
        threshold: the limit, in the metric's unit.
        metric: a metric of the tables.
        signal: the signal. Default: the first of the closing table.
        between: range of the axis (low, high), of two axes of the first, or a list of two ranges (None: the default).
            Default: the ends of the study's own values, or what the scenario suggests.
        tol: precision, in the axis' unit. Default: 5 % of the value, at least one tick.
        seeds: number of seeds per value.
        max_seeds: maximum seeds per value. Default: 16 times the study's.
        observers: names of observers.
        out: folder or URI for the runs, which are used again by later calls. Default: a temporary folder.
        overrides: changes of the study as texts.
        overwrite: delete what is in `out` first.
        progress: is called with the progress.
        on_warning: is called with each warning.

    Returns:
        A frame with one row per observer (of two axes, per value and observer); for the columns see
        `pcbench.statistics.limit_verdicts.table`. `attrs` has the question.

    Raises:
        UserError: a mistake in the study or an argument, in one sentence.
    """
    axes = [axis] if isinstance(axis, str) else list(axis)
    if len(axes) not in (1, 2):
        raise UserError(f"--axis: got {len(axes)} axes, expected one or two; give at most two.")
    observers = [observers] if isinstance(observers, str) else observers
    options = {"seeds": seeds, "observers": observers}
    raw = raw_of(study, overrides or [], FROM_HERE)
    where = where_of(study, raw)
    raw |= {key: plain(value) for key, value in options.items() if value is not None}
    raw = all_observers.resolve_observers(raw, where)
    for sentence in all_observers.sentences(raw.get("excluded")):
        on_warning(sentence)
    if len(axes) == 2:
        arguments = {"threshold": threshold, "metric": metric, "signal": signal, "tol": tol, "max_seeds": max_seeds}
        arguments |= {"overwrite": overwrite, "progress": progress, "on_warning": on_warning}
        return _frontier(raw, where, axes, between, out, arguments)
    ends = _range(between)
    with config.float64(), ExitStack() as stack:
        q = question(build_study(raw, where, FROM_HERE), where, axes[0], metric, signal, threshold)
        scale = scale_of(q.axis, q.scenario, ends, tol)
        if max_seeds is not None and max_seeds < 1:
            raise UserError(f"--max-seeds: got {max_seeds}, expected a number of seeds, 1 or more; leave it out.")
        most = BUDGET * q.study.seeds if max_seeds is None else max(max_seeds, q.study.seeds)
        folder = str(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcbench-")) if out is None else out)
        q = _with_gains(q, (scale.also or (scale.low,))[0], folder, overwrite, progress)
        old_values = [] if overwrite else stored_values(folder, q)
        scale = scale._replace(also=(*scale.also, *old_values))
        look = look_of(q, folder, RunOptions(overwrite=overwrite, progress=progress, on_warning=on_warning))
        results = search(look, scale, threshold, most)
    answers = {o: limit_verdicts.answer(results[o]) for o in observers_of(q.study, q.scenario.name)}
    table = limit_verdicts.table(answers, q.axis.label)
    table.attrs |= {
        "study": q.study.name,
        "scenario": q.scenario.name,
        "title": title_of_scenario(q.study, q.scenario.name),
        "over": q.axis.label,
        "over_unit": q.axis_unit,
        "metric": metric,
        "signal": q.signal,
        "unit": q.unit,
        "below": threshold,
        "between": (scale.low, scale.high),
        "out": None if out is None else folder,
        "notes": notes(q),
    }
    return table


def _frontier(
    raw: TomlTable, where: str, axes: list[str], between: object, out: str | Path | None, options: TomlTable
) -> pd.DataFrame:
    """Return the largest values of a second axis for each value of a first one; `options` are passed to `find_limit`."""
    ends = list(between) if np.iterable(between) else []
    several = len(ends) == 2 and any(end is None or np.iterable(end) for end in ends)
    first, second = (_range(x) for x in (ends if several else (between, None)))
    s = scenario_in(build_study(raw, where, FROM_HERE), where)
    names = [x.partition("[")[0].strip().replace("-", "_") for x in axes]
    axis = axis_of(axes[0], s, raw.get("axes", {}).get(names[0]), where)
    if axis.name == names[1]:
        raise UserError(f"--axis: got {axis.name} twice, expected two axes; name another one.")
    is_listed = first is None and len(set(axis.values)) > 1
    values = sorted(set(axis.values)) if is_listed else scale_of(axis, s, first, None).start()
    tables = {}
    for value in values:
        value_study = raw | {"axes": raw.get("axes", {}) | {axis.name: [axis.to_study(value)]}}
        folder = None if out is None else f"{out}/{re.sub(r'[^0-9A-Za-z_.=-]', '-', f'{axis.label}={value:g}')}"
        tables[value] = find_limit(value_study, axis=axes[1], between=second, out=folder, **options)
    frontier = pd.concat([table.assign(**{axis.label: value}) for value, table in tables.items()], ignore_index=True)
    frontier.insert(0, axis.label, frontier.pop(axis.label))
    last = tables[values[-1]].attrs
    units = [AXIS_UNITS.get(axis.name, "").replace("1", ""), last["over_unit"]]
    frontier.attrs |= last | {"over": [axis.label, last["over"]], "over_unit": units}
    frontier.attrs |= {"between": [(values[0], values[-1]), last["between"]], "out": None if out is None else str(out)}
    return frontier


def _range(between: object) -> tuple[float, float] | None:
    """Return the two ends of one axis' range; raise UserError for anything else."""
    if between is None:
        return None
    ends = list(between) if np.iterable(between) else []
    if len(ends) != 2 or not all(isinstance(end, Real) for end in ends):
        raise UserError(f"between: got {between}, expected the two ends of a range for one axis; write (LOW, HIGH).")
    return ends[0], ends[1]


def _with_gains(q: Question, value: float, folder: str, overwrite: bool, progress: Progress) -> Question:
    """Return the question with the study's gains designed or tuned, if requested, at the first value."""
    if q.study.tunings == ["published"]:
        return q
    if q.study.tune.cells == "all" and "tuned" in q.study.tunings:
        raise UserError(
            f"{q.study.name}: tune.cells: got 'all', expected 'first': the search decides as it goes which values are tried, "
            "and all have the gains of the first; leave it out."
        )
    first = q.with_values([value])
    variants = gain_variants.prepare(Grid(first, grid.cells(first, q.scenario.name)), folder, overwrite, progress)
    return q._replace(study=variants.study)


class Refusals(NamedTuple):
    """Reasons for combinations that are not run."""

    values: dict[float, str]  # no observer runs at this value: the scenario is invalid
    observers: dict[str, str]  # the observer does not support the axis
    gains: dict[tuple[str, float], str]  # the observer has no gains at this value


def stored_values(folder: str | Path, q: Question) -> list[float]:
    """Return the values of the axis already stored in a folder; empty if it contains no study."""
    target = storage.target(str(folder))
    if storage.read_bytes(target, manifest.TEXT) is None:
        return []
    return [q.axis.number(value) for value in manifest.load_manifest(target).study.axes.get(q.axis.name, [])]


def look_of(q: Question, folder: str | Path, options: RunOptions) -> Look:
    """Return a function that runs a study at values of the axis, and returns the results."""
    refusals, calls = Refusals({}, {}, {}), list[bool]()

    def look(values: list[float], seeds: Mapping[float, int]) -> dict[str, list[Point]]:
        result = _run(q, values, seeds, refusals, folder, options._replace(overwrite=options.overwrite and not calls))
        calls.append(True)
        return points(q, values, refusals, result)

    return look


def _run(
    q: Question,
    values: list[float],
    seeds: Mapping[float, int],
    refusals: Refusals,
    folder: str | Path,
    options: RunOptions,
) -> Result:
    """Run all supported combinations; if a design fails, leave out the observers without gains and try again."""
    while True:
        study_grid = _grid(q, values, refusals)
        cells = _by_value(q, study_grid.cells)
        new_seeds = {cell.digest: seeds[v] for v, cell in cells.items() if v in seeds}
        try:
            return run_study.execute(study_grid, folder, options._replace(min_seeds=new_seeds))
        except DesignError:
            failures = {(o, v): _without_gains(cell, o) for v, cell in cells.items() for o in cell.options}
            if not any(failures.values()):
                raise
            refusals.gains.update({key: sentence for key, sentence in failures.items() if sentence})


def _without_gains(cell: Cell, observer: str) -> str:
    """Return the reason why an observer has no gains at a grid point; empty if it has."""
    try:
        list(planning.drafts([cell._replace(options={observer: cell.options[observer]})]))
    except DesignError as error:
        return str(error)
    return ""


def _grid(q: Question, values: list[float], refusals: Refusals) -> Grid:
    """Return the study over all valid values, each grid point with its supported observers; raise UserError if none is left."""
    name, valid = q.scenario.name, list[float]()
    for value in values:
        if value in refusals.values:
            continue
        try:
            (cell,) = grid.cells(q.with_values([value]), name)
        except UserError as error:
            refusals.values[value] = str(error)
            continue
        valid.append(value)
        for o in cell.options:
            try:
                fits.works_on(o, cell.entry(o), cell.scenario, q.study.name)
            except UserError as error:
                refusals.observers.setdefault(o, str(error))
    supported = [o for o in observers_of(q.study, name) if o not in refusals.observers]
    by_value = {v: labels for v in valid if (labels := [o for o in supported if (o, v) not in refusals.gains])}
    if not by_value:
        raise UserError(next(iter([*refusals.observers.values(), *refusals.values.values(), *refusals.gains.values()])))
    observers = [o for o in supported if any(o in labels for labels in by_value.values())]
    study = q.with_values(list(by_value)).model_copy(update={"observers": observers})
    cells = _by_value(q, grid.cells(study, name))
    options = {v: {o: c.options[o] for o in c.options if o in by_value[v]} for v, c in cells.items()}
    return Grid(study, [c._replace(options=options[v]) for v, c in cells.items()])


def _by_value(q: Question, cells: list[Cell]) -> dict[float, Cell]:
    return {q.axis.number(cell.values[q.axis.name]): cell for cell in cells}


def points(q: Question, values: list[float], refusals: Refusals, result: Result) -> dict[str, list[Point]]:
    """Return the results at every value by observer, or the reason for a missing one."""
    stats, axis = result.stats, q.axis
    rows: pd.DataFrame = stats[(stats.metric == q.metric) & (stats.signal == q.signal)].copy()
    if rows.empty:
        raise UserError(
            f"--metric: got {q.metric} of {q.signal}, which {q.scenario.name} does not have, expected one that it has; "
            "use another."
        )
    rows[axis.label] = [axis.number(value) for value in rows[axis.name]]
    supported = [o for o in observers_of(q.study, q.scenario.name) if o not in refusals.observers]
    missing = [(o, Point(v, REFUSED, why=sentence)) for o, sentence in refusals.observers.items() for v in values]
    missing += [(o, Point(v, REFUSED, why=sentence)) for v, sentence in refusals.values.items() for o in supported]
    refused_gains = {key: sentence for key, sentence in refusals.gains.items() if key[1] not in refusals.values}
    missing += [(o, Point(v, REFUSED, why=sentence)) for (o, v), sentence in refused_gains.items()]
    pairs = {*zip(rows.observer, rows[axis.label], strict=True), *((o, p.value) for o, p in missing)}
    # the observer does not estimate this signal
    missing += [(o, Point(v, NULL)) for o in supported for v in values if (o, v) not in pairs]
    return limit_verdicts.points(rows, axis.label, q.threshold, missing)
