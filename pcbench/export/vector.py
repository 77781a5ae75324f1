"""A run to test an exported observer by: its inputs, what happens at which tick, and what the simulation made of it."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pcbench.engine import initial_state, lane_array
from pcbench.engine.common_schedule import prepare
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.planning.padding import Plan
from pcbench.simulation import measurements, trajectory
from pcbench.simulation.types import GridPointParams, Layout, present

SNAPSHOT, SAMPLED, JUMP = 0, 1, 2
Floats = NDArray[np.float64]


class Event(NamedTuple):
    """What happens at a tick, in the order in which it does; q outputs."""

    tick: int
    what: int  # SNAPSHOT, SAMPLED or JUMP
    packet: int  # whose snapshot is written or read
    value: Floats  # [q] 0 where not in mask
    mask: NDArray[np.bool_]  # [q] that arrive, or are sampled
    age: NDArray[np.int64]  # [q]
    index: NDArray[np.int64]  # type: ignore[assignment]  # [q]
    ticks_since_arrival: int


class Vector(NamedTuple):
    """One run over ticks 0 .. N."""

    xhat0: Floats  # [n]
    before: Floats  # [P, m] inputs from before tick 0, the newest first
    inputs: Floats  # [N+1, m]
    events: list[Event]
    truth: Floats  # [N+1, s] NaN where it is unknown
    expected: Floats  # [N+1, s] what the simulation, or the replay of a recording, estimates
    of: str = "a simulation"


def vector(p: Plan, root_seed: int, seed: int, rows: int) -> Vector:
    """Return a run of a plan of one observer, on a schedule of that run (`planning.alone`), with `rows` inputs from before."""
    (name, _), root, index = p.layout.observers[0], np.asarray(root_seed), np.asarray(seed)
    out = jax.tree.map(np.asarray, trajectory.compiled()(p.layout, p.problem, root, index))
    ask = jax.jit(beginning, static_argnums=(0, 1))
    xhat0, before = ask(p.layout._replace(width=1), rows, p.problem, root, index[None])
    schedule, n = p.problem.schedule, p.problem.x0.shape[0]
    many = 1 + max(int(schedule.sample.max(initial=0)), int(schedule.early.max(initial=0)))
    seen = measurements.compiled()(p.layout, many, p.problem, root, index[None], out.x[:, :n, None])
    values = packets(schedule, *(np.asarray(each)[..., 0] for each in seen))
    events = happening(schedule, values, p.layout.observers[0][1].on_sample is not None)
    expected = out.estimates[name]
    truth = out.x[:, : expected.shape[1]]
    return Vector(np.asarray(xhat0), np.asarray(before), out.u, events, truth, expected)


def beginning(layout: Layout, rows: int, p: GridPointParams, root_seed: Any, seeds: Any) -> tuple[Any, Any]:
    """Return xhat(0) of a run, and the inputs applied before tick 0, the newest first."""
    _, state = prepare(layout, p, root_seed, seeds)

    def one(commands: Any) -> Any:
        return jax.vmap(present(p, jnp.asarray(0), False, commands).past_u)(jnp.arange(1, rows + 1))

    past = vmap_entrywise(one)(state.commands)
    first = initial_state.first_estimate(layout, p, root_seed, seeds)
    return lane_array.to_array(first, 1)[..., 0], lane_array.to_array(past, 1)[..., 0]


def packets(schedule: Any, clean: Floats, noise: Floats) -> Floats:
    """Return what each packet holds of a run: [packets, q]; `clean` [N+1, q] without noise, `noise` [I, q] by sample."""
    early, q = len(schedule.early), clean.shape[1]
    out = np.zeros((early + int((schedule.sense >= 0).sum()) + 1, q))
    for number, samples in enumerate(schedule.early):
        out[number] = clean[0] + np.where(samples >= 0, noise[np.maximum(samples, 0), np.arange(q)], 0)
    for tick in np.flatnonzero(schedule.sense >= 0):
        samples = schedule.sample[tick]
        out[schedule.sense[tick]] = clean[tick] + np.where(samples >= 0, noise[np.maximum(samples, 0), np.arange(q)], 0)
    return out


def happening(schedule: Any, values: Floats, tells: bool) -> list[Event]:
    """Return the events of a schedule in the order of a tick: snapshots, what is sampled, what arrives."""
    q = values.shape[1]
    none = np.zeros(q, int)
    nothing = Event(
        tick=-1,
        what=SNAPSHOT,
        packet=-1,
        value=np.zeros(q),
        mask=np.zeros(q, bool),
        age=none,
        index=none,
        ticks_since_arrival=0,
    )
    out = [nothing._replace(packet=i) for i in range(len(schedule.early))]
    for k in map(int, np.flatnonzero(schedule.event)):
        if schedule.snapshot[k] >= 0:
            out.append(nothing._replace(tick=k, packet=int(schedule.snapshot[k])))
        if tells and schedule.sense[k] >= 0:
            out.append(nothing._replace(tick=k, what=SAMPLED, mask=schedule.sample[k] >= 0))
        for slot in np.flatnonzero(schedule.arrive[k] >= 0):
            packet, mask = int(schedule.arrive[k, slot]), schedule.mask[k, slot]
            arrived = Event(
                tick=k,
                what=JUMP,
                packet=packet,
                value=np.where(mask, values[packet], 0.0),
                mask=mask,
                age=np.full(q, k - schedule.believed[k, slot]),
                index=schedule.number[k, slot].astype(int),
                ticks_since_arrival=int(schedule.ticks_since_arrival[k, slot]),
            )
            out.append(arrived)
    return out
