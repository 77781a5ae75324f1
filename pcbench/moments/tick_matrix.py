"""One tick between events: plant, observers and controller flow, and the matrix of that, taken anew only where it changes."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.moments.error_sums import Seen
from pcbench.moments.events import Means
from pcbench.moments.noise_state import Form, along, slope, vector
from pcbench.simulation import command_network, simulate_runs
from pcbench.simulation.closed_loop import off_target, pushed
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import Layout, present

BLOCK = 16  # ticks whose matrices are looked at together


class Tick(NamedTuple):
    """The matrix of a tick, and what shows whether it is still that."""

    matrix: Array  # [A + V, A + w, C]
    shown: Any  # [A + V, C]; (): it is the same at every tick, or changes at ticks that are known


def flown(by: Means, k: Array, runs: Run, entering: Array, late: Any, tick: Tick) -> tuple[Run, Seen, Tick]:
    """Return the runs after a tick, what is seen of them, and the matrix of the tick."""
    form, one = by.form, partial(one_cell, by.layout)
    if isinstance(tick.shown, tuple):
        found, seen = jax.vmap(lambda state, entering: by.over(one)(k, state, entering, late))(runs, entering)
        return found, seen, tick
    many, cells = tick.matrix.shape[1:]
    A = many - entering.shape[1]
    mark = jnp.broadcast_to(_mark(many)[:, None], (many, cells))

    def each(state: Run, entering: Array) -> Any:
        return by.over(along(form, one))(k, state, entering, late, mark[:A], mark[A:])

    (found, seen), tangent = jax.vmap(each)(runs, entering)
    shown = jax.vmap(partial(flat, form), -1, -1)(jax.tree.map(lambda a: a[0], tangent))
    M = lax.cond(
        jnp.any(shown != tick.shown),
        lambda: matrix_of(by)(k, jax.tree.map(lambda a: a[0], runs), entering[0], late),
        lambda: tick.matrix,
    )
    return found, seen, Tick(M, shown)


def matrix_of(by: Means) -> Any:
    """Return the function that gives the matrix of a tick: (k, mean, no noise, late) -> [A + V, A + w, C]."""
    return by.over(slope(by.form, partial(one_cell, by.layout), partial(flat, by.form)))


def one_cell(layout: Layout, p: Any, k: Array, run: Run, noise: Array, late: Any) -> tuple[Run, Seen]:
    """Go one tick with one cell, by `simulate_runs.advance`, and read what is read of it."""
    process, p, loop, none = p.process_std.shape[0], p._replace(weights=()), layout.controller, jnp.zeros(0)
    command = command_network.Drawn(late[0], late[1], noise[process:]) if layout.pending else ()

    def read(k: Array, run: Run) -> Seen:
        return Seen(
            errors=jnp.concatenate([e for _, e in sorted(simulate_runs.errors(layout, p, p.params, k, run).items())]),
            off=off_target(loop, p, k, run.x) if loop else none,
            x=run.x if loop else none,
            u=pushed(present(p, k, True, run.commands), run.commands).u if loop else none,
        )

    new, seen = simulate_runs.advance(layout, p, p.params, k, run, noise[:process], command, read)
    return jax.tree.map(lambda a, b: jnp.asarray(a).astype(jnp.result_type(b)), new, run), seen


def flat(form: Form, found: tuple[Run, Seen]) -> Array:
    """Return what noise reaches of the state, and all that is seen."""
    return jnp.concatenate([vector(form, found[0]), *found[1]])


def _mark(many: int) -> Array:
    """Numbers whose product with a matrix shows whether it is the same."""
    return jnp.asarray(np.random.default_rng(many).normal(size=many))


def next_change(by: Means, runs: Run, ticks: int, none: Array) -> Array:
    """Return for each tick, [N+1], the first later one whose matrix is another one's, of a matrix that reads no state."""
    form, cells = by.form, none.shape[-1]
    one, mean = by.over(along(form, partial(one_cell, by.layout))), jax.tree.map(lambda a: a[0], runs)
    A = vector(form, jax.tree.map(lambda a: a[..., 0], mean)).shape[0]
    mark = jnp.broadcast_to(_mark(A + len(none))[:, None], (A + len(none), cells))

    def shown(k: Array) -> Array:
        return jax.vmap(partial(flat, form), -1, -1)(one(k, mean, none, (), mark[:A], mark[A:])[1])

    def changed(first: Array) -> Array:
        each = jax.vmap(shown)(first + jnp.arange(-1, BLOCK))
        return jnp.any(each[1:] != each[:-1], (1, 2))

    blocks = -(-ticks // BLOCK)
    at = jnp.arange(blocks * BLOCK)
    there = lax.map(changed, jnp.arange(blocks) * BLOCK).reshape(-1) & (at > 0)
    following = lax.cummin(jnp.where(there, at, ticks), reverse=True)
    return jnp.append(following[1:], ticks)[:ticks]
