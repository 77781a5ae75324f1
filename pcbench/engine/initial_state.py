"""The state before tick 0: initial state, memories and the random numbers of each run, broadcast where lanes will differ."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.engine import lane_array, lane_forms, steps
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.lane_array import table
from pcbench.simulation import command_network, metrics, rng, simulate_runs
from pcbench.simulation.closed_loop import first_loop_state
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, Packet, PerLane, State


def tick_sampler(
    layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array
) -> Callable[[Array], steps.TickNoise]:
    """Return a function of the tick that draws process noise, a standard normal per state, and the network's random numbers."""
    keys = rng.run_keys(root_seed, seeds, "process", p.process_std.shape[0])
    command = command_network.command_sampler(p.network, root_seed, seeds) if layout.pending else lambda k: ()

    def process(k: Array) -> PerLane:
        return lane_array.split(rng.normals(keys, [k for _ in keys])) if keys else jnp.zeros(0)

    return lambda k: steps.TickNoise(process(k), jax.tree.map(lane_array.split, command(k)))


def initial_lanes(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> State:
    """Return the state before tick 0 of one lane for each of seeds[L].

    `flight` is one packet with the snapshots of the initial state; the event modules build rings from it.
    """
    k = jnp.asarray(0)
    memories = _memories(layout, p, root_seed, seeds)
    loop = vmap_entrywise(partial(first_loop_state, layout, p))(memories)
    state = State(
        x=_plant(layout, p, root_seed, seeds),
        plant_draws=draw_plant_numbers(layout, root_seed, seeds),
        memories=memories,
        flight=(),
        streams={},
        watches={},
        commands=loop.commands,
        tracking=loop.tracking,
        law=loop.law,
        effort=loop.effort,
    )
    sizes = {label: xhat.shape[0] + layout.plant.scored for label, xhat in steps.estimates(layout, p, state).items()}
    state = state._replace(
        flight=Packet(jnp.zeros(p.noise_std.shape[0]), steps.snapshot(layout, p, k, state)),
        streams={label: metrics.zero_sums(n) for label, n in sizes.items()},
        watches=simulate_runs.initial_settling_states(layout, sizes),
    )
    ready = jax.tree.map(lambda x: x if lane_array.is_lanes(x) else jnp.asarray(x), state, is_leaf=lane_array.is_lanes)
    ready = ready._replace(commands=_tables(ready.commands) if layout.pending else table(ready.commands))
    return _broadcast(layout, p, ready, tick_sampler(layout, p, root_seed, seeds)(k))


def _tables(commands: command_network.Commands) -> command_network.Commands:
    """Return commands with their rings as tables."""
    return commands._replace(
        commands=table(commands.commands), inputs=table(commands.inputs), in_transit=table(commands.in_transit)
    )


def _plant(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PerLane:
    """Return x(0) [n], random about x0 if the layout has a random initial state."""
    if not layout.random_initial_state:
        return p.x0
    n = p.x0.shape[0]
    normal = rng.normals(rng.run_keys(root_seed, seeds, "initial", n), jnp.zeros(n, int))
    return vmap_entrywise(lambda v: p.x0 + p.spread0 @ v)(lane_array.split(normal))


def draw_plant_numbers(layout: Layout, root_seed: Array, seeds: Array) -> PyTree:
    """Return the uniform numbers that each run draws for its plant; (): none."""
    if not layout.drifting:
        return ()
    return lane_array.split(rng.uniforms(root_seed, seeds, "drift", jnp.asarray(0), 1, layout.plant.drawn)[0])


def first_estimate(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PerLane:
    """Return xhat(0) [n], random in a box if the layout has a random estimate."""
    if not layout.scattered:
        return p.xhat0
    uniform = lane_array.split(rng.uniforms(root_seed, seeds, "initial", jnp.asarray(0), 1, p.x0.shape[0])[0])
    return vmap_entrywise(lambda v: p.xhat0 + p.scatter * (2 * v - 1))(uniform)


def _memories(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PyTree:
    """Return the observers' memories at xhat(0)."""
    xhat0 = first_estimate(layout, p, root_seed, seeds)
    start = vmap_entrywise(lambda xhat0: {label: o.init(p.gains[label], xhat0) for label, o in layout.observers})(xhat0)
    samplers = [(label, o.init_random) for label, o in layout.observers if o.init_random]
    if not samplers:
        return start
    words = lane_array.split(rng.words(root_seed, seeds))

    def init_from_words(memories: PyTree, words: Array, xhat0: Array) -> PyTree:
        return memories | {
            label: init_random(p.gains[label], memories[label], words, xhat0) for label, init_random in samplers
        }

    return vmap_entrywise(init_from_words)(start, words, xhat0)


def _broadcast(layout: Layout, p: GridPointParams, state: State, tick_noise: steps.TickNoise) -> State:
    """Broadcast every value that a tick with sample, snapshot and jump makes different between lanes, to a fixed point."""
    q, k, width, is_random = p.noise_std.shape[0], jnp.asarray(0), layout.width, isinstance(p.schedule, ClockParams)
    info: PyTree = ArrivalInfo(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), jnp.asarray(0))
    has_arrival: PyTree = jnp.asarray(True)  # whether a lane has an arrival
    if is_random:
        info, has_arrival = jax.tree.map(lambda a: lane_array.broadcast(a, width), (info, has_arrival))

    def events(state: State, noise: PerLane, info: ArrivalInfo, has_arrival: Array) -> State:
        packet = Packet(steps.measure(layout, p, k, state, noise), steps.snapshot(layout, p, k, state))
        old = state.memories
        if steps.any_is_notified(layout):
            state = state._replace(memories=steps.notify_sampled(layout, p, k, state, info.mask))
        new = steps.jump(layout, p, k, state, info, packet)
        memories = jax.tree.map(lambda a, b: a if a is b or not a.size else jnp.where(has_arrival, a, b), new, old)
        return state._replace(memories=memories, flight=packet)

    noise = lane_array.split(jnp.zeros((q, width)))
    event_program, event_forms, _ = lane_forms.trace_lane(events, state, noise, info, has_arrival)
    tick_program, tick_forms, _ = lane_forms.trace_lane(partial(steps.tick, layout, p, k), state, tick_noise)
    leaves, tree = jax.tree.flatten(state, is_leaf=lane_array.is_lanes)
    n_leaves = len(leaves)

    def step(forms: lane_forms.Forms) -> lane_forms.Forms:
        forms = lane_forms.forms_of(event_program, [*forms, *event_forms[n_leaves:]])
        return lane_forms.forms_of(tick_program, [*forms, *tick_forms[n_leaves:]])

    forms = lane_forms.fixed_point(step, event_forms[:n_leaves])
    is_long = [len(x.shape) > 0 and x.shape[0] >= lane_forms.TABLE_ROWS for x in leaves]
    forms = [lane_array.TABLE if form and long else form for form, long in zip(forms, is_long, strict=True)]
    state_leaves = (lane_array.to_form(x, form, width) for x, form in zip(leaves, forms, strict=True))
    return jax.tree.unflatten(tree, state_leaves)
