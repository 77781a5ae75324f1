"""The reference definition of a run: pure functions of one run, `lax.scan` over ticks, and `jax.vmap` over runs.

Each tick k = 0 .. N-1 has this order:

    1. sense      channels that are due are measured, y = output(x_k) + noise, and observers take a snapshot
    2. deliver    observers use the packets that arrive, the oldest first
    3. estimate   errors e_k = z_k - xhat_k are added to the sums of the window of k; z is x with the unknown inputs
    4. control    in a closed loop the command of tick k is computed from the estimate
    5. flow       plant and observers move to tick k + 1 under the same input

The last tick has no flow. The faster `pcbench.engine` agrees with this definition to 1e-11 of the largest error
(`tests/simulation/test_definition.py`).

n states, q outputs, W windows, E packets on the network at one time (`layout.ring`).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.dynamics.integrate import rk4
from pcbench.protocols import Arrival, Now, Params
from pcbench.simulation import closed_loop, command_network, innovation_stats, measurements, metrics, rng
from pcbench.simulation.types import GridPointParams, Layout, Packet, RunSums, params_of, present, truth

Tree = Any  # of arrays


class Run(NamedTuple):
    """The state of one run between ticks."""

    x: Array  # [n]
    memories: Tree  # by observer
    flight: Packet  # rings [E, ...] by packet number
    streams: Tree  # by observer, `metrics.ErrorSums` [W, ...]
    watches: Tree  # by observer, `metrics.SettlingState`
    commands: Tree = ()  # of a closed loop
    law: Tree = ()  # the controller's memory
    tracking: Tree = ()  # `metrics.ErrorSums` [W, ...]
    effort: Tree = ()  # `metrics.ControlCost` [W]
    sensors: Tree = ()  # `measurements.Sensors`, if sensors decide which samples are sent


class Shift(NamedTuple):
    """A change of packet values and snapshots by packet number, to find which results depend on them. P packets."""

    values: Array  # [P, q]
    snapshots: Array  # [P]


class Draws(NamedTuple):
    """The random numbers of one run, independent of observers and of other runs."""

    start: Array  # [n] standard normal, for x(0)
    box: Array  # [n] uniform, for xhat(0)
    plant: PyTree  # [d] uniform, for the plant's parameters
    words: Array  # [2] for observers that draw random numbers
    # (sample number of each channel) -> [q] noise before scaling; then [q] for quantization
    sample: Callable[[Array], Array]
    process: Callable[[Array], Array]  # (tick) -> [n] standard normal
    command: Callable[[Array], PyTree]  # (tick) -> command_network.CommandDraws


def simulate_runs(
    layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array, schedules: PyTree = None
) -> RunSums:
    """Return the sums of the runs of seeds [L], every array with L last.

    `schedules` has one schedule per run, every array with L first, if sampling is random. Else all share `p.schedule`.
    """

    def one(seed: Array, schedule: PyTree) -> RunSums:
        return simulate_run(layout, p if schedule is None else p._replace(schedule=schedule), root_seed, seed)

    return jax.vmap(one, out_axes=-1)(seeds, schedules)


def simulate_run(layout: Layout, p: GridPointParams, root_seed: Array, seed: Array) -> RunSums:
    """Return the sums of one run."""
    layout = innovation_stats.add_innovation_stats(layout) if layout.consistency else layout
    draws = draw(layout, p, root_seed, seed)
    params = params_of(layout, p, draws.plant)
    last = p.schedule.event.shape[0] - 2  # tick N - 1
    start = initial_run(layout, p, params, draws)
    run, _ = lax.scan(lambda run, k: tick(layout, p, params, draws, run, k), start, jnp.arange(last))
    k = jnp.asarray(last, int)  # as an array: a Python number would take its type from the other operand
    run = estimate(layout, p, params, k, events(layout, p, params, draws, k, run))
    if isinstance(p.weights, metrics.Weights):
        run = control(layout, p, k, run, draws.command(k))
    e = errors(layout, p, params, k, run)
    return RunSums(
        streams=run.streams,
        watches=run.watches,
        final=e,
        tracking=run.tracking,
        effort=run.effort,
        consistency=normalized_errors(layout, p, k, run, e) if layout.consistency else (),
        actual=truth(layout, params, present(p, k, True), run.x),
        sent=run.sensors.n_sent / run.sensors.n_samples if p.trigger else (),
    )


def tick(
    layout: Layout,
    p: GridPointParams,
    params: Params,
    draws: Draws,
    run: Run,
    k: Array,
    read: Callable[[Array, Run], Tree] = lambda k, run: None,
    shift: Shift | None = None,
) -> tuple[Run, Tree]:
    """Return a run at tick k + 1, and the value of `read` at tick k after its command."""
    run = events(layout, p, params, draws, k, run, shift)  # 1. sense, 2. deliver
    run = estimate(layout, p, params, k, run)  # 3. estimate
    return advance(layout, p, params, k, run, draws.process(k), draws.command(k), read)


def advance(
    layout: Layout,
    p: GridPointParams,
    params: Params,
    k: Array,
    run: Run,
    w: Array,
    command: PyTree,
    read: Callable[[Array, Run], Tree],
) -> tuple[Run, Tree]:
    """Return a run at tick k + 1 from one at tick k after its events, and the value of `read` after the command.

    `w` [n] is the process noise, `command` the random numbers of the network (`command_network.CommandDraws`).
    """
    run = control(layout, p, k, run, command)  # 4. control
    return flow(layout, p, params, k, run, w), read(k, run)  # 5. flow


def events(
    layout: Layout, p: GridPointParams, params: Params, draws: Draws, k: Array, run: Run, shift: Shift | None = None
) -> Run:
    """Do steps 1 and 2 at a tick at which something is sampled or arrives."""

    def happen(run: Run) -> Run:
        return deliver(layout, p, k, sense(layout, p, params, draws, k, run, shift))

    return lax.cond(p.schedule.event[k], happen, lambda run: run, run)


def draw(layout: Layout, p: GridPointParams, root_seed: Array, seed: Array) -> Draws:
    """Return the random numbers of one run by their addresses (`rng`)."""
    n, q, one = p.x0.shape[0], p.noise_std.shape[0], seed[None]
    normal = rng.normals(rng.run_keys(root_seed, one, "initial", n), jnp.zeros(n, int))
    uniform = partial(rng.uniforms, root_seed, one, channel=jnp.asarray(0), samples=1)
    process = rng.run_keys(root_seed, one, "process", p.process_std.shape[0])
    noise = measurements.noise_sampler(p, root_seed, one)
    command = command_network.command_sampler(p.network, root_seed, one) if layout.pending else None

    return Draws(
        start=normal[:, 0],
        box=uniform(stream="initial", numbers=n)[0, :, 0],
        plant=uniform(stream="drift", numbers=layout.plant.drawn)[0, :, 0] if layout.drifting else (),
        words=rng.words(root_seed, one)[:, 0],
        sample=lambda numbers: noise(list(range(q)), numbers)[:, 0],
        process=lambda k: rng.normals(process, [k for _ in process])[:, 0] if process else jnp.zeros(0),
        command=lambda k: jax.tree.map(lambda a: a[..., 0], command(k)) if command else (),
    )


def initial_run(layout: Layout, p: GridPointParams, params: Params, draws: Draws) -> Run:
    """Return a run before tick 0."""
    x = p.x0 + p.spread0 @ draws.start if layout.random_initial_state else p.x0
    xhat0 = p.xhat0 + p.scatter * (2 * draws.box - 1) if layout.scattered else p.xhat0
    run = run_from(layout, p, jnp.asarray(x), xhat0, draws.words)
    for number in range(p.schedule.early.shape[0]):  # taken before tick 0: they measure x(0)
        y = measure(layout, p, params, jnp.asarray(0, int), run.x, draws.sample(p.schedule.early[number]))
        run = run._replace(flight=run.flight._replace(values=run.flight.values.at[number % layout.ring].set(y)))
    return run


def run_from(layout: Layout, p: GridPointParams, x: Array, xhat0: Array, words: Array) -> Run:
    """Return a run before tick 0 from a state [n] and its estimate [n], without samples; `words` as in `Draws`."""
    memories = {label: o.init(p.gains[label], xhat0) for label, o in layout.observers}
    for label, o in layout.observers:
        if o.init_random:
            memories[label] = o.init_random(p.gains[label], memories[label], words, xhat0)
    memories = jax.tree.map(jnp.asarray, memories)
    loop = closed_loop.first_loop_state(layout, p, memories)
    snapshots = take_snapshots(layout, p, jnp.asarray(0, int), memories, loop.commands)
    per_packet = partial(jax.tree.map, lambda a: jnp.broadcast_to(a, (layout.ring, *jnp.shape(a))))
    per_window = partial(jax.tree.map, lambda a: jnp.broadcast_to(a, (p.windows.shape[0], *jnp.shape(a))))
    sizes = {
        label: o.estimate(p.gains[label], memories[label]).shape[0] + layout.plant.scored
        for label, o in layout.observers
    }
    return Run(
        x=x,
        memories=memories,
        flight=Packet(per_packet(jnp.zeros(p.noise_std.shape[0])), per_packet(snapshots)),
        streams={label: per_window(metrics.zero_sums(size)) for label, size in sizes.items()},
        watches=initial_settling_states(layout, sizes),
        commands=loop.commands,
        law=loop.law,
        tracking=per_window(loop.tracking),
        effort=per_window(loop.effort),
        sensors=measurements.first_sensors(p.noise_std.shape[0]) if p.trigger else (),
    )


def initial_settling_states(layout: Layout, sizes: dict[str, int]) -> dict[str, metrics.SettlingState]:
    """Return the settling states before tick 0, by observer with its number of errors."""
    if not layout.watch:
        return {}
    n_bounded = {label: sizes[label] - layout.plant.scored if o.bounds else 0 for label, o in layout.observers}
    return {label: metrics.initial_settling(size, n_bounded[label]) for label, size in sizes.items()}


def measure(layout: Layout, p: GridPointParams, params: Params, k: Array, x: Array, v: Array) -> Array:
    """Return the measurement of every channel at tick k, [q], from its noise and quantization draws v.

    In a closed loop y does not depend on u.
    """
    y = layout.plant.output(params, present(p, k, True), x)
    if layout.continuous:
        return y
    y = y + p.noise_std * v[: y.shape[0]]
    return measurements.quantize(p.rounding, y, v[y.shape[0] :]) if p.rounding else y


def take_snapshots(layout: Layout, p: GridPointParams, k: Array, memories: Tree, commands: Tree) -> Tree:
    """Return the snapshot of every observer at tick k, to be used when the sample of this tick arrives."""
    now = present(p, k, False, commands)
    return {label: o.snapshot(p.gains[label], memories[label], now) for label, o in layout.observers}


def sense(
    layout: Layout, p: GridPointParams, params: Params, draws: Draws, k: Array, run: Run, shift: Shift | None = None
) -> Run:
    """1. Take the sample of tick k, if there is one, with the snapshots; notify observers with `on_sample`."""
    schedule = p.schedule

    def set_row(ring: Tree, number: Array, value: Tree) -> Tree:
        place = number % layout.ring
        return jax.tree.map(lambda a, v: jnp.where(number >= 0, a.at[place].set(v), a), ring, value)

    values, snapshots = run.flight
    y, is_sampled = measure(layout, p, params, k, run.x, draws.sample(schedule.sample[k])), schedule.sample[k] >= 0
    if p.trigger:
        sensors, y = measurements.send(p.trigger, run.sensors, y, (schedule.sense[k] >= 0) & is_sampled)
        run, is_sampled = run._replace(sensors=sensors), is_sampled & ~jnp.isnan(y)
    new = take_snapshots(layout, p, k, run.memories, run.commands)
    if shift:
        y = y + shift.values[schedule.sense[k]]
        new = jax.tree.map(lambda a: a + shift.snapshots[schedule.snapshot[k]].astype(a.dtype), new)
    values = set_row(values, schedule.sense[k], y)
    extra = (schedule.extra_snapshots[k, i] for i in range(schedule.extra_snapshots.shape[1]))
    for number in (schedule.snapshot[k], *extra):
        snapshots = set_row(snapshots, number, new)
    notified = notify(layout, p, k, run, is_sampled)
    memories = freeze_diverged(layout, run, select(schedule.sense[k] >= 0, notified, run.memories), run.memories)
    return run._replace(memories=memories, flight=Packet(values, snapshots))


def notify(layout: Layout, p: GridPointParams, k: Array, run: Run, mask: Array) -> Tree:
    """Return the memories after observers with `on_sample` are notified which channels [q] take and send a sample."""
    now = present(p, k, False, run.commands)
    return {
        label: o.on_sample(p.gains[label], run.memories[label], now, mask) if o.on_sample else run.memories[label]
        for label, o in layout.observers
    }


def deliver(layout: Layout, p: GridPointParams, k: Array, run: Run) -> Run:
    """2. Let the observers use the packets that arrive at tick k, the oldest first."""
    schedule, has_arrived = p.schedule, jnp.asarray(False)
    for slot in range(schedule.arrive.shape[1]):
        number, mask = schedule.arrive[k, slot], schedule.mask[k, slot]
        values, snapshots = jax.tree.map(lambda a, i=number % layout.ring: a[i], run.flight)
        age, silent = jnp.full(mask.shape, k - schedule.timestamp[k, slot]), None
        ticks_since = schedule.ticks_since_arrival[k, slot]
        if p.trigger:
            silent, mask = mask & jnp.isnan(values), mask & ~jnp.isnan(values)
            values, ticks_since = jnp.where(mask, values, 0.0), k - run.sensors.last_arrival
            has_arrived |= (number >= 0) & jnp.any(mask)
        index = schedule.number[k, slot]
        arrival = partial(Arrival, values, mask, age, index, ticks_since_arrival=ticks_since, silent=silent)
        memories = select(number >= 0, jump(layout, p, k, run, snapshots, arrival), run.memories)
        if p.trigger:  # nothing arrives if no channel has sent
            listeners = {label for label, o in layout.observers if o.uses_silence}
            memories = {
                label: memory if label in listeners else select(jnp.any(mask), memory, run.memories[label])
                for label, memory in memories.items()
            }
        run = run._replace(memories=freeze_diverged(layout, run, memories, run.memories))
    if p.trigger:
        last_arrival = jnp.where(has_arrived, k, run.sensors.last_arrival)
        run = run._replace(sensors=run.sensors._replace(last_arrival=last_arrival))
    return run


def jump(
    layout: Layout, p: GridPointParams, k: Array, run: Run, snapshots: Tree, arrival: Callable[[PyTree], Arrival]
) -> Tree:
    """Return the memories after a packet that arrives at tick k; `arrival` makes an Arrival from an observer's snapshot."""
    now = present(p, k, False, run.commands)
    return {
        label: o.jump(p.gains[label], run.memories[label], now, arrival(snapshots[label]))
        for label, o in layout.observers
    }


