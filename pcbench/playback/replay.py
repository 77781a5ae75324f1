"""Replay a log: observers run on what was measured, when it arrived, and what can be known of them without or with truth."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.errors import UserError
from pcbench.planning import all_observers
from pcbench.plants import signals_of
from pcbench.playback import innovation_tests, replay_metrics, smoother, step_block, stream
from pcbench.playback.setup import Prepared, prepared
from pcbench.recordings import readers
from pcbench.recordings.events import Clocked
from pcbench.recordings.log import Log
from pcbench.recordings.survey import Survey, survey
from pcbench.recordings.ticks import better, ticks
from pcbench.recordings.windows import Room
from pcbench.runtime import config, ending
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import parse
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.load import Described
from pcbench.synthesis.certificate import power_of_2

LENGTH = 1 << 16  # ticks of a part
HORIZONS = 10  # of the plant file that a log may cover per row; a longer one has times of two clocks or units


class Replayed(NamedTuple):
    """What came of a log."""

    innovations: pd.DataFrame  # a row each observer that says what it expects of samples
    distances: pd.DataFrame  # rms of estimate less smoothed, by observer and signal; empty: no smoother
    metrics: pd.DataFrame  # by observer and signal, as a study has them; empty: no truth
    estimates: pd.DataFrame | None  # every tick; None where they stand in a folder
    summary: dict[str, Any]  # the log, the tick, how far times were rounded, and sentences
    channels: pd.DataFrame  # what innovations say of each channel, with how many samples were judged


class Asked(NamedTuple):
    """A log with what is to run on it."""

    name: str  # as it was asked for
    log: Log
    found: Survey
    cell: Cell
    clock: Clocked
    last: int  # tick
    said: list[str]


def replay(
    log: str | Path,
    plant: Described,
    observers: str | list[str],
    *,
    out: str | Path | None = None,
    delay: float | None = None,
    start: float | None = None,
    seed: int = 0,
    overrides: list[str] | None = None,
    progress: Progress = SILENT,
) -> Replayed:
    """Run observers of a plant on a log, and return what can be known of them; with `out`, a folder, estimates stand there.

    `log` is a folder or file of tables, or a TOML that says what of a bag is which channel (`pcbench.recordings`); `plant` a
    study of one scenario and one cell, whose outputs are the log's channels in their order. `delay` [s] stands for arrivals
    that the log does not have, `start` [s] is the log's time of tick 0, by default its first. `seed` is for observers that draw
    numbers. `progress` hears of ticks.
    Raises UserError, with the row, for whatever the user can mend.
    """
    names = [observers] if isinstance(observers, str) else list(observers)
    with config.float64(), ending.temporary_folder() as spare:
        a = asked(log, plant, names, delay=delay, start=start, overrides=overrides)
        a.said.extend(turned_back(a.found))
        length = min(LENGTH, max(power_of_2(a.last + 1), 2))
        room = stream.room(a.log, a.found, a.clock, length, a.last)
        if parse.ALL in names:
            a = _capable(a, room, names)
        p = prepared(a.cell, room, a.last, a.log.name)
        with replay_metrics.draft(Path(spare if out is None else out)) as draft:
            judged, score, smoothed = _run(a, p, room.slots, length, draft, seed, progress)
            return _results(a, p, judged, score, smoothed, draft, loose=out is None)


def asked(
    log: str | Path,
    plant: Described,
    observers: list[str],
    *,
    delay: float | None = None,
    start: float | None = None,
    overrides: list[str] | None = None,
) -> Asked:
    """Return a log with the cell that is to run on it, in ticks; raise UserError where they do not fit."""
    study, cell = all_observers.one_cell(plant, observers, overrides or [])
    opened = readers.opened(log, delay)
    found, s, said = survey(opened), cell.scenario, all_observers.sentences(study.excluded)
    if len(opened.channels) != len(s.sampling.delay):
        raise UserError(
            f"{opened.name}: got the channels {', '.join(opened.channels)}, expected one for each of the "
            f"{len(s.sampling.delay)} outputs of {s.name}; take another plant, or say in a TOML which are meant."
        )
    tables = list(found.tables.values())
    begin = min([found.start, *(t.low for t in tables)]) if start is None else start
    end = max([found.end, *(t.high for t in tables)])
    last, _ = ticks(np.array([end]), begin, s.dt)
    if last[0] < 1:
        raise UserError(
            f"{opened.name}: got nothing after {begin:g} s, expected samples there; give an earlier --start."
        )
    rows = found.rows + sum(t.spread.many for t in tables)
    if last[0] > HORIZONS * cell.times.ticks * rows:
        raise UserError(
            f"{opened.name}: {rows:,} rows cover {int(last[0]):,} ticks of {s.dt:g} s, from {begin:.10g} s to {end:.10g} s, "
            f"more than {HORIZONS} horizons of {s.duration:g} s per row; check the units of the times and --start, or write a "
            "longer horizon."
        )
    if opened.inputs is None:
        said.append(f"{opened.name} has no inputs: they are taken to be 0.")
    if start is not None and found.start < start:
        said.append(f"what was sampled before {start:g} s is left out.")
    return Asked(
        name=Path(log).name,
        log=opened,
        found=found,
        cell=cell,
        clock=Clocked(begin, s.dt),
        last=int(last[0]),
        said=said,
    )


def _capable(a: Asked, room: Room, names: list[str]) -> Asked:
    """Return what is to run without the observers of "all" that the log has no place for; each is a sentence."""
    excluded = {}
    for label, given in a.cell.options.items():
        try:
            if label not in map(label_of, names):
                prepared(a.cell._replace(options={label: given}), room, a.last, a.log.name)
        except UserError as error:
            excluded[label] = str(error)
    options = {label: given for label, given in a.cell.options.items() if label not in excluded}
    if not options:
        raise UserError(f"{a.log.name}: no observer can run; the first is refused: {next(iter(excluded.values()))}")
    a.said.extend(all_observers.sentences(excluded))
    return a._replace(cell=a.cell._replace(options=options))


def turned_back(found: Survey) -> list[str]:
    """Return a sentence for each channel whose stamps go back, as they do where a sample overtakes another."""
    return [
        f"row {seen.out_of_order_row} of channel {name} has a stamp that goes back, the first of {seen.out_of_order}: each "
        "counts at its stamp."
        for name, seen in found.channels.items()
        if seen.out_of_order
    ]


def rounding(a: Asked) -> dict[str, Any]:
    """Return the largest rounding of a stamp or arrival [s], and a dt [s] that makes it small, where it is not."""
    grid = a.found.grid + (a.found.start - a.clock.start)
    interval = min(s.intervals.quantiles((0.5,))[0] for s in a.found.channels.values())
    _, off = ticks(grid, 0.0, a.clock.dt)
    return {"dt": a.clock.dt, "largest_rounding": off, "better_dt": better(grid, a.clock.dt, interval)}


def _run(
    a: Asked, p: Prepared, slots: int, length: int, draft: replay_metrics.Draft, seed: int, progress: Progress
) -> tuple[innovation_tests.Judged, Any, np.ndarray | None]:
    """Run all parts of a log; write estimates, return sums of innovations, the score against truth and the smoothed states."""
    scored = a.log.truth is not None
    signals = signals_of(a.cell.scenario)
    many = len(signals) if scored else 0
    if scored and a.log.truth is not None:
        stream.require_columns(a.log.truth, [name for name, _ in signals], f"{a.log.name}: truth")
    if a.log.inputs is not None and len(a.log.inputs.names) != p.m:
        raise UserError(
            f"{a.log.name}: inputs: got the columns {', '.join(a.log.inputs.names)}, expected one for each of the plant's "
            f"{p.m} inputs, in their order; mend the table."
        )
    every = stream.begun(p.layout, p.problem, slots, scored, seed)
    tail, out_from = a.cell.times.tail, int((1 - innovation_tests.HELD_OUT) * a.last)
    able, q = [label for label, o in p.layout.observers if o.innovation], len(a.log.channels)
    judged = innovation_tests.Judged(
        {o: innovation_tests.Sums() for o in able}, {o: [innovation_tests.Sums()] * q for o in able}, np.zeros(q, int)
    )
    model = smoother.model_of(p.setting, p.problem.xhat0)
    enough = model is not None and smoother.fits(model, a.last + 1)
    y, u = (np.full((a.last + 1 if enough else 0, k), np.nan) for k in (len(a.log.channels), p.m))
    largest, largest_y = np.zeros(many), np.zeros(q)  # of the truth, by signal, and of what was measured
    schema = replay_metrics.fields({o: list(signals[:many]) for o, many in p.sizes.items()}, a.clock.start, a.clock.dt)
    parts = stream.parts(a.log, a.found, a.clock, length, a.last, slots, p.back, p.m, many)
    progress.begin("ticks", a.last + 1)
    for part, seen in stream.through(every, parts, p.back, np.array([tail, a.last])):
        here = part.first + np.arange(length)
        kept = min(length, a.last + 1 - part.first)
        found = [np.asarray(seen.estimates[label])[:kept] for label, _ in p.layout.observers]
        draft.write(replay_metrics.table(schema, here[:kept] * a.clock.dt, found))
        progress.step(kept)
        for label, numbers in seen.surprise.items():
            flat = np.asarray(numbers).reshape(-1, step_block.JUDGED + q)
            judged.add(label, flat, np.repeat(here >= out_from, slots))
        largest = np.fmax(largest, np.abs(part.truth[:kept]).max(0, initial=0.0, where=~np.isnan(part.truth[:kept])))
        value = np.where(part.window.mask, np.abs(part.window.value), 0.0)
        largest_y = np.maximum(largest_y, value.max((0, 1), initial=0.0))
        judged.arrived[:] += part.window.mask.sum((0, 1))
        if enough:
            u[part.first : part.first + kept] = part.inputs[p.back :][:kept]
            k, slot, channel = np.nonzero(part.window.mask)
            y[part.window.taken[k, slot], channel] = part.window.value[k, slot, channel]
    draft.close()
    score = stream.score(every)
    if score:
        band, noise = np.asarray(p.problem.band)[:many], np.sqrt(np.asarray(p.setting.noise_variance))
        a.said.extend(replay_metrics.rounding_warnings(score, largest, signals, [(largest, band), (largest_y, noise)]))
    return judged, score, np.asarray(smoother.compiled()(model, u, y)) if enough else None


def _results(
    a: Asked,
    p: Prepared,
    judged: innovation_tests.Judged,
    score: Any,
    smoothed: Any,
    draft: replay_metrics.Draft,
    loose: bool,
) -> Replayed:
    """Make tables of what a run left."""
    signals = signals_of(a.cell.scenario)
    innovations = pd.DataFrame(
        [{"observer": label, **innovation_tests.judgement(each)} for label, each in judged.sums.items()]
    )
    channels = judged.rows(a.log.channels)
    a.said.extend(innovation_tests.unjudged(channels))
    distances = replay_metrics.distances(draft.estimates, smoothed, list(a.cell.options), signals)
    if smoothed is None:
        a.said.append(
            "distances to a smoother are left out: it needs a linear model without unknown inputs, and memory for all ticks."
        )
    metrics = replay_metrics.metrics_table(score, signals, a.clock.dt, a.cell.times.tail) if score else pd.DataFrame()
    round_ = rounding(a)
    if round_["better_dt"] is not None:
        a.said.append(
            f"times are rounded by up to {round_['largest_rounding']:.3g} s at dt = {a.clock.dt:g} s; with dt = "
            f"{round_['better_dt']:g} s they hardly would be."
        )
    summary = {
        "log": a.name,
        "plant": a.cell.scenario.name,
        "rows": a.found.rows,
        "start": a.clock.start,
        "ticks": a.last,
        **round_,
        "certificates": {label: c.status for label, c in p.certificates.items()},
        "said": a.said,
        "innovations": innovations.to_dict("records"),
        "channels": channels,
        "distances": distances.to_dict("records"),
        "metrics": metrics.to_dict("records"),
    }
    every = [t.to_pandas() for _, t in replay_metrics.parts(draft.estimates)] if loose else []
    replay_metrics.finish(draft, summary)
    estimates = pd.concat(every, ignore_index=True) if loose else None
    return Replayed(
        innovations=innovations,
        distances=distances,
        metrics=metrics,
        estimates=estimates,
        summary=replay_metrics.plain(summary),
        channels=pd.DataFrame(channels),
    )
