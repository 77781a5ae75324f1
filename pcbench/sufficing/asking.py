"""`pcbench.suffices`: a question to a study, answered by a search over runs.

An interval that decides may be looked at several times as seeds are added, which makes it a little too narrow
(`pcbench.dataset.precision`).
"""

import tempfile
from contextlib import ExitStack
from pathlib import Path

import pandas as pd

from pcbench.dataset.run_study import How, Say
from pcbench.errors import UserError
from pcbench.gains import versions
from pcbench.machine import process
from pcbench.machine.progress import SILENT, Progress
from pcbench.planning import all_observers
from pcbench.statistics import sufficing
from pcbench.study import cells, observers_of
from pcbench.study.cells import Grid
from pcbench.study.own_scenarios import plain
from pcbench.study.raw import Described, raw_of, where_of
from pcbench.study.read import FROM_HERE, described
from pcbench.sufficing import growing
from pcbench.sufficing.axis import scale_of
from pcbench.sufficing.question import Question, notes, question
from pcbench.sufficing.search import search

METRIC = "tail_rmse"
BUDGET = 16  # times the study's seeds, where no budget is given


def suffices(
    study: Described,
    *,
    over: str,
    below: float,
    metric: str = METRIC,
    signal: str | None = None,
    between: tuple[float, float] | None = None,
    within: float | None = None,
    seeds: int | None = None,
    max_seeds: int | None = None,
    observers: str | list[str] | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    fresh: bool = False,
    progress: Progress = SILENT,
    say: Say = lambda sentence: None,
) -> pd.DataFrame:
    """Return for each observer the largest value of the axis `over` at which `metric` surely stays below a limit.

    A row an observer; columns: `pcbench.statistics.sufficing.table`. `study` is of one scenario, every other axis with one
    value; `over` is any axis of numbers, such as "sampling_period", "plant.lam", or "delay[0]", the first channel's alone.
    `below` is in the metric's unit. The axis is searched `between` two values (default: the ends of the study's own, or what
    the scenario suggests) to the precision `within`, in its unit (default: a twentieth of the value, at least a tick).
    Intervals that hold the limit get more seeds, `max_seeds` a value at most (default: 16 times the study's). What was run
    stands in the folder `out`, a study like any other, and is used again: for another limit or metric, more seeds, a wider
    range; stopped, it goes on. The frame's `attrs` say what was asked. Raises UserError, one sentence, for whatever the user
    can mend.
    """
    observers = [observers] if isinstance(observers, str) else observers
    raw = raw_of(study, overrides or [], FROM_HERE)
    where = where_of(study, raw)
    raw |= {key: plain(value) for key, value in {"seeds": seeds, "observers": observers}.items() if value is not None}
    raw = all_observers.resolved(raw, where)
    for sentence in all_observers.sentences(raw.get("excluded")):
        say(sentence)
    with process.float64(), ExitStack() as stack:
        q = question(described(raw, where, FROM_HERE), where, over, metric, signal, below)
        scale = scale_of(q.axis, q.scenario, between, within)
        most = _budget(max_seeds, q.study.seeds)
        temporary = None if out is not None else stack.enter_context(tempfile.TemporaryDirectory(prefix="pcbench-"))
        folder = str(out) if temporary is None else temporary
        q = _with_gains(q, scale.also or (scale.low,), folder, fresh, progress)
        earlier = [] if fresh else growing.stands(folder, q)
        scale = scale._replace(also=(*scale.also, *earlier))
        found = search(growing.looking(q, folder, How(fresh=fresh, progress=progress, say=say)), scale, below, most)
    answers = {o: sufficing.answer(found[o]) for o in observers_of(q.study, q.scenario.name)}
    table = sufficing.table(answers, q.axis.called)
    table.attrs |= {
        "study": q.study.name,
        "scenario": q.scenario.name,
        "over": q.axis.called,
        "over_unit": q.axis_unit,
        "metric": metric,
        "signal": q.signal,
        "unit": q.unit,
        "below": below,
        "between": (scale.low, scale.high),
        "out": None if out is None else folder,
        "notes": notes(q),
    }
    return table


def _budget(most: int | None, seeds: int) -> int:
    if most is not None and most < 1:
        raise UserError(f"--max-seeds: got {most}, expected a number of seeds, 1 or more; leave it out.")
    return BUDGET * seeds if most is None else max(most, seeds)


def _with_gains(q: Question, at: tuple[float, ...], folder: str, fresh: bool, progress: Progress) -> Question:
    """The question of a study whose gains are found: designed or tuned where it asks for that, at the first value."""
    if q.study.tunings == ["paper"]:
        return q
    here = q.study.model_copy(update={"axes": q.study.axes | {q.axis.name: [q.axis.put(at[0])]}})
    made = versions.prepare(Grid(here, cells.cells(here, q.scenario.name)), folder, fresh, progress)
    return q._replace(study=made.study)
