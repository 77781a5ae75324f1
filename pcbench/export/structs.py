"""Pytrees as C structs: one field per array, named by its path, in row-major order.

Also the test run of an exported observer: its inputs, the events of each tick, and the estimates of the simulation.
"""

import keyword
import re
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import NDArray

from pcbench.engine import initial_state, lane_array
from pcbench.engine.common_schedule import prepare
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.export.terms import Entries, Term, array_entries, as_c, kind_of, number_entries, scalar
from pcbench.planning.padding import Plan
from pcbench.recordings.windows import Window
from pcbench.simulation import trajectory
from pcbench.simulation.types import GridPointParams, Layout, present

RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if int long register return
    short signed sizeof static struct switch union unsigned void volatile while real""".split()  # noqa: SIM905
)


class Field(NamedTuple):
    """One array of a struct."""

    name: str
    kind: str
    shape: tuple[int, ...]
    note: str = ""

    @property
    def size(self) -> int:
        """Number of entries; with 0 the field is left out in C."""
        return int(np.prod(self.shape))


def fields(tree: PyTree, alone: str) -> list[Field]:
    """Return the fields of a pytree of arrays, in the order of its leaves; a single array is called `alone`."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    out: list[Field] = []
    for path, leaf in leaves:
        name = "_".join(filter(None, (re.sub(r"\W", "", _word(key)) for key in path))) or alone
        name = f"{name}_" if name in RESERVED or keyword.iskeyword(name) or name[0].isdigit() else name
        while any(name == f.name for f in out):
            name += "_"
        out.append(Field(name, kind_of(leaf.dtype), tuple(leaf.shape)))
    return out


def _word(key: object) -> str:
    return str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key))))


def entries(pointer: str, struct_fields: Iterable[Field]) -> list[Entries]:
    """Return the entries of a struct's fields, read through a pointer."""
    out = []
    for f in struct_fields:
        text = f"{pointer}->{f.name}"
        out.append(array_entries(text, f.shape) if f.shape else scalar(Term(text)))
    return out


def declare_struct(name: str, struct_fields: Iterable[Field]) -> list[str]:
    """Return the lines that declare a struct; an empty one gets a dummy field, because C has none."""
    lines = ["typedef struct {"]
    for f in struct_fields:
        if f.size:
            shape = "" if len(f.shape) < 2 else f"{list(f.shape)}, row after row"
            comment = "; ".join(filter(None, (f.note, shape)))
            array = f"[{f.size}]" if f.shape else ""
            lines.append(f"    {f.kind} {f.name}{array};{f' /* {comment} */' if comment else ''}")
    if len(lines) == 1:
        lines.append("    char nothing;")
    return [*lines, f"}} {name};"]


def initialiser(struct_fields: Iterable[Field], values: Iterable[np.ndarray]) -> list[str]:
    """Return the lines of an initialiser, field by field, eight numbers per line."""
    lines = []
    for f, value in zip(struct_fields, values, strict=True):
        if not f.size:
            continue
        texts = [as_c(x) for x in number_entries(value).flat]
        rows = [", ".join(texts[i : i + 8]) for i in range(0, len(texts), 8)]
        if f.shape:
            lines += [f"    .{f.name} = {{", *(f"        {row}," for row in rows), "    },"]
        else:
            lines.append(f"    .{f.name} = {texts[0]},")
    return lines or ["    .nothing = 0,"]


SNAPSHOT, SAMPLED, JUMP = 0, 1, 2
Floats = NDArray[np.float64]


class Event(NamedTuple):
    """The events of one tick, in their order; q outputs."""

    tick: int
    what: int  # SNAPSHOT, SAMPLED or JUMP
    packet: int  # whose snapshot is written or read
    value: Floats  # [q] 0 where not in mask
    mask: NDArray[np.bool_]  # [q] that arrive, or are sampled
    age: NDArray[np.int64]  # [q]
    number: NDArray[np.int64]  # [q]
    ticks_since_arrival: int = 0


class RecordedRun(NamedTuple):
    """One run over ticks 0 .. N."""

    xhat0: Floats  # [n]
    before: Floats  # [P, m] inputs from before tick 0, the newest first
    inputs: Floats  # [N+1, m]
    events: list[Event]
    truth: Floats  # [N+1, s] NaN where it is unknown
    expected: Floats  # [N+1, s] what the simulation, or the replay of a recording, estimates
    source: str = "a simulation"


