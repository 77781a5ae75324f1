"""Maximum-likelihood noise intensities: fitted to the first part of a recording, tested on the rest, fitted to the whole.

Parameters, descent, history and refusals are those of `gains.tune`. The objective is minus the mean log-likelihood per number.
The held-out part is that of a replay (`innovation_tests.HELD_OUT` of the ticks). The fit to the whole recording starts from the
first one and is the result, as a rare channel needs all samples. The held-out gain is that of the first fit.
"""

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
from pcbench.gains.history import REFIT, TUNED, Evaluation, History, basis_of
from pcbench.gains.parameters import Vector
from pcbench.gains.validation import MAX_WORSE
from pcbench.json_values import json_values
from pcbench.observers import ObserverSpec
from pcbench.playback import delay_profile, delay_search, innovation_tests, likelihood
from pcbench.playback.delay_search import ChannelDelay
from pcbench.playback.likelihood import SampleLikelihood
from pcbench.playback.setup import Playback, PlaybackSetup, open_playback
from pcbench.playback.stream import Part
from pcbench.recordings.corrections import toml_with_offsets
from pcbench.recordings.log import Floats, Ints
from pcbench.runtime import config, ending
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import Study, parse
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.load import StudyLike
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import Design, DesignContext

UNLIKELY = 0.05  # p-value of whiteness below which intervals are reported as too short
CORRECTED = "recording.toml"  # the recording with corrected timestamps
NOISE = ("R", "q", "Q")  # options of an observer that are noise intensities
MIN_NUMBERS = 10  # measured numbers per free parameter, in either part
DIFF_STEP, SLOPE_TOL = 1e-4, 0.02  # step of differences in a parameter; relative deviation of a slope from them
FLAT = 1e-6  # slope of the mean log-likelihood per number at which a descent has converged


class Intensity(NamedTuple):
    """One tuned number."""

    name: str  # of the option, with its index: R[0], Q[1]
    start: float
    value: float  # from the whole recording
    low: float  # 95 % interval; NaN: undetermined; 0: `high` is a one-sided limit
    high: float


class LogTuning(NamedTuple):
    """Results of tuning on a recording."""

    study: dict[str, Any]  # plant and observer with the chosen options: the content of tuned.toml
    start: dict[str, float | list[float]]
    best: dict[str, float | list[float]]
    kept_start: str  # reason why the start was kept; empty: the tuned options are chosen
    intensities: list[Intensity]
    # for start and tuned (to the first part): results of `innovation_tests` for the held-out part
    held_out: dict[str, dict[str, float | str]]
    gain: float  # in log-likelihood per held-out number, tuned to the first part minus start
    gain_se: float  # and its standard error over samples
    points: list[Evaluation]  # of the fit to the first part, then of that to the whole recording
    notes: list[str]
    log_likelihood: float  # mean per number of the recording, as in a replay with the chosen delays and noise
    delays: list[ChannelDelay]  # empty: not estimated


def tune_log(
    log: str | Path,
    plant: StudyLike,
    observer: str,
    *,
    budget: int = tune.BUDGET,
    only: list[str] | None = None,
    delay: float | None = None,
    start: float | None = None,
    find_delay: bool = False,
    max_delay: float | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    progress: Progress = SILENT,
) -> LogTuning:
    """Estimate an observer's noise intensities (`only` some options) from a recording.

    A fit to the first part is tested on the rest. `log`, `plant`, `delay` and `start` are as in `replay`. Each of the two fits
    replays the recording at most `budget` times. With `find_delay` the delay of each channel is estimated first, with its most
    likely noise, up to `max_delay` [s] (default: ten sampling intervals), and timestamps are corrected. The folder `out`
    contains the histories, tuned.toml, which `replay` and `run` accept, and recording.toml, the recording with corrected
    timestamps. Raises UserError if the user has to act.
    """
    if max_delay is not None and not find_delay:
        raise UserError("--max-delay has no effect without --find-delay; leave it out, or add --find-delay.")
    label = label_of(observer)
    with config.float64(), ending.temporary_folder() as spare:
        study, _ = parse.one_cell(plant, [observer], overrides or [])
        playback = open_playback(log, plant, [observer], delay=delay, start=start, overrides=overrides)
        where = f"tune {label} on {playback.name}"
        _require(playback.cell.entry(label), budget, where)
        delays: list[ChannelDelay] = []
        if find_delay:
            delays, delay_remarks = _find_delays(playback, only, max_delay, where, progress)
            offsets = -np.array([d.estimate for d in delays])
            playback = open_playback(
                log, plant, [observer], delay=delay, start=start, overrides=overrides, clock_offsets=offsets
            )
            playback.remarks.extend(delay_remarks)
        target = storage.target(str(out) if out is not None else spare)
        tuned = _fit(study, playback, label, only, budget, target, where, progress)
        if delays and out is not None:
            stamp_offsets = {d.channel: -d.estimate for d in delays}
            storage.write_file(
                target, CORRECTED, toml_with_offsets(Path(log), stamp_offsets, delay, Path(out)).encode()
            )
        return tuned._replace(delays=delays)