def errors(layout: Layout, p: GridPointParams, params: Params, k: Array, run: Run) -> dict[str, Array]:
    """Return e of every observer at tick k for all that it estimates, followed by the plant's user-defined errors."""
    z = truth(layout, params, present(p, k, True), run.x)
    estimates = {label: o.estimate(p.gains[label], run.memories[label]) for label, o in layout.observers}
    e = {label: z[: xhat.shape[0]] - xhat for label, xhat in estimates.items()}
    user_defined = user_errors(layout, p, params, k, run)
    return {label: jnp.concatenate([e[label], user_defined[label]]) for label in e} if user_defined else e


def intervals(
    layout: Layout, p: GridPointParams, params: Params, k: Array, run: Run
) -> dict[str, metrics.IntervalSums]:
    """Return interval width and coverage of tick k, for observers with bounds."""
    bounds = [(label, o.bounds(p.gains[label], run.memories[label])) for label, o in layout.observers if o.bounds]
    z = truth(layout, params, present(p, k, True), run.x) if bounds else run.x
    inside = {label: (lower <= z[: len(lower)]) & (z[: len(lower)] <= upper) for label, (lower, upper) in bounds}
    return {label: metrics.IntervalSums(upper - lower, inside[label].astype(float)) for label, (lower, upper) in bounds}


