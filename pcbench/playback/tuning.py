"""Noise intensities that make a log most likely: fitted to its first part, judged on the rest, then fitted to the whole log.

The same parameters, descent, history and refusals as `gains.tune`; the objective is minus the mean log-likelihood of a number.
What is held out is the part that a replay holds out (`judging.HELD_OUT` of the ticks). The fit to the whole log starts from the
first one and is the result, since a rare channel needs all samples; the held-out gain is that of the first.

What tuning on a log found: intensities with their intervals, what the held-out part says of them, and the record.
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from pydantic import BaseModel

from pcbench import planning
from pcbench.dataset import storage
from pcbench.errors import UserError
from pcbench.gains import parameters, tune
from pcbench.gains.history import FOUND, REFIT, Evaluation, History, basis_of
from pcbench.gains.parameters import Vector
from pcbench.gains.validation import WORSE
from pcbench.observers import ObserverSpec
from pcbench.playback import innovation_tests, likelihood
from pcbench.playback.likelihood import Found, Recorded
from pcbench.playback.replay import asked
from pcbench.playback.replay_metrics import plain
from pcbench.runtime import config, ending
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import Study, parse
from pcbench.study.labels import label_of
from pcbench.study.load import Described
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import Design

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
        low, high = innovation_tests.intervals(likelihood, o.best)
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


NOISE = ("R", "q", "Q")  # options of an observer that are intensities of noise
FEWEST = 10  # numbers in the part that is tuned on, and in the rest, for each free parameter
FLAT = 1e-6  # slope of the mean log-likelihood of a number at which a descent has arrived


def tune_log(
    log: str | Path,
    plant: Described,
    observer: str,
    *,
    budget: int = tune.BUDGET,
    only: list[str] | None = None,
    delay: float | None = None,
    start: float | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    progress: Progress = SILENT,
) -> LogTuning:
    """Find an observer's noise intensities (`only` some options) on a log; a fit to its first part is judged on the rest.

    `log`, `plant`, `delay` and `start` are as in `replay`; each of the two fits replays the log `budget` times at most. The
    folder `out` holds the histories and tuned.toml, which `replay` and `run` take. Raises UserError if the user has to act.
    """
    label = label_of(observer)
    with config.float64(), ending.temporary_folder() as spare:
        study, _ = parse.one_cell(plant, [observer], overrides or [])
        a = asked(log, plant, [observer], delay=delay, start=start, overrides=overrides)
        where = f"tune {label} on {a.name}"
        entry, options = a.cell.entry(label), a.cell.options[label]
        _require(entry, budget, where)
        record = likelihood.recorded(a)
        known = record.prepared.setting
        designed = planning.designed(label, entry, known, options)
        every, at = tune.freed(
            label, entry, known, options, designed, _free(entry, options, designed, only, where), where
        )
        if any(f.kind == "covariance" for f in every):
            raise UserError(
                f"{where}: got a covariance in full to tune, expected one number for each output or state; write its diagonal."
            )

        def design(point: Vector) -> Any:
            return planning.designed(label, entry, known, parameters.put(options, every, point)).gains

        cut = int((1 - innovation_tests.HELD_OUT) * a.last)
        brought = record.part.window.mask.sum((1, 2))
        _require_samples(record.part.first + np.arange(len(brought)), brought, cut, len(at), where)
        target = storage.target(str(out) if out is not None else spare)
        names = parameters.entries(every)
        about = f"{where}: {', '.join(names)} of {_digest(record)}, for {digest(study, [a.cell])[:12]}"
        trials = History(target, about, names, basis_of(study, a.cell))
        progress.begin("points", budget)
        progress.note("compiling")
        look = likelihood.evaluator(record, design)
        first = look(at)
        _require_samples(first.tick, first.numbers[:, 1], cut, len(at), where)  # an observer may leave some out
        _require_start(first, where)
        if left := int(brought.sum() - first.numbers[:, 1].sum()):
            a.said.append(
                f"{label} does not say what it expects of {left:,} of {int(brought.sum()):,} measured numbers, which are not "
                "in its likelihood."
            )
        tune.descend("descent", trials, at, lambda point: _value(look(point), cut), budget, where, progress)
        fitted, end = np.array(trials.best.at), a.last + 1
        refit = History(target, f"{about}, fitted to the whole log", names, basis_of(study, a.cell), REFIT)
        progress.begin("points", budget)
        tune.descend("descent", refit, fitted, lambda point: _value(look(point), end), budget, where, progress)
        return finish(
            Outcome(
                where=where,
                label=label,
                study=study,
                said=a.said,
                free=every,
                start=at,
                fitted=fitted,
                best=np.array(refit.best.at),
                arrived=not any(refit.best.slope),
                points=[*trials.points, *refit.points],
                look=look,
                cut=cut,
            ),
            target,
            about,
        )


def _value(found: Found, cut: int) -> tuple[float, Vector]:
    """Minus the mean log-likelihood of a number before a tick, and its slope, 0 where it is flat."""
    early = found.tick < cut
    degrees = found.numbers[early, 1].sum()
    slope = -found.score[early].sum(0) / degrees
    flat = float(np.abs(slope).max()) < FLAT
    return -float(found.each[early].sum() / degrees), np.zeros_like(slope) if flat else slope


def _require(entry: ObserverSpec, budget: int, where: str) -> None:
    """Raise UserError where an observer has no likelihood, or none with a slope."""
    if budget < 1:
        raise UserError(f"{where}: --budget: got {budget}, expected 1 or more; leave it out for {tune.BUDGET}.")
    if entry.observer.innovation is None:
        raise UserError(
            f"{where}: got an observer that does not say what it expects of a sample, expected one that does, for else a log "
            "has no likelihood; tune kf, or another that `pcbench list observers` shows to know its covariance."
        )
    if not entry.smooth:
        raise UserError(
            f"{where}: got an observer whose steps cannot be differentiated, expected one that goes downhill; tune kf."
        )


def _free(entry: ObserverSpec, options: BaseModel, designed: Design, only: list[str] | None, where: str) -> list[str]:
    """The options to tune: `only`, or all intensities of noise that are not 0."""
    if only is not None:
        return only
    there = [name for name in NOISE if name in parameters.tunable(entry)]
    values = {name: getattr(options, name) for name in there}
    numbers = designed.certificate.numbers
    values = {k: numbers.get(k) if v is None or isinstance(v, str) else v for k, v in values.items()}
    found = [name for name, value in values.items() if value is not None and np.any(np.asarray(value, float) > 0)]
    if not found:
        raise parameters.NothingFree(
            f"{where}: got an observer without intensities of noise above 0, expected one; write one under [options], or name "
            "what to tune with --only."
        )
    return found


def _require_samples(tick: Any, numbers: Any, cut: int, free: int, where: str) -> None:
    """Raise UserError where too few `numbers` [N] came at ticks [N] to tune on, or to judge on."""
    early, least = tick < cut, FEWEST * free
    for part, which in (("the part that is tuned on", early), ("the part that is held out", ~early)):
        if (many := int(numbers[which].sum())) < least:
            raise UserError(
                f"{where}: got {many} measured numbers in {part}, expected {least} or more, {FEWEST} for each of {free} free "
                "parameters; take a longer log, or tune fewer with --only."
            )


def _require_start(first: Found, where: str) -> None:
    if not np.isfinite(first.each).all():
        raise tune.NoStart(
            f"{where}: its likelihood at the start is not finite, expected a start that works; write one under [options]."
        )


def _digest(record: Recorded) -> str:
    """What tells one log from another."""
    w = record.part.window
    return sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in (*w, record.part.inputs))).hexdigest()[:12]
