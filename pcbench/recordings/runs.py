"""A simulated run as a log: what its samples brought and when, the input held over every tick, and the true state."""

from typing import Any

import numpy as np
import pyarrow as pa

from pcbench.errors import UserError
from pcbench.recordings import writers
from pcbench.recordings.log import Batch


def tables_of(
    samples: list[Any], schedule: Any, recording: Any, dt: float, signals: list[str], error: int = 0
) -> dict[str, pa.Table]:
    """Return the tables of a run by name.

    `samples` are (channel, number, taken, arrives [ticks]), with the schedule and the recording they are from. Their times are
    the stamps that observers get, which assume a delay that is `error` ticks too long (`Sample.stamp`). One that was lost,
    or is on its way when the run ends, never arrives. Raises UserError where measuring began before
    tick 0: such samples have measured nothing that a log holds.
    """
    if len(schedule.early):
        raise UserError(
            "--log: got a scenario that measured before t = 0, expected one that begins there; take another."
        )
    last = len(recording.x) - 1
    every = sorted((s for s in samples if s.taken <= last), key=lambda s: (s.taken, s.channel))
    k, slot, channel = np.nonzero(schedule.mask)
    brought = recording.brought[k, slot, channel]
    value = dict(
        zip(zip(channel.tolist(), schedule.number[k, slot, channel].tolist(), strict=True), brought, strict=True)
    )
    batch = Batch(
        channel=np.array([s.channel for s in every], int),
        sampled=np.array([s.stamp(error) * dt for s in every]),
        arrived=np.array([s.arrives * dt if s.arrives <= last else np.nan for s in every]),
        value=np.array([value.get((s.channel, s.number), np.nan) for s in every]),
        row=np.arange(1, len(every) + 1),
    )
    t = np.arange(last + 1) * dt
    channels = [f"y{i + 1}" for i in range(schedule.mask.shape[2])]
    return writers.as_tables(batch, channels, (t, recording.u), (signals, t, recording.x))