def _fit(
    study: Study,
    playback: Playback,
    label: str,
    only: list[str] | None,
    budget: int,
    target: storage.Target,
    where: str,
    progress: Progress,
) -> LogTuning:
    """Return the result of both fits, and write it with their histories to `target`."""
    setup, part = likelihood.load_recording(playback)
    free, at_start = _free_intensities(label, playback.cell, setup.context, only, where)
    if any(f.kind == "covariance" for f in free):
        raise UserError(
            f"{where}: got a covariance in full to tune, expected one number for each output or state; write its diagonal."
        )
    held_out_start, arrivals = innovation_tests.held_out_start(playback.last_tick), part.window.mask.sum((1, 2))
    _require_samples(part.first + np.arange(len(arrivals)), arrivals, held_out_start, len(at_start), where)
    entries, basis = parameters.entries(free), basis_of(study, playback.cell)
    description = f"{where}: {', '.join(entries)} of {_digest_of(part)}, for {digest(study, [playback.cell])[:12]}"
    trials = History(target, description, entries, basis)
    progress.begin("points", budget)
    progress.note("compiling")
    evaluate = likelihood.evaluator(setup, part, tune.gains_at(label, playback.cell, setup.context, free))
    before = evaluate(at_start)
    # an observer may skip some
    _require_samples(before.tick, before.stats[:, 1], held_out_start, len(at_start), where)
    _require_start(evaluate, at_start, before, playback.cell.entry(label), where)
    n_numbers = float(before.stats[:, 1].sum())
    if n_skipped := int(arrivals.sum() - n_numbers):
        playback.remarks.append(
            f"{label} reports no innovation for {n_skipped:,} of {int(arrivals.sum()):,} measured numbers, so they are not "
            "in its likelihood."
        )

    def fit(history: History, at: Vector, end: int) -> Vector:
        tune.descend("descent", history, at, lambda point: _value(evaluate(point), end), budget, where, progress)
        return np.array(history.best.parameters)

    def total(at: Vector) -> tuple[float, Vector]:
        samples = evaluate(at)
        return float(samples.log_likelihood.sum()), np.asarray(samples.score.sum(0))

    after = evaluate(first_fit := fit(trials, at_start, held_out_start))
    refit = History(target, f"{description}, fitted to the whole log", entries, basis, REFIT)
    progress.begin("points", budget)
    best = fit(refit, first_fit, playback.last_tick + 1)
    is_held_out, is_converged = before.tick >= held_out_start, not any(refit.best.slope)
    gain, se = _held_out_gain(before, after, is_held_out)
    reason = (
        "" if gain >= -MAX_WORSE * se else f"held-out log-likelihood falls by {-gain:.3g} (standard error {se:.2g})"
    )
    low, high = innovation_tests.intervals(total, best) if is_converged else (np.full(len(best), np.nan),) * 2
    intensities = _intensities(free, at_start, best, low, high)
    held_out = {
        what: _results_of(samples.stats[is_held_out]) for what, samples in (("start", before), ("tuned", after))
    }
    best_options = parameters.to_options(free, best)
    tuned = LogTuning(
        study=tune.with_options(study, label, {} if reason else best_options),
        start=parameters.to_options(free, at_start),
        best=best_options,
        kept_start=reason,
        intensities=intensities,
        held_out=held_out,
        gain=gain,
        gain_se=se,
        points=[*trials.points, *refit.points],
        notes=[
            *playback.remarks,
            *_factors(playback, setup, best_options),
            *_remarks(is_converged, intensities, held_out["tuned"]["ljung_box_p"]),
        ],
        log_likelihood=total(at_start if reason else best)[0] / n_numbers,
        delays=[],
    )
    _write(tuned, target, description)
    return tuned


def _digest_of(part: Part) -> str:
    """Return a digest of samples and inputs."""
    samples_hash = sha256()
    for array in (*part.window, part.inputs):
        samples_hash.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return samples_hash.hexdigest()[:12]