def user_errors(layout: Layout, p: GridPointParams, params: Params, k: Array, run: Run) -> dict[str, Array]:
    """Return the plant's user-defined errors for every observer at tick k, [d]; empty if it has none."""
    if layout.plant.errors is None:
        return {}
    now = present(p, k, False, run.commands)
    estimates = {label: o.estimate(p.gains[label], run.memories[label]) for label, o in layout.observers}
    return {label: layout.plant.errors(params, now, run.x, xhat) for label, xhat in estimates.items()}


def estimate(layout: Layout, p: GridPointParams, params: Params, k: Array, run: Run) -> Run:
    """3. Add the errors of tick k, and the tracking error of a closed loop, to the sums of its window."""
    e, window = errors(layout, p, params, k, run), jnp.sum(k >= p.windows[:, 1])
    streams = {
        label: update_window(s, window, partial(metrics.add_error, e=e[label])) for label, s in run.streams.items()
    }
    interval_sums = intervals(layout, p, params, k, run) if run.watches else {}
    watches = {
        label: metrics.update_settling(w, k, e[label], p.band, p.bound, p.jumps, interval_sums.get(label, ()))
        for label, w in run.watches.items()
    }
    tracking = run.tracking
    if layout.controller and run.tracking:
        error = closed_loop.tracking_error(layout.controller, p, k, run.x)
        tracking = update_window(tracking, window, lambda s: metrics.add_error(s, error))
    return run._replace(streams=streams, watches=watches, tracking=tracking)


