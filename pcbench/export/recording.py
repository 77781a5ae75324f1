"""A recording as a run to test an exported observer by, with observers that have room for all of it."""

import numpy as np

from pcbench.errors import UserError
from pcbench.export.structs import JUMP, SAMPLED, SNAPSHOT, Event, Vector
from pcbench.plants import signals_of
from pcbench.playback import stream
from pcbench.playback.setup import Playback, Prepared, prepared, room_of
from pcbench.recordings.windows import Window

LONGEST = 300_000  # ticks, which become lines of C


def recorded(a: Playback, tells: bool) -> tuple[Prepared, Vector]:
    """Return an observer prepared for a recording, and the recording as a run, still without what is expected of it.

    Raises UserError for a recording that is too long to become a table in C.
    """
    if a.last >= LONGEST:
        raise UserError(
            f"{a.name}: got {a.last + 1:,} ticks, expected at most {LONGEST:,}, as each is a line of the C that tests the "
            "observer; take a part of the recording that has its longest delays."
        )
    p = prepared(a, room_of(a))
    parts = [*stream.parts(a, p, [name for name, _ in signals_of(a.cell.scenario)])]
    inputs = np.concatenate([part.inputs[p.back :] for part in parts])[: a.last + 1]
    truth = np.concatenate([part.truth for part in parts])[: a.last + 1]
    events = [event for part in parts for event in happening(part.first, part.window, tells)]
    return p, Vector(p.problem.xhat0, np.zeros((0, p.m)), inputs, events, truth, truth)


def happening(first: int, w: Window, tells: bool) -> list[Event]:
    """Return the events of a part that begins at tick `first`, in the order of a tick."""
    out, q = [], w.mask.shape[2]
    none = np.zeros(q, int)
    for k in map(int, np.flatnonzero(w.event)):
        quiet = Event(
            tick=first + k,
            what=SNAPSHOT,
            packet=int(w.sense[k]),
            value=np.zeros(q),
            mask=np.zeros(q, bool),
            age=none,
            index=none,
            ticks_since_arrival=0,
        )
        if w.sense[k] >= 0:
            out.append(quiet)
        if tells and w.sense[k] >= 0:
            out.append(quiet._replace(what=SAMPLED, mask=w.sampled[k]))
        for slot in map(int, np.flatnonzero(w.arrive[k] >= 0)):
            arrived = quiet._replace(
                what=JUMP,
                packet=int(w.arrive[k, slot]),
                value=w.value[k, slot],
                mask=w.mask[k, slot],
                age=np.full(q, first + k - int(w.taken[k, slot])),
                index=w.number[k, slot].astype(int),
                ticks_since_arrival=int(w.ticks_since_arrival[k, slot]),
            )
            out.append(arrived)
    return out
