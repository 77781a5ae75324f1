"""What tuning on a log found: intensities with their intervals, what the held-out part says of them, and the record."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from pcbench.dataset import storage
from pcbench.gains import parameters, tune
from pcbench.gains.history import FOUND, Evaluation
from pcbench.gains.parameters import Vector
from pcbench.gains.validation import WORSE
from pcbench.playback import confidence_intervals, innovation_tests
from pcbench.playback.likelihood import Found
from pcbench.playback.output import plain
from pcbench.study import Study

UNLIKELY = 0.05  # a p-value of whiteness below which intervals are said to be too short


class Intensity(NamedTuple):
    """One number that was found."""

    name: str  # of the option, with the place in it: R[0], Q[1]
    start: float
    found: float  # on the whole log
    low: float  # 95 % interval; NaN: the log does not tell it; 0: `high` is a one-sided limit
    high: float


class LogTuning(NamedTuple):
    """What tuning on a log found."""

    study: dict[str, Any]  # the plant and the observer with the options chosen: what tuned.toml says
    start: dict[str, Any]
    found: dict[str, Any]
    kept_start: str  # why the start was kept; empty: what was found is chosen
    intensities: list[Intensity]
    held_out: dict[
        str, dict[str, Any]
    ]  # start and tuned (to the first part): what `innovation_tests` says, of the held-out part alone
    gain: float  # in log-likelihood of a held-out number, tuned to the first part less start,
    gain_se: float  # and its standard error over samples
    points: list[Evaluation]  # of the fit to the first part, then of that to the whole log
    said: list[str]


class Outcome(NamedTuple):
    """Two descents that have ended."""

    where: str
    label: str
    study: Study
    said: list[str]
    free: list[parameters.Free]
    start: Vector
    fitted: Vector  # to the first part
    best: Vector  # of the whole log
    arrived: bool
    points: list[Evaluation]
    look: Callable[[Vector], Found]
    cut: int  # the tick at which what is held out begins


def finish(o: Outcome, target: storage.Target, about: str) -> LogTuning:
    """Judge what was found, and write it: a study that can be run, and under [resolved.tuning] how it came about."""
    before, after = o.look(o.start), o.look(o.fitted)
    late = before.tick >= o.cut
    less = after.each[late] - before.each[late]
    many = float(before.numbers[late, 1].sum())
    gain, se = float(less.sum() / many), float(np.std(less, ddof=1) * np.sqrt(len(less)) / many)
    each = intervals(o)
    kept = "" if gain >= -WORSE * se else f"held-out log-likelihood falls by {-gain:.3g} (standard error {se:.2g})"
    held_out = {"start": judged(before, late), "tuned": judged(after, late)}
    found, start = (parameters.written(o.free, at) for at in (o.best, o.start))
    out = LogTuning(
        study=tune.with_options(o.study, o.label, {} if kept else found),
        start=start,
        found=found,
        kept_start=kept,
        intensities=each,
        held_out=held_out,
        gain=gain,
        gain_se=se,
        points=o.points,
        said=[*o.said, *remarks(o, each, held_out["tuned"])],
    )
    said: dict[str, Any] = {"about": about, "start": start, "found": found, "kept_start": kept, "method": "likelihood"}
    said |= {"intensities": [i._asdict() for i in each], "gain": gain, "gain_se": se, "held_out": held_out}
    storage.put(target, FOUND, tomli_w.dumps(out.study | {"resolved": {"tuning": without_none(plain(said))}}).encode())
    return out


def intervals(o: Outcome) -> list[Intensity]:
    """Return each free number with its interval; none where the descent has not arrived."""

    def likelihood(at: Vector) -> tuple[float, Vector]:
        found = o.look(at)
        return float(found.each.sum()), np.asarray(found.score.sum(0))

    low = high = np.full(len(o.best), np.nan)
    if o.arrived:
        low, high = confidence_intervals.intervals(likelihood, o.best)
    untold = np.isnan(high)
    rows = [_flat(o.free, at) for at in (o.start, o.best, *(np.where(untold, o.best, end) for end in (low, high)))]
    rows[2][untold | np.isneginf(low)] = 0.0
    rows[2][untold] = rows[3][untold] = np.nan
    names = parameters.entries(o.free)
    return [Intensity(name, *(float(v) for v in row)) for name, *row in zip(names, *rows, strict=True)]


def _flat(free: list[parameters.Free], at: Vector) -> Vector:
    return np.concatenate([np.ravel(v) for v in parameters.written(free, at).values()])


def judged(found: Found, which: Any) -> dict[str, Any]:
    """Return what innovations say of some samples."""
    numbers = found.numbers[which]
    return innovation_tests.judgement(
        innovation_tests.add(innovation_tests.Sums(), numbers, np.ones(len(numbers), bool))
    )


def remarks(o: Outcome, each: list[Intensity], held_out: dict[str, Any]) -> list[str]:
    """Return what one should know of the intervals."""
    out = []
    if not o.arrived:
        out.append("the budget ended before the likelihood was flat: no interval is given; give a larger --budget.")
    else:
        if untold := [i.name for i in each if np.isnan(i.low)]:
            out.append(
                f"{', '.join(untold)}: the log does not tell, so no interval is given; --only tunes the others alone."
            )
        if limits := [f"{i.name} (below {i.high:.2g})" for i in each if i.low == 0]:
            out.append(
                f"{', '.join(limits)}: the log does not exclude 0, so this is a one-sided 95 % limit (profile likelihood)."
            )
    if held_out["p_white"] < UNLIKELY:
        out.append(
            f"innovations of the held-out part are not white (p = {held_out['p_white']:.2g}): the model or a delay is wrong, "
            "and intervals are too short."
        )
    return out


def without_none(thing: Any) -> Any:
    """Return a record as TOML can hold it: what is not known is left out."""
    if isinstance(thing, dict):
        return {key: without_none(each) for key, each in thing.items() if each is not None}
    return [without_none(each) for each in thing] if isinstance(thing, list) else thing