def control(layout: Layout, p: GridPointParams, k: Array, run: Run, draws: PyTree) -> Run:
    """4. Compute the command of tick k in a closed loop, and add its cost."""
    if layout.controller is None:
        return run
    run = command(layout, p, k, run, draws)
    if not isinstance(p.weights, metrics.Weights):
        return run
    window = jnp.sum(k >= p.windows[:, 1])
    effort = update_window(run.effort, window, partial(add_cost, layout, p, k, run))
    return run._replace(effort=effort)


def command(layout: Layout, p: GridPointParams, k: Array, run: Run, draws: PyTree) -> Run:
    """Return the run with the command of tick k, which the controller computes from the present estimate."""
    controller: PyTree = layout.controller
    ((label, observer),) = layout.observers
    now, xhat = present(p, k, False, run.commands), observer.estimate(p.gains[label], run.memories[label])
    ring = run.commands.commands if layout.pending else run.commands

    def future_input(i: Array) -> Array:
        return command_network.delayed_command(p.line, ring, k + i, k - 1)

    if controller.start:
        c, law = controller.command(p.control, now, xhat, future_input, run.law)
    else:
        c, law = controller.command(p.control, now, xhat, future_input), run.law
    commands: PyTree
    if layout.pending:
        commands = command_network.send(p.network, k, run.commands, c, draws)
    else:
        commands = command_network.write(run.commands, k, c)
    return run._replace(commands=commands, law=law)