def _held_out_gain(before: SampleLikelihood, after: SampleLikelihood, is_held_out: np.ndarray) -> tuple[float, float]:
    """Return the gain in log-likelihood per held-out number, and its standard error."""
    diff = after.log_likelihood[is_held_out] - before.log_likelihood[is_held_out]
    n_numbers = float(before.stats[is_held_out, 1].sum())
    return float(diff.sum() / n_numbers), float(np.std(diff, ddof=1) * np.sqrt(len(diff)) / n_numbers)


def _find_delays(
    playback: Playback, only: list[str] | None, longest: float | None, where: str, progress: Progress
) -> tuple[list[ChannelDelay], list[str]]:
    """Return the delay of each channel, estimated with its most likely noise."""
    (label,) = playback.cell.options
    if not playback.cell.entry(label).knows_schedule:
        raise UserError(
            f"{where}: --find-delay: got an observer that does not use the time at which a sample was taken, expected one that "
            "does; use kf, ekf or ukf."
        )

    def gains_of(setup: PlaybackSetup) -> tuple[likelihood.AffineGains, Vector]:
        free, z = _free_intensities(label, playback.cell, setup.context, only, where)
        if (gains := likelihood.affine_gains(tune.gains_at(label, playback.cell, setup.context, free), z)) is None:
            raise UserError(
                f"{where}: --find-delay: got an observer whose gains are not affine in the free parameters, expected the noise "
                "intensities R, q and Q of a Kalman filter; choose them with --only, or use kf."
            )
        return gains, z

    low, high = delay_search.search_range(playback, longest, where)
    return delay_search.find(delay_profile.Profile(playback, low, high, gains_of, progress))


def _results_of(stats: Floats) -> dict[str, float | str]:
    """Return the innovation tests of some samples."""
    sums = innovation_tests.add(innovation_tests.Sums(), stats, np.ones(len(stats), bool))
    return innovation_tests.results_of(sums)


def _require(entry: ObserverSpec, budget: int, where: str) -> None:
    """Raise UserError if an observer has no likelihood."""
    if budget < 1:
        raise UserError(f"{where}: --budget: got {budget}, expected 1 or more; leave it out for {tune.BUDGET}.")
    if entry.observer.innovation is None:
        raise UserError(
            f"{where}: got an observer without an innovation covariance, expected one with it, because a likelihood needs it; "
            "tune kf, or another for which `pcbench list observers NAME` shows innovations."
        )
    if entry.observer.init_random is not None:
        raise UserError(
            f"{where}: got an observer that draws random numbers, expected one whose likelihood is smooth in its options; "
            "tune ekf or ukf."
        )


def _require_start(
    evaluate: likelihood.Evaluator, at: Vector, samples: SampleLikelihood, entry: ObserverSpec, where: str
) -> None:
    """Raise UserError for a likelihood that is not finite, or has no derivative, as with random or iterated steps."""
    if not np.isfinite(samples.log_likelihood).all():
        raise tune.NoStart(
            f"{where}: its likelihood at the start is not finite, expected a start that works; write one under [options]."
        )
    if entry.smooth:
        return
    ahead, back = (evaluate(at + sign * DIFF_STEP).log_likelihood.sum() for sign in (1, -1))
    by_differences, slope = (ahead - back) / (2 * DIFF_STEP), samples.score.sum()
    if not abs(by_differences - slope) <= SLOPE_TOL * (abs(slope) + np.sqrt(len(samples.log_likelihood))):
        raise UserError(
            f"{where}: got an observer whose likelihood cannot be differentiated, expected one with a gradient; tune kf, "
            "ekf or ukf."
        )


def _free_intensities(
    label: str, cell: Cell, context: DesignContext, only: list[str] | None, where: str
) -> tuple[list[parameters.Free], Vector]:
    """Return the free noise intensities (`only` some options, or all that are not 0), and their start."""
    design = planning.run_design(label, cell.entry(label), context, cell.options[label])
    names = _positive_intensities(cell.entry(label), cell.options[label], design, where) if only is None else only
    return tune.free_parameters(label, cell, context, design, names, where)


def _positive_intensities(entry: ObserverSpec, options: BaseModel, design: Design, where: str) -> list[str]:
    """Return the names of all noise intensities that are not 0."""
    names = []
    for name in NOISE:
        if name in parameters.tunable(entry):
            value = getattr(options, name)
            value = design.certificate.numbers.get(name) if value is None or isinstance(value, str) else value
            if value is not None and np.any(np.asarray(value, float) > 0):
                names.append(name)
    if not names:
        raise parameters.NothingFree(
            f"{where}: got an observer without intensities of noise above 0, expected one; write one under [options], or name "
            "what to tune with --only."
        )
    return names


