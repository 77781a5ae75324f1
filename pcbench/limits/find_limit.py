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
    named = [axis] if isinstance(axis, str) else list(axis)
    if len(named) not in (1, 2):
        raise UserError(f"--axis: got {len(named)} axes, expected one or two; ask about two at a time.")
    observers = [observers] if isinstance(observers, str) else observers
    given = {"seeds": seeds, "observers": observers}
    raw = raw_of(study, overrides or [], FROM_HERE)
    where = where_of(study, raw)
    raw |= {key: plain(value) for key, value in given.items() if value is not None}
    raw = all_observers.resolved(raw, where)
    for sentence in all_observers.sentences(raw.get("excluded")):
        say(sentence)
    if len(named) == 2:
        each = {"threshold": threshold, "metric": metric, "signal": signal, "tol": tol, "max_seeds": max_seeds}
        return _frontier(
            raw, where, named, between, out, each | {"overwrite": overwrite, "progress": progress, "say": say}
        )
    ends = _range(between)
    with config.float64(), ExitStack() as stack:
        q = question(described(raw, where, FROM_HERE), where, named[0], metric, signal, threshold)
        scale = scale_of(q.axis, q.scenario, ends, tol)
        if max_seeds is not None and max_seeds < 1:
            raise UserError(f"--max-seeds: got {max_seeds}, expected a number of seeds, 1 or more; leave it out.")
        most = BUDGET * q.study.seeds if max_seeds is None else max(max_seeds, q.study.seeds)
        folder = str(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcbench-")) if out is None else out)
        q = _with_gains(q, (scale.also or (scale.low,))[0], folder, overwrite, progress)
        earlier = [] if overwrite else seed_growth.stands(folder, q)
        scale = scale._replace(also=(*scale.also, *earlier))
        look = seed_growth.looking(q, folder, How(overwrite=overwrite, progress=progress, say=say))
        found = search(look, scale, threshold, most)
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


def _frontier(
    raw: dict[str, Any], where: str, named: list[str], between: Any, out: str | Path | None, how: dict[str, Any]
) -> pd.DataFrame:
    """The largest values of a second axis for each value of a first one; `how`: the other arguments of `find_limit`."""
    ends = list(between) if np.iterable(between) else []
    several = len(ends) == 2 and any(end is None or np.iterable(end) for end in ends)
    first, second = (_range(each) for each in (ends if several else (between, None)))
    s = scenario_in(described(raw, where, FROM_HERE), where)
    names = [each.partition("[")[0].strip().replace("-", "_") for each in named]
    axis = axis_of(named[0], s, raw.get("axes", {}).get(names[0]), where)
    if axis.name == names[1]:
        raise UserError(f"--axis: got {axis.name} twice, expected two axes; name another one.")
    listed = first is None and len(set(axis.own)) > 1
    values = sorted(set(axis.own)) if listed else scale_of(axis, s, first, None).start()
    tables = {}
    for value in values:
        at = raw | {"axes": raw.get("axes", {}) | {axis.name: [axis.put(value)]}}
        into = None if out is None else f"{out}/{re.sub(r'[^0-9A-Za-z_.=-]', '-', f'{axis.called}={value:g}')}"
        tables[value] = find_limit(at, axis=named[1], between=second, out=into, **how)
    found = pd.concat([table.assign(**{axis.called: value}) for value, table in tables.items()], ignore_index=True)
    found.insert(0, axis.called, found.pop(axis.called))
    last = tables[values[-1]].attrs
    units = [AXIS_UNITS.get(axis.name, "").replace("1", ""), last["over_unit"]]
    found.attrs |= last | {"over": [axis.called, last["over"]], "over_unit": units}
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


def _with_gains(q: Question, at: float, folder: str, overwrite: bool, progress: Progress) -> Question:
    """The question of a study whose gains are found: designed or tuned where it asks for that, at the first value."""
    if q.study.tunings == ["published"]:
        return q
    if q.study.tune.cells == "all" and "tuned" in q.study.tunings:
        raise UserError(
            f"{q.study.name}: tune.cells: got 'all', expected 'first': the search decides as it goes which values are tried, "
            "and all have the gains of the first; leave it out."
        )
    first = q.over([at])
    made = gain_variants.prepare(Grid(first, grid.cells(first, q.scenario.name)), folder, overwrite, progress)
    return q._replace(study=made.study)
