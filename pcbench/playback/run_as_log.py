"""A simulated run as a recording, in the tables that `recordings.tables` reads."""

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from pcbench.errors import UserError
from pcbench.recordings.log import Batch
from pcbench.recordings.tables import as_tables
from pcbench.simulation.schedule.common_times import Sample, Schedule

if TYPE_CHECKING:
    from pcbench.simulation.trajectory import Recording


def tables_of(
    samples: list[Sample], schedule: Schedule, recording: "Recording", dt: float, signals: list[str]
) -> dict[str, pa.Table]:
    """Return the tables of a run by name.

    The times of `samples` are their timestamps. The error of the assumed delay (`assumed_delay_error`) is not part of a
    recording: `replay` takes it from the plant file. A sample that is lost, not sent or in transit at the end never arrives.
    Raises UserError if sampling began before tick 0, as a recording cannot contain these samples.
    """
    if len(schedule.early):
        raise UserError(
            "--log: got a scenario that measured before t = 0, expected one that begins there; use another."
        )
    last = len(recording.x) - 1
    by_time = sorted((s for s in samples if s.tick <= last), key=lambda s: (s.tick, s.channel))
    k, slot, channel = np.nonzero(schedule.mask)
    numbers = schedule.number[k, slot, channel].tolist()
    value = dict(zip(zip(channel.tolist(), numbers, strict=True), recording.arrivals[k, slot, channel], strict=True))
    values = np.array([value.get((s.channel, s.number), np.nan) for s in by_time])
    arrived = np.array([s.arrives * dt if s.arrives <= last else np.nan for s in by_time])
    batch = Batch(
        channel=np.array([s.channel for s in by_time], int),
        sampled=np.array([s.assumed_tick(0) * dt for s in by_time]),
        arrived=np.where(np.isnan(values), np.nan, arrived),  # a sensor may not have sent it
        value=values,
        row=np.arange(1, len(by_time) + 1),
    )
    t = np.arange(float(last + 1)) * dt
    channels = [f"y{i + 1}" for i in range(schedule.mask.shape[2])]
    return as_tables(batch, channels, (t, np.asarray(recording.u)), (signals, t, np.asarray(recording.x)))