def add_cost(
    layout: Layout, p: GridPointParams, k: Array, run: Run, effort: metrics.ControlCost
) -> metrics.ControlCost:
    """Return the control cost including the input of tick k."""
    u = closed_loop.add_command_noise(present(p, k, True, run.commands), run.commands).u
    return metrics.add_cost(effort, p.weights, k, run.x, u)


def flow(layout: Layout, p: GridPointParams, params: Params, k: Array, run: Run, w: Array) -> Run:
    """5. Move plant and observers from tick k to tick k + 1, the plant with the process noise w [n]."""
    now, commands = present(p, k, True, run.commands), run.commands
    if layout.continuous:
        x, memories = as_one_field(layout, p, params, now, run)
    else:
        x = layout.plant.step(params, closed_loop.add_command_noise(now, commands), run.x)
        memories = {label: o.flow(p.gains[label], run.memories[label], now) for label, o in layout.observers}
    if w.size:
        x = x + (p.process_std @ w if np.ndim(p.process_std) == 2 else p.process_std * w)
    x, memories = freeze_diverged(layout, run, (x, memories), (run.x, run.memories))
    return run._replace(x=x, memories=memories)


def as_one_field(layout: Layout, p: GridPointParams, params: Params, now: Now, run: Run) -> tuple[Array, Tree]:
    """Move plant and observers as one differential equation: at every stage the observers see y of that stage."""
    plant: PyTree = layout.plant.field

    def field(t: Array, z: PyTree) -> PyTree:
        stage, (x, memories) = now._replace(t=t), z
        y = layout.plant.output(params, stage, x)
        rates = {label: o.field(p.gains[label], memories[label], stage, y) for label, o in layout.observers if o.field}
        return plant(params, closed_loop.add_command_noise(stage, run.commands), x), rates

    end: tuple[Array, Tree] = rk4(field, now.t, (run.x, run.memories), now.dt)
    return end


def normalized_errors(
    layout: Layout, p: GridPointParams, k: Array, run: Run, e: dict[str, Array]
) -> dict[str, innovation_stats.Squares]:
    """Return the normalized errors of tick k, for observers that report a covariance."""
    prior_std = jnp.diagonal(p.spread0)
    covariances = innovation_stats.covariances(layout, p, k, run.memories, run.commands)

    def one(label: str, P: Array) -> innovation_stats.Squares:
        squares = innovation_stats.normalize_error(e[label][: len(prior_std)], P, prior_std)
        return squares._replace(innovation=innovation_stats.sums(run.memories[label]))

    return {label: one(label, P) for label, P in covariances.items()}


def freeze_diverged(layout: Layout, run: Run, new: Tree, old: Tree) -> Tree:
    """Return `old` if a closed loop has diverged, else `new`."""
    return closed_loop.unless_diverged(run.watches, new, old) if layout.controller else new


def select(mask: Array, new: Tree, old: Tree) -> Tree:
    """Return `new` where `mask` is true, else `old`."""
    return jax.tree.map(lambda a, b: jnp.where(mask, a, b), new, old)


def update_window(windows: Tree, window: Array, add: Callable[[Tree], Tree]) -> Tree:
    """Return sums [W, ...] with one window updated by `add`."""
    sums = add(jax.tree.map(lambda a: a[window], windows))
    return jax.tree.map(lambda a, new: a.at[window].set(new), windows, sums)
