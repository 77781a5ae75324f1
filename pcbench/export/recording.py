"""A recording as the test run of an exported observer, whose buffers have the size that the recording needs."""

import numpy as np

from pcbench.errors import UserError
from pcbench.export.structs import RecordedRun, events_of
from pcbench.plants import estimated_of
from pcbench.playback import stream
from pcbench.playback.setup import Playback, PlaybackSetup, prepare_observers, room_of

LONGEST = 300_000  # ticks, which become lines of C


def prepare_recording(playback: Playback, notifies: bool) -> tuple[PlaybackSetup, RecordedRun]:
    """Return an observer prepared for a recording, and the recording as a run, without the expected estimates.

    Raises UserError if the recording is too long for a table in C.
    """
    if playback.last_tick >= LONGEST:
        raise UserError(
            f"{playback.name}: got {playback.last_tick + 1:,} ticks, expected at most {LONGEST:,}, as each is a "
            "line of the C that tests the observer; use a part of the recording that has its longest delays."
        )
    if with_std := playback.survey.with_std():
        raise UserError(
            f"{playback.name}: got the noise of each measurement of {', '.join(with_std)}, expected a recording without: "
            "the C has one variance for each channel; leave std and variance out of the recording."
        )
    setup = prepare_observers(playback, room_of(playback))
    parts = [*stream.parts(playback, setup, [name for name, _ in estimated_of(playback.cell.scenario)])]
    inputs = np.concatenate([part.inputs[setup.back :] for part in parts])[: playback.last_tick + 1]
    truth = np.concatenate([part.truth for part in parts])[: playback.last_tick + 1]
    events = [event for part in parts for event in events_of(part.window, notifies, part.first)]
    return setup, RecordedRun(setup.problem.xhat0, np.zeros((0, setup.m)), inputs, events, truth, truth)
