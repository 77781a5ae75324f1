"""Replay a recording: run observers on its measurements at their arrival times, and evaluate them with or without truth."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.errors import UserError
from pcbench.json_values import json_values
from pcbench.planning import all_observers
from pcbench.plants import estimated_of, output_units, outputs_of_states, signals_of
from pcbench.playback import innovation_tests, replay_metrics, smoother, step_block, stream
from pcbench.playback.innovation_tests import InnovationSums, Sums
from pcbench.playback.setup import Playback, PlaybackSetup, open_playback, prepare_observers, room_of
from pcbench.playback.step_block import Score
from pcbench.recordings.log import Floats, Ints
from pcbench.recordings.survey import Survey
from pcbench.recordings.tables import Frames
from pcbench.recordings.times import better_dt, rounding
from pcbench.recordings.windows import Room
from pcbench.runtime import config, ending
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import parse
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.load import StudyLike
from pcbench.toml_text import TomlTable


class ReplayResult(NamedTuple):
    """Results of a replay."""

    innovations: pd.DataFrame  # one row per observer that reports innovations
    distances: (
        pd.DataFrame
    )  # rms of estimate minus smoothed after the transient, a row per observer and signal; or empty
    metrics: pd.DataFrame  # by observer and signal, as in a study; empty: no truth
    estimates: pd.DataFrame | None  # every tick; None if they are in a folder
    summary: dict[str, Any]  # recording, tick, rounding of times, and sentences
    channels: pd.DataFrame  # innovation tests of each channel, with the number of tested samples


class Passage(NamedTuple):
    """The raw results of a pass through a recording."""

    innovations: dict[str, InnovationSums]  # by observer that reports innovations
    n_arrived: Ints  # [q] samples
    scores: dict[str, Score]  # against truth, by observer; empty: unknown
    smoothed_states: Floats | None  # [ticks, n]
    delays: dict[str, Floats]  # [2] final delay and its standard deviation [s], by observer that estimates it


def replay(
    log: str | Path | Frames,
    plant: StudyLike,
    observers: str | list[str],
    *,
    out: str | Path | None = None,
    delay: float | None = None,
    start: float | None = None,
    seed: int = 0,
    overrides: list[str] | None = None,
    progress: Progress = SILENT,
) -> ReplayResult:
    """Run observers on a recording.

    Args:
        log: folder or file of tables, or a TOML file that maps its fields to channels (see `pcbench.recordings`);
            or a dict of pandas frames with the columns of these tables: `measurements`, and `inputs` and `truth` if known.
        plant: a study of one scenario. Its outputs are the recording's channels, in the same order.
        observers: names of observers, or "all".
        out: folder for estimates and tables. Default: none are written.
        delay: delay of every measurement [s], for a recording without arrival times.
        start: time of tick 0 in the recording [s]. Default: its first time.
        seed: index of the seed, for observers that draw random numbers.
        overrides: changes of the study as texts. If an axis has several values, such as
            "axes.assumed_delay_error=[0.1, 0.2]", the result compares their likelihoods, and has no estimates.
        progress: is called with the progress, in ticks.

    Returns:
        Estimates, innovation tests and, if the recording has the truth, metrics.

    Raises:
        UserError: a mistake in the recording, the study or an argument; the sentence names the row.
    """
    names = [observers] if isinstance(observers, str) else list(observers)
    with config.float64(), ending.temporary_folder() as spare:
        grid = all_observers.grid_of(plant, {"observers": names}, overrides or [])

        def replay_cell(folder: str | Path, cell: Cell | None) -> ReplayResult:
            playback = open_playback(log, plant, names, delay=delay, start=start, overrides=overrides, cell=cell)
            playback.remarks.extend(all_observers.sentences(grid.study.excluded if cell else None))
            playback.remarks.extend(describe_out_of_sequence(playback.survey))
            room = room_of(playback)
            if parse.ALL in names:
                playback = _without_unsupported(playback, room, names)
            setup = prepare_observers(playback, room)
            with replay_metrics.draft(Path(folder)) as draft:
                passage = _run(playback, setup, draft, seed, progress)
                return _results(playback, setup, passage, draft, in_memory=out is None)

        axes = [name for name, values in grid.study.axes.items() if len(values) > 1]
        if len(grid.cells) == 1 or len(grid.study.scenarios) > 1:
            return replay_cell(spare if out is None else out, grid.cells[0] if len(grid.cells) == 1 else None)
        results = [(cell.values, replay_cell(spare, cell)) for cell in grid.cells]
        return _likelihoods(axes, results, None if out is None else Path(out))


def _likelihoods(axes: list[str], results: list[tuple[TomlTable, ReplayResult]], out: Path | None) -> ReplayResult:
    """Return the innovation tests at each value of some axes, without estimates; also as a file in a folder."""

    def join(frames: list[pd.DataFrame]) -> pd.DataFrame:
        for (values, _), frame in zip(results, frames, strict=True):
            for i, name in enumerate(axes):
                frame.insert(i, name, values[name])
        return pd.concat(frames, ignore_index=True)

    innovations, channels = join([r.innovations for _, r in results]), join([r.channels for _, r in results])
    first = results[0][1].summary
    summary = {name: first[name] for name in ("log", "plant", "rows", "dt")} | {
        "axes": axes,
        "notes": list(dict.fromkeys(sentence for _, r in results for sentence in r.summary["notes"])),
        "innovations": innovations.to_dict("records"),
        "channels": channels.to_dict("records"),
    }
    if out is not None:
        replay_metrics.write_summary(out, summary)
    empty = pd.DataFrame()
    return ReplayResult(innovations, empty, empty, None, json_values(summary), channels)


def _without_unsupported(playback: Playback, room: Room, names: list[str]) -> Playback:
    """Return the playback without observers of "all" that the recording does not support, each with a sentence."""
    excluded = {}
    cell = playback.cell
    for label, observer_options in cell.options.items():
        try:
            if label not in map(label_of, names):
                prepare_observers(playback._replace(cell=cell._replace(options={label: observer_options})), room)
        except UserError as error:
            excluded[label] = str(error)
    options = {label: o for label, o in cell.options.items() if label not in excluded}
    if not options:
        first = next(iter(excluded.values()))
        raise UserError(f"{playback.log.name}: no observer can run; the first is refused: {first}")
    playback.remarks.extend(all_observers.sentences(excluded))
    return playback._replace(cell=cell._replace(options=options))


def describe_out_of_sequence(survey: Survey) -> list[str]:
    """Return a sentence for each channel with out-of-sequence timestamps."""
    return [
        f"row {c.out_of_order.first_mark} of channel {name} is out-of-sequence, the first of {c.out_of_order.many}: "
        "each is used at the time it was taken."
        for name, c in survey.channels.items()
        if c.out_of_order.many
    ]


def _run(
    playback: Playback, setup: PlaybackSetup, draft: replay_metrics.Draft, seed: int, progress: Progress
) -> Passage:
    """Run all parts of a recording, and write estimates."""
    log, clock, n_total = playback.log, playback.clock, playback.last_tick + 1
    signals, q = estimated_of(playback.cell.scenario), len(log.channels)
    score_signals, truth_signals = ([name for name, _ in signals], log.truth.names) if log.truth else ([], ())
    runners = stream.init_runners(setup, bool(score_signals), seed)
    held_out_start = innovation_tests.held_out_start(playback.last_tick)
    innovations = {label: InnovationSums(Sums(), [Sums()] * q) for label, o in setup.layout.observers if o.innovation}
    arrived = np.zeros(q, int)
    model = smoother.model_of(setup.context, setup.problem.xhat0)
    has_memory = model is not None and smoother.fits(model, n_total)
    y, u = (np.full((n_total if has_memory else 0, k), np.nan) for k in (q, setup.m))
    variance_ratio = np.ones(q if setup.variances is None else y.shape)  # of each sample's variance, for the smoother
    largest, largest_y = np.zeros(len(score_signals)), np.zeros(q)  # largest truth by signal, and largest measurement
    progress.begin("ticks", n_total)
    ends = np.array([playback.cell.times.tail, playback.last_tick])
    for part, outputs in stream.through(runners, stream.parts(playback, setup, score_signals), setup.back, ends):
        window, ticks = part.window, part.first + np.arange(playback.length)
        n_ticks = min(playback.length, n_total - part.first)
        estimates, sigmas = (
            {label: np.asarray(getattr(o, field))[:n_ticks] for label, o in outputs.items()}
            for field in ("estimate", "sigma")
        )
        true = {pair: x for pair, x in zip(signals, part.truth[:n_ticks].T, strict=False) if pair[0] in truth_signals}
        delays = {label: np.asarray(o.delay)[:n_ticks, 0] for label, o in outputs.items() if o.delay.shape[1]}
        draft.write(replay_metrics.estimates_table(ticks[:n_ticks], estimates, sigmas, true, delays, signals, clock))
        progress.step(n_ticks)
        stats = {label: np.asarray(outputs[label].innovation_stats) for label in innovations}
        by_channel = {label: numbers[..., step_block.N_STATS :] for label, numbers in stats.items()}
        table = replay_metrics.innovation_table(window, part.first, by_channel, log.channels, clock)
        draft.write(table, replay_metrics.INNOVATIONS)
        for label, numbers in stats.items():
            rows = numbers[..., : step_block.N_STATS + q].reshape(-1, step_block.N_STATS + q)
            innovations[label] = innovations[label].add(rows, np.repeat(ticks >= held_out_start, setup.slots))
        truth = np.abs(part.truth[:n_ticks])
        largest = np.fmax(largest, truth.max(0, initial=0.0, where=~np.isnan(truth)))
        largest_y = np.maximum(largest_y, np.where(window.mask, np.abs(window.value), 0.0).max((0, 1), initial=0.0))
        arrived += window.mask.sum((0, 1))
        if has_memory:
            u[part.first : part.first + n_ticks] = part.inputs[setup.back :][:n_ticks]
            k, slot, channel = np.nonzero(window.mask)
            y[window.sampling_ticks[k, slot], channel] = window.value[k, slot, channel]
            if window.variance_ratio is not None:
                variance_ratio[window.sampling_ticks[k, slot], channel] = window.variance_ratio[k, slot, channel]
    scores = {o.label: o.score for o in sorted(runners, key=lambda o: o.label) if o.score is not None}
    band = np.asarray(setup.problem.band)[: len(score_signals)]
    sizes = [(largest, band), (largest_y, np.sqrt(np.asarray(setup.context.noise_variance)))]
    playback.remarks.extend(replay_metrics.rounding_warnings(scores, largest, signals, sizes))
    smoothed_states = None
    if model is not None and has_memory:
        smoothed_states = np.asarray(smoother.jit_smoother()(model._replace(R=model.R * variance_ratio), u, y))
        draft.write(replay_metrics.smoothed_table(smoothed_states, signals, clock), replay_metrics.SMOOTHED)
    draft.close()
    return Passage(innovations, arrived, scores, smoothed_states, _delays(runners, ticks[-1] + 1))


def _delays(runners: list[stream.Runner], tick: int) -> dict[str, Floats]:
    """Return the estimated delay at the end with its standard deviation [s], by observer."""
    out = {}
    for o in runners:
        ((label, observer),) = o.layout.observers
        if observer.delay:
            out[label] = np.asarray(step_block.jit_delay()(o.layout, o.problem, o.state, np.asarray(tick)))
    return out


def _outputs(playback: Playback) -> list[dict[str, str]]:
    """Return the name and unit of each channel, and the state that it measures directly; empty: none."""
    scenario, log = playback.cell.scenario, playback.log
    states = {output: state for state, output in outputs_of_states(scenario).items()}
    pairs = enumerate(zip(log.channels, log.units or output_units(scenario), strict=True))
    return [{"channel": name, "unit": unit, "state": states.get(i, "")} for i, (name, unit) in pairs]


def _results(
    playback: Playback, setup: PlaybackSetup, passage: Passage, draft: replay_metrics.Draft, in_memory: bool
) -> ReplayResult:
    """Return the tables of a replay."""
    signals, dt = signals_of(playback.cell.scenario), playback.clock.dt
    innovations = pd.DataFrame(
        [{"observer": label, **innovation_tests.results_of(sums.total)} for label, sums in passage.innovations.items()]
    )
    channels = innovation_tests.by_channel(passage.innovations, playback.log.channels, passage.n_arrived)
    playback.remarks.extend(innovation_tests.describe_skipped(channels) + innovation_tests.describe_biased(channels))
    for label, (mean, std) in passage.delays.items():
        playback.remarks.append(
            f"{label}: estimated delay of {playback.log.channels[0]} {mean:.4g} s, standard deviation {std:.2g} s."
        )
    distances = replay_metrics.distances(
        draft.estimates, passage.smoothed_states, list(playback.cell.options), signals, steady=playback.cell.times.tail
    )
    if passage.smoothed_states is None:
        playback.remarks.append(
            "distances to a smoother are left out: it needs a linear model without unknown inputs, and memory for all ticks."
        )
    metrics = replay_metrics.metrics_table(passage.scores, signals, dt, playback.cell.times.tail)
    times = playback.survey.grid + (playback.survey.start - playback.clock.start)
    error = rounding(times, dt)
    shorter_dt = better_dt(times, dt, min(c.intervals.median for c in playback.survey.channels.values()))
    if shorter_dt is not None:
        playback.remarks.append(
            f"times are rounded by up to {error:.3g} s, because a tick is {dt:g} s; with a tick of {shorter_dt:g} s the error "
            "is much smaller."
        )
    summary = {
        "log": playback.name,
        "plant": playback.cell.scenario.name,
        "rows": playback.survey.rows,
        "start": playback.clock.start,
        "ticks": playback.last_tick,
        "dt": dt,
        "steady_start": playback.cell.times.tail * dt,
        "held_out_from": innovation_tests.held_out_start(playback.last_tick) * dt,
        "outputs": _outputs(playback),
        "largest_rounding": error,
        "better_dt": shorter_dt,
        "certificates": {label: c.status for label, c in setup.certificates.items()},
        "notes": playback.remarks,
        "innovations": innovations.to_dict("records"),
        "channels": channels,
        "delays": [{"observer": o, "estimate": mean, "std": std} for o, (mean, std) in passage.delays.items()],
        "distances": distances.to_dict("records"),
        "metrics": metrics.to_dict("records"),
    }
    estimates = None
    if in_memory:
        estimates = pd.concat([t.to_pandas() for _, t in replay_metrics.parts(draft.estimates)], ignore_index=True)
    draft.finish(summary)
    return ReplayResult(
        innovations=innovations,
        distances=distances,
        metrics=metrics if passage.scores else pd.DataFrame(),
        estimates=estimates,
        summary=json_values(summary),
        channels=pd.DataFrame(channels),
    )
