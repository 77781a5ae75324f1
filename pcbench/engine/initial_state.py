"""The state before tick 0: start, memories, what a run draws for itself; with whatever will differ between lanes spread."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.engine import lane_array, steps
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.lane_array import table
from pcbench.simulation import command_network, metrics, rng
from pcbench.simulation.closed_loop import before
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, Packet, PerLane, State


def tick_sampler(
    layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array
) -> Callable[[Array], steps.TickNoise]:
    """Return what draws the noise of tick k: of the process, a standard normal for each state; of a network's commands."""
    keys = rng.run_keys(root_seed, seeds, "process", p.process_std.shape[0])
    sent = command_network.command_sampler(p.network, root_seed, seeds) if layout.pending else lambda k: ()

    def process(k: Array) -> PerLane:
        return lane_array.split(rng.normals(keys, [k for _ in keys])) if keys else jnp.zeros(0)

    return lambda k: steps.TickNoise(process(k), jax.tree.map(lane_array.split, sent(k)))


def begin(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> State:
    """Return the state before tick 0 of one lane for each of seeds[L].

    `flight` is one packet, what the start would put on the network: events make rings of it.
    """
    k = jnp.asarray(0)
    memories = _memories(layout, p, root_seed, seeds)
    loop = vmap_entrywise(partial(before, layout, p))(memories)
    state = State(
        x=_plant(layout, p, root_seed, seeds),
        drawn=drawn_numbers(layout, root_seed, seeds),
        memories=memories,
        flight=(),
        streams={},
        watches={},
        commands=loop.commands,
        tracking=loop.tracking,
        law=loop.law,
        effort=loop.effort,
    )
    size = {label: found.shape[0] + layout.plant.scored for label, found in steps.estimates(layout, p, state).items()}
    state = state._replace(
        flight=Packet(jnp.zeros(p.noise_std.shape[0]), steps.snapshot(layout, p, k, state)),
        streams={label: metrics.start(many) for label, many in size.items()},
        watches={label: metrics.start_watch(many) for label, many in size.items()} if layout.watch else {},
    )
    ready = jax.tree.map(lambda x: x if lane_array.is_lanes(x) else jnp.asarray(x), state, is_leaf=lane_array.is_lanes)
    drawn, happen = tick_sampler(layout, p, root_seed, seeds)(k), _everything(layout, p)
    ready = ready._replace(commands=_tables(ready.commands) if layout.pending else table(ready.commands))
    return lane_array.infer_batched(
        lambda state: steps.tick(layout, p, k, happen(k, state), drawn), ready, layout.width
    )


def _tables(commands: command_network.Commands) -> command_network.Commands:
    """Commands with their rings as tables."""
    return commands._replace(sent=table(commands.sent), held=table(commands.held), waiting=table(commands.waiting))


def _plant(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PerLane:
    """x(0) [n], random about x0 where the layout says so."""
    if not layout.random_initial_state:
        return p.x0
    n = p.x0.shape[0]
    normal = rng.normals(rng.run_keys(root_seed, seeds, "initial", n), jnp.zeros(n, int))
    return vmap_entrywise(lambda v: p.x0 + p.spread0 @ v)(lane_array.split(normal))


def drawn_numbers(layout: Layout, root_seed: Array, seeds: Array) -> PyTree:
    """Return the uniform numbers that each run draws for its plant; (): none."""
    if not layout.drifting:
        return ()
    return lane_array.split(rng.uniforms(root_seed, seeds, "drift", jnp.asarray(0), 1, layout.plant.drawn)[0])


def first_estimate(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PerLane:
    """Return xhat(0) [n], random in a box where the layout says so."""
    if not layout.scattered:
        return p.xhat0
    uniform = lane_array.split(rng.uniforms(root_seed, seeds, "initial", jnp.asarray(0), 1, p.x0.shape[0])[0])
    return vmap_entrywise(lambda v: p.xhat0 + p.scatter * (2 * v - 1))(uniform)


def _memories(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> PyTree:
    """The observers' memories of xhat(0)."""
    xhat0 = first_estimate(layout, p, root_seed, seeds)
    begun = vmap_entrywise(lambda xhat0: {label: o.init(p.gains[label], xhat0) for label, o in layout.observers})(xhat0)
    drawing = [(label, o.init_random) for label, o in layout.observers if o.init_random]
    if not drawing:
        return begun
    words = lane_array.split(rng.words(root_seed, seeds))

    def own(memories: PyTree, words: Array, xhat0: Array) -> PyTree:
        return memories | {
            label: init_random(p.gains[label], memories[label], words, xhat0) for label, init_random in drawing
        }

    return vmap_entrywise(own)(begun, words, xhat0)


def _everything(layout: Layout, p: GridPointParams) -> steps.Happen:
    """An event that measures, notes and jumps: `settle` traces a tick with it to find what differs between lanes."""
    q = p.noise_std.shape[0]
    noise = lane_array.split(jnp.zeros((q, layout.width)))
    random = isinstance(p.schedule, ClockParams)
    row: PyTree = ArrivalInfo(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), jnp.asarray(0))
    row = jax.tree.map(lambda a: lane_array.broadcast(a, layout.width), row) if random else row

    def happen(k: Array, state: State) -> State:
        packet = Packet(steps.measure(layout, p, k, state, noise), steps.snapshot(layout, p, k, state))
        before = state.memories
        if steps.any_is_notified(layout):
            state = state._replace(memories=steps.notify_sampled(layout, p, k, state, row.mask))
        memories = steps.jump(layout, p, k, state, row, packet)
        if random:  # what a jump changes at all, it changes in some lanes only
            memories = lane_array.unless_same(memories, before, layout.width)
        return state._replace(memories=memories, flight=packet)

    return happen
