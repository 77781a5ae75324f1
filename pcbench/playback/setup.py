"""Set up a replay: the recording in ticks, the observers with their gains, and room for the recording's delays.

Designs use the study's own period, delay, noise and duration, which are the assumptions. Only the room follows from the
recording: the number of out-of-sequence samples, of packets in flight, and their ages. So on the recording of a simulated run,
gains are those of that run.
"""

from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcbench import planning
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.planning import all_observers
from pcbench.plants import estimated_of, output_units
from pcbench.playback.step_block import PLANT
from pcbench.recordings import readers
from pcbench.recordings.log import Floats, Log, shift_stamps
from pcbench.recordings.survey import Survey, describe_held, limit_truth, require_units, survey
from pcbench.recordings.tables import Frames
from pcbench.recordings.times import Clock
from pcbench.recordings.windows import Room, blocks, with_block
from pcbench.simulation import shape_checks
from pcbench.simulation.types import GridPointParams, InputWindow, Layout
from pcbench.study.grid import Cell
from pcbench.study.load import StudyLike
from pcbench.synthesis.certificate import Certificate, Design, DesignContext, power_of_2

LENGTH = 1 << 16  # ticks of a block, at most
HORIZONS = 10  # largest number of durations of the plant file per row; a longer recording mixes clocks or units


class Playback(NamedTuple):
    """A recording with the grid point that runs on it."""

    name: str  # as given by the user
    log: Log
    survey: Survey
    cell: Cell
    clock: Clock
    last_tick: int  # of the recording; the first is 0
    remarks: list[str]  # sentences
    length: int  # ticks of a block


class PlaybackSetup(NamedTuple):
    """Observers ready to run; m inputs."""

    layout: Layout
    problem: GridPointParams
    context: DesignContext
    certificates: dict[str, Certificate]
    slots: int  # packets that may arrive at one tick
    back: int  # ticks of past inputs that observers may read
    m: int
    variances: Floats | None  # [q] assumed noise variance, if the recording states that of each sample; else None


def open_playback(
    log: str | Path | Frames,
    plant: StudyLike,
    observers: list[str],
    *,
    delay: float | None = None,
    start: float | None = None,
    overrides: list[str] | None = None,
    clock_offsets: Floats | None = None,
    cell: Cell | None = None,
) -> Playback:
    """Return a recording with the grid point that runs on it, in ticks; raise UserError if they do not fit.

    `clock_offsets` [q] s are added to the timestamps of the channels, less the `assumed_delay_error` of the plant file. `cell`
    selects one of several grid points of the plant file.
    """
    excluded = None
    if cell is None:
        study, cell = all_observers.one_cell(plant, observers, overrides or [])
        excluded = study.excluded
    recording, s = readers.open_log(log, delay), cell.scenario
    if isfinite(speed := s.sampling.processor_speed):
        raise UserError(
            f"{recording.name}: got processor_speed = {speed:g} in {s.name}, expected inf: a recording contains its "
            "arrival times; leave it out."
        )
    offsets = np.zeros(len(recording.channels)) if clock_offsets is None else clock_offsets
    recording = shift_stamps(recording, offsets - s.belief.assumed_delay_error)
    stats, remarks = survey(recording), all_observers.sentences(excluded)
    if len(recording.channels) != len(s.sampling.delay):
        raise UserError(
            f"{recording.name}: got the channels {', '.join(recording.channels)}, expected one for each of the "
            f"{len(s.sampling.delay)} outputs of {s.name}; use another plant, or map the channels in a TOML file."
        )
    require_units(recording, output_units(s))
    recording, stats, omissions = limit_truth(recording, stats, [name for name, _ in estimated_of(s)])
    remarks += omissions
    tables = list(stats.tables.values())
    clock = Clock(min([stats.start, *(t.least for t in tables)]) if start is None else start, s.dt)
    end = max([stats.end, *(t.most for t in tables)])
    last_tick = int(clock.ticks(np.array([end]))[0])
    if last_tick < 1 and start is None:
        raise UserError(
            f"{recording.name}: got samples at {clock.start:.10g} s alone, expected two times at least; see whether "
            "rows are missing."
        )
    if last_tick < 1:
        raise UserError(
            f"{recording.name}: got nothing after {clock.start:g} s, expected samples there; give an earlier --start."
        )
    rows = stats.rows + sum(t.many for t in tables)
    if last_tick > HORIZONS * cell.times.ticks * rows:
        raise UserError(
            f"{recording.name}: {rows:,} rows cover {last_tick:,} ticks of {s.dt:g} s, from {clock.start:.10g} s to "
            f"{end:.10g} s, more than {HORIZONS} durations of {s.duration:g} s per row; check the unit of the times "
            "(time_unit) and --start, or write a longer duration."
        )
    if recording.inputs is None:
        remarks.append(f"{recording.name} has no inputs: they are taken to be 0.")
    if start is not None and stats.start < start:
        remarks.append(f"what was sampled before {start:g} s is left out.")
    remarks.extend(describe_held(stats))
    if with_std := stats.with_std():
        remarks.append(f"{', '.join(with_std)}: each measurement has the variance that {recording.name} states for it.")
    length = min(LENGTH, max(power_of_2(last_tick + 1), 2))
    name = Path(log).name if isinstance(log, str | Path) else recording.name
    return Playback(name, recording, stats, cell, clock, last_tick=last_tick, remarks=remarks, length=length)