def recorded_run(p: Plan, root_seed: int, seed: int, rows: int) -> RecordedRun:
    """Return the run of a plan with one observer, on that run's schedule (`planning.alone`).

    `rows` is the number of inputs from before tick 0.
    """
    (name, _), root, index = p.layout.observers[0], np.asarray(root_seed), np.asarray(seed)
    out = jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, p.problem, root, index))
    start = jax.jit(initial_values, static_argnums=(0, 1))
    xhat0, before = start(p.layout._replace(width=1), rows, p.problem, root, index[None])
    schedule, n = p.problem.schedule, p.problem.x0.shape[0]
    early, sampling_ticks = len(schedule.early), np.flatnonzero(schedule.sense >= 0)
    ticks = np.concatenate([np.zeros(early, int), sampling_ticks])
    numbers = np.concatenate([schedule.early, schedule.sample[sampling_ticks]])
    x, measure = out.x[:, :n, None], trajectory.jit_measure_runs()
    y = np.asarray(measure(p.layout, p.problem, root, index[None], x, ticks[None], numbers[None]))[0]
    values = np.zeros((len(y) + 1, y.shape[1]))  # by packet; the last: no packet
    values[[*range(early), *schedule.sense[sampling_ticks]]] = y
    mask = schedule.mask & ~np.isnan(values[schedule.arrive])
    arrival_ticks = np.flatnonzero(((schedule.arrive >= 0)[..., None] & mask).any((1, 2)))
    since = np.zeros_like(schedule.ticks_since_arrival)
    since[arrival_ticks] = np.diff(arrival_ticks, prepend=0)[:, None]
    is_sent = np.ones((len(schedule.sense), y.shape[1]), bool)
    is_sent[sampling_ticks] = ~np.isnan(values[schedule.sense[sampling_ticks]])
    window = Window(
        sense=schedule.snapshot,
        sampled=(schedule.sense >= 0)[:, None] & (schedule.sample >= 0) & is_sent,
        arrive=np.where(mask.any(-1), schedule.arrive, -1),
        sampling_ticks=schedule.timestamp,
        mask=mask,
        number=schedule.number,
        value=values[schedule.arrive],
        ticks_since_arrival=since,
        event=schedule.event,
    )
    events = events_of(window, p.layout.observers[0][1].on_sample is not None, early=len(schedule.early))
    expected = out.estimates[name]
    truth = out.x[:, : expected.shape[1]]
    return RecordedRun(np.asarray(xhat0), np.asarray(before), out.u, events, truth, expected)


def initial_values(
    layout: Layout, rows: int, p: GridPointParams, root_seed: Array, seeds: Array
) -> tuple[Array, Array]:
    """Return xhat(0) of a run, and the inputs before tick 0, the newest first."""
    _, state = prepare(layout, p, root_seed, seeds)

    def one(commands: PyTree) -> Array:
        return jax.vmap(present(p, jnp.asarray(0), False, commands).past_u)(jnp.arange(1, rows + 1))

    past = vmap_entrywise(one)(state.commands)
    first = initial_state.first_estimate(layout, p, root_seed, seeds)
    return lane_array.to_array(first, 1)[..., 0], lane_array.to_array(past, 1)[..., 0]


def events_of(w: Window, notifies: bool, first: int = 0, early: int = 0) -> list[Event]:
    """Return the events of the ticks from `first` on, in the order of a tick: snapshots, samples, arrivals.

    `early` packets were taken before tick 0. With `notifies`, the observer is notified when a sample is taken.
    """
    q = w.sampled.shape[1]
    none = np.zeros(q, int)
    empty = Event(tick=-1, what=SNAPSHOT, packet=-1, value=np.zeros(q), mask=np.zeros(q, bool), age=none, number=none)
    out = [empty._replace(packet=i) for i in range(early)]
    for row in map(int, np.flatnonzero(w.event)):
        k = first + row
        if w.sense[row] >= 0:
            out.append(empty._replace(tick=k, packet=int(w.sense[row])))
        if notifies and w.sampled[row].any():
            out.append(empty._replace(tick=k, what=SAMPLED, mask=w.sampled[row]))
        for slot in map(int, np.flatnonzero(w.arrive[row] >= 0)):
            arrival = Event(
                tick=k,
                what=JUMP,
                packet=int(w.arrive[row, slot]),
                value=np.where(w.mask[row, slot], w.value[row, slot], 0.0),
                mask=w.mask[row, slot],
                age=np.full(q, k - int(w.sampling_ticks[row, slot])),
                number=w.number[row, slot].astype(int),
                ticks_since_arrival=int(w.ticks_since_arrival[row, slot]),
            )
            out.append(arrival)
    return out
