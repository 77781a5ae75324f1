"""`pcbench.find_limit`: a question to a study, answered by a search over runs.

An interval that decides may be looked at several times as seeds are added, which makes it a little too narrow
(`pcbench.dataset.adaptive_seeds`).
"""

import re
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pcbench.dataset.columns import AXIS_UNITS
from pcbench.dataset.run_study import How, Say
from pcbench.errors import UserError
from pcbench.gains import gain_variants
from pcbench.limits import seed_growth
from pcbench.limits.search import Question, axis_of, notes, question, scale_of, search
from pcbench.planning import all_observers
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.statistics import limit_search
from pcbench.study import grid, observers_of
from pcbench.study.grid import Grid
from pcbench.study.load import Described, raw_of, where_of
from pcbench.study.parse import FROM_HERE, described, scenario_in
from pcbench.study.plugins.user_plants import plain

METRIC = "steady_rmse"
BUDGET = 16  # times the study's seeds, where no budget is given


def find_limit(
    study: Described,
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
    say: Say = lambda sentence: None,
) -> pd.DataFrame:
    """Return for each observer the largest value of `axis` at which `metric` surely stays below a limit.

    A row an observer; columns: `pcbench.statistics.limit_search.table`. `study` is of one scenario, every other axis with one
    value; `axis` is any axis of numbers, such as "sampling_period", "plant.lam", or "delay[0]", the first channel's alone.
    `threshold` is in the metric's unit. The axis is searched `between` two values (default: the ends of the study's own, or
    what the scenario suggests) to the precision `tol`, in its unit (default: a twentieth of the value, at least a tick).
    Intervals that hold the limit get more seeds, `max_seeds` a value at most (default: 16 times the study's). What was run
    stands in the folder `out`, a study like any other, and is used again: for another limit or metric, more seeds, a wider
    range; stopped, it goes on. The frame's `attrs` say what was asked. Raises UserError, one sentence, for whatever the user
    can mend.

    Two axes, such as ["sampling_period", "delay"], return their frontier: for each value of the first axis the largest value
    of the second. The first axis takes the study's values or, `between` two, five values and those of the study within.
    The frame then has a row for each value and observer, with the value in a column of the axis' name. `between` is then the
    range of the first axis, or a list of two ranges, of which None is the default one. Each value has a folder of its own in
    `out`.
    """
    if not isinstance(axis, str):
        each = {"threshold": threshold, "metric": metric, "signal": signal, "tol": tol, "seeds": seeds}
        each |= {"max_seeds": max_seeds, "overwrite": overwrite, "progress": progress, "say": say}
        return frontier(study, list(axis), between, observers, out, overrides or [], each)
    ends = _range(between)
    observers = [observers] if isinstance(observers, str) else observers
    raw = raw_of(study, overrides or [], FROM_HERE)
    where = where_of(study, raw)
    raw |= {key: plain(value) for key, value in {"seeds": seeds, "observers": observers}.items() if value is not None}
    raw = all_observers.resolved(raw, where)
    for sentence in all_observers.sentences(raw.get("excluded")):
        say(sentence)
    with config.float64(), ExitStack() as stack:
        q = question(described(raw, where, FROM_HERE), where, axis, metric, signal, threshold)
        scale = scale_of(q.axis, q.scenario, ends, tol)
        most = _budget(max_seeds, q.study.seeds)
        temporary = None if out is not None else stack.enter_context(tempfile.TemporaryDirectory(prefix="pcbench-"))
        folder = str(out) if temporary is None else temporary
        q = _with_gains(q, scale.also or (scale.low,), folder, overwrite, progress)
        earlier = [] if overwrite else seed_growth.stands(folder, q)
        scale = scale._replace(also=(*scale.also, *earlier))
        found = search(
            seed_growth.looking(q, folder, How(overwrite=overwrite, progress=progress, say=say)), scale, threshold, most
        )
    answers = {o: limit_search.answer(found[o]) for o in observers_of(q.study, q.scenario.name)}
    table = limit_search.table(answers, q.axis.called)
    table.attrs |= {
        "study": q.study.name,
        "scenario": q.scenario.name,
        "over": q.axis.called,
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


def frontier(
    study: Described,
    axes: list[str],
    between: Any,
    observers: str | list[str] | None,
    out: str | Path | None,
    overrides: list[str],
    how: dict[str, Any],
) -> pd.DataFrame:
    """Return the largest values of a second axis for each value of a first one; `how`: the other arguments of `find_limit`."""
    if len(axes) == 1:
        return find_limit(
            study, axis=axes[0], between=between, observers=observers, out=out, overrides=overrides, **how
        )
    if len(axes) != 2:
        raise UserError(f"--axis: got {len(axes)} axes, expected one or two; ask about two at a time.")
    raw = raw_of(study, overrides, FROM_HERE)
    where = where_of(study, raw)
    raw |= {} if observers is None else {"observers": [observers] if isinstance(observers, str) else observers}
    raw = all_observers.resolved(raw, where)
    for sentence in all_observers.sentences(raw.get("excluded")):
        how["say"](sentence)
    ends = list(between) if np.iterable(between) else []
    several = len(ends) == 2 and any(end is None or np.iterable(end) for end in ends)
    first, second = (_range(each) for each in (ends if several else (between, None)))
    s = scenario_in(described(raw, where, FROM_HERE), where)
    axis = axis_of(axes[0], s, raw.get("axes", {}).get(axes[0].partition("[")[0].strip().replace("-", "_")), where)
    if axis.name == axes[1].partition("[")[0].strip().replace("-", "_"):
        raise UserError(f"--axis: got {axis.name} twice, expected two axes; name another one.")
    listed = first is None and len(set(axis.own)) > 1
    values = sorted(set(axis.own)) if listed else scale_of(axis, s, first, None).start()
    tables = {}
    for value in values:
        here = raw | {"axes": raw.get("axes", {}) | {axis.name: [axis.put(value)]}}
        into = None if out is None else f"{out}/{re.sub(r'[^0-9A-Za-z_.=-]', '-', f'{axis.called}={value:g}')}"
        tables[value] = find_limit(here, axis=axes[1], between=second, out=into, **how)
    found = pd.concat([table.assign(**{axis.called: value}) for value, table in tables.items()], ignore_index=True)
    found.insert(0, axis.called, found.pop(axis.called))
    last = tables[values[-1]].attrs
    unit = AXIS_UNITS.get(axis.name, "").replace("1", "")
    found.attrs |= last | {"over": [axis.called, last["over"]], "over_unit": [unit, last["over_unit"]]}
    found.attrs |= {"between": [(values[0], values[-1]), last["between"]], "out": None if out is None else str(out)}
    return found


def _range(between: Any) -> tuple[float, float] | None:
    """Return the two ends of one axis' range; raise UserError if it is anything else."""
    if between is None:
        return None
    ends = list(between) if np.iterable(between) else []
    if len(ends) != 2 or not all(isinstance(end, Real) for end in ends):
        raise UserError(f"between: got {between}, expected the two ends of a range for one axis; write (LOW, HIGH).")
    return ends[0], ends[1]


def _budget(most: int | None, seeds: int) -> int:
    if most is not None and most < 1:
        raise UserError(f"--max-seeds: got {most}, expected a number of seeds, 1 or more; leave it out.")
    return BUDGET * seeds if most is None else max(most, seeds)


def _with_gains(q: Question, at: tuple[float, ...], folder: str, overwrite: bool, progress: Progress) -> Question:
    """The question of a study whose gains are found: designed or tuned where it asks for that, at the first value."""
    if q.study.tunings == ["published"]:
        return q
    if q.study.tune.cells == "all" and "tuned" in q.study.tunings:
        raise UserError(
            f"{q.study.name}: tune.cells: got 'all', expected 'first': the search decides as it goes which values are tried, "
            "and all have the gains of the first; leave it out."
        )
    here = q.study.model_copy(update={"axes": q.study.axes | {q.axis.name: [q.axis.put(at[0])]}})
    made = gain_variants.prepare(Grid(here, grid.cells(here, q.scenario.name)), folder, overwrite, progress)
    return q._replace(study=made.study)