def room_of(playback: Playback) -> Room:
    """Return the room that a recording needs, from one pass over it."""
    latest = (
        int(np.ceil(max((c.delays.most for c in playback.survey.channels.values()), default=0.0) / playback.clock.dt))
        + 1
    )
    room = Room()
    for block in blocks(playback.log, playback.survey, playback.clock, playback.length, playback.last_tick):
        room = with_block(room, block, max(latest, 0))
    return room


def prepare_observers(playback: Playback, room: Room) -> PlaybackSetup:
    """Return the designed observers for a recording; raise UserError if it does not fit the plant or the duration."""
    s, cell, where = playback.cell.scenario, playback.cell, f"{playback.log.name} on {playback.cell.scenario.name}"
    _require_fit(playback, room, where)
    context = planning.context_of(cell)
    m, signals = context.model.B.shape[1], len(estimated_of(s))
    if playback.log.inputs is not None and len(playback.log.inputs.names) != m:
        raise UserError(
            f"{playback.log.name}: inputs: got the columns {', '.join(playback.log.inputs.names)}, expected one "
            f"for each of the plant's {m} inputs, in their order; correct the table."
        )
    context = context._replace(
        random_schedule=False,  # a recording has one
        oosm_lag=max(context.oosm_lag, room.oosm_lag),
        flight=max(context.flight, room.flight),
        latest=max(context.latest, room.latest),
        reach=max(context.reach, *(-(-room.latest // max(period, 1)) for period in context.period)),
    )
    designs = {o: planning.run_design(o, cell.entry(o), context, options) for o, options in cell.options.items()}
    if with_std := playback.survey.with_std():
        _require_noise_per_sample(cell, designs, with_std, where)
    back = min(playback.last_tick + 1, power_of_2(room.latest + (2 * room.oosm_lag + 2) * max(room.longest_gap, 1)))
    starts_at_truth = cell.choices.random_initial_state and s.belief.initial_box
    problem = GridPointParams(
        params=np.zeros(len(s.sampling.delay)),
        gains={o: d.gains for o, d in designs.items()},
        schedule=(),
        inputs=InputWindow(np.zeros((back + 1, m)), np.asarray(-back)),
        dt=np.asarray(s.dt),
        x0=np.zeros(signals),
        xhat0=np.array(s.truth.x0 if starts_at_truth else s.belief.xhat0),
        spread0=np.diag(s.belief.prior_std),
        noise_std=np.array(s.sampling.noise_std),
        band=np.array(s.scoring.settle_band),
        bound=np.broadcast_to(np.asarray(s.scoring.divergence_threshold, float), signals),
        windows=np.zeros((0, 2), int),
    )
    layout = Layout(
        plant=PLANT,
        observers=tuple((o, cell.entry(o).observer) for o in cell.options),
        width=1,
        ring=power_of_2(max(room.flight, 1)),
        random_initial_state=False,
        watch=False,
    )
    for label, observer in layout.observers:
        shape_checks.check(label, observer, problem._replace(x0=problem.xhat0))
    return PlaybackSetup(
        layout=layout,
        problem=problem,
        context=context,
        certificates={o: d.certificate for o, d in designs.items()},
        slots=room.slots,
        back=back,
        m=m,
        variances=context.noise_variance if with_std else None,
    )


def _require_fit(playback: Playback, room: Room, where: str) -> None:
    """Raise UserError for a scenario or an observer that is not for recordings, or for gaps longer than the duration."""
    s, cell = playback.cell.scenario, playback.cell
    if s.sampling.continuous:
        raise UserError(
            f"{where}: got a scenario that measures continuously, expected one that samples; use another plant file."
        )
    if room.longest_gap + room.latest > cell.times.ticks:
        raise UserError(
            f"{where}: got {room.longest_gap * s.dt:g} s without a sample before row {room.longest_gap_row} and delays of up "
            f"to {room.latest * s.dt:g} s, expected less than the duration of {s.duration:g} s in all; check the unit "
            "of the times (time_unit), cut the log there, or write a longer duration."
        )
    for label in cell.options:
        if cell.entry(label).observer.uses_silence and any(s.sampling.send_threshold):
            raise UserError(
                f"{where}: got {label} and a send_threshold, expected an observer that uses measurements alone: a recording "
                "contains no samples that were not sent; use kf."
            )


def _require_noise_per_sample(cell: Cell, designs: dict[str, Design], with_std: list[str], where: str) -> None:
    """Raise UserError for an observer that does not use the noise that a recording states for each measurement."""
    for label, design in designs.items():
        if not cell.entry(label).measurement_noise:
            supported = ", ".join(name for name, entry in OBSERVERS.items() if entry.measurement_noise)
            raise UserError(
                f"{where}: got the noise of each measurement of {', '.join(with_std)} and {label}, expected an observer "
                f"that uses it: {supported}; use one of these, or leave std and variance out of the recording."
            )
        if getattr(design.gains, "decorrelation", None) is not None:
            raise UserError(
                f"{where}: got the noise of each measurement of {', '.join(with_std)}, and noise that {label} assumes to "
                "be correlated between outputs, expected one of them; leave one out."
            )