def _require_samples(tick: Ints, numbers: Ints | Floats, held_out_start: int, free: int, where: str) -> None:
    """Raise UserError if there are too few `numbers` [N] at ticks [N] to tune or to test."""
    is_early, fewest = tick < held_out_start, MIN_NUMBERS * free
    for name, mask in (("the part that is tuned on", is_early), ("the part that is held out", ~is_early)):
        if (count := int(numbers[mask].sum())) < fewest:
            raise UserError(
                f"{where}: got {count} measured numbers in {name}, expected {fewest} or more, {MIN_NUMBERS} for each of {free} "
                "free parameters; use a longer log, or tune fewer with --only."
            )


def _value(samples: SampleLikelihood, end: int) -> tuple[float, Vector]:
    """Return minus the mean log-likelihood per number before a tick, and its slope, set to 0 where it is flat."""
    is_early = samples.tick < end
    dof = samples.stats[is_early, 1].sum()
    slope = -samples.score[is_early].sum(0) / dof
    flat = float(np.abs(slope).max()) < FLAT
    return -float(samples.log_likelihood[is_early].sum() / dof), np.zeros_like(slope) if flat else slope


def _intensities(
    free: list[parameters.Free], start: Vector, best: Vector, low: Vector, high: Vector
) -> list[Intensity]:
    """Return each free number with its interval, whose ends are as in `innovation_tests.intervals`."""
    unknown = np.isnan(high)
    points = (start, best, *(np.where(unknown, best, end) for end in (low, high)))
    rows = [np.concatenate([np.ravel(v) for v in parameters.to_options(free, at).values()]) for at in points]
    rows[2][unknown | np.isneginf(low)] = 0.0
    rows[2][unknown] = rows[3][unknown] = np.nan
    names = parameters.entries(free)
    return [Intensity(name, *map(float, row)) for name, *row in zip(names, *rows, strict=True)]


def _factors(playback: Playback, setup: PlaybackSetup, options: dict[str, Any]) -> list[str]:
    """Return the factor by which a tuned R scales the stated standard deviations of each channel, as a sentence."""
    if setup.variances is None or "R" not in options:
        return []
    factors = zip(playback.log.channels, np.sqrt(options["R"] / setup.variances), strict=True)
    described = ", ".join(f"{name} {factor:.4g}" for name, factor in factors if name in playback.survey.with_std())
    return [
        f"the stated standard deviations are most likely if multiplied by (root of R over noise_std^2): {described}."
    ]


def _remarks(is_converged: bool, intensities: list[Intensity], ljung_box_p: float | str) -> list[str]:
    """Return remarks on the intervals; `ljung_box_p` is that of the held-out part."""
    out = []
    if not is_converged:
        out.append("the budget ended before the likelihood was flat: no interval is given; give a larger --budget.")
    elif unknown := [i.name for i in intensities if np.isnan(i.low)]:
        out.append(
            f"{', '.join(unknown)}: the recording does not determine it, so no interval is given; tune the others with --only."
        )
    if limits := [f"{i.name} (below {i.high:.2g})" for i in intensities if i.low == 0]:
        out.append(
            f"{', '.join(limits)}: the log does not exclude 0, so this is a one-sided 95 % limit (profile likelihood)."
        )
    if floor := [i.name for i in intensities if i.name.startswith("R") and i.value <= 2 * parameters.MIN_POSITIVE]:
        out.append(
            f"{', '.join(floor)}: at the least value that is possible, {parameters.MIN_POSITIVE:g}: the channel never changes, "
            "or the process noise explains all of it; this is no estimate of its noise."
        )
    if float(ljung_box_p) < UNLIKELY:
        out.append(
            f"innovations of the held-out part are not white (p = {ljung_box_p:.2g}): the model or a delay is wrong, "
            "and intervals are too short; --find-delay looks for a delay."
        )
    return out


def _write(tuned: LogTuning, target: storage.Target, description: str) -> None:
    """Write a study that can be run, and the record of the tuning under [resolved.tuning]."""
    summary: dict[str, object] = {
        "about": description,
        "start": tuned.start,
        "best": tuned.best,
        "kept_start": tuned.kept_start,
    }
    summary |= {"method": "likelihood", "intensities": [i._asdict() for i in tuned.intensities]}
    summary |= {"gain": tuned.gain, "gain_se": tuned.gain_se, "held_out": tuned.held_out}
    record = json_values(summary, nulls=False)  # TOML has no null: unknown values are left out
    storage.write_file(target, TUNED, tomli_w.dumps(tuned.study | {"resolved": {"tuning": record}}).encode())
