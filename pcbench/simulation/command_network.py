"""The network from a controller to the plant: commands come late by times of each run's own, or never, and with noise.

Decision j, of tick j p, is sent as c_j and arrives at tick j p + d + J_j, J_j uniform over 0 .. jitter, or is lost. Over tick k
the plant is held at the newest decision that has arrived, with its noise (one that is overtaken is of no use):

    u_k = c_j + std v_j,   j = max {i : decision i has arrived at tick k or before};   before the first 0

Observers know which command is held (the network acknowledges it), not its noise. Draws are addressed by run and decision,
streams `command_jitter`, `command_loss` and `command`. Source: Schenato et al., Proc. IEEE 95 (2007), 163 (TCP-like).

The actuator line of a closed loop: commands on their way to the plant, kept in a ring, and the inputs they become.

Over tick n the plant is held at the command of the time at which the line is read, the middle of the tick less the delay,
t_n + h/2 - tau(t_n + h/2), by linear interpolation between the commands c of the ticks on both sides:

    u_n = (1 - w_n) c[n - lag_n] + w_n c[n - lag_n + 1]

With no delay at all u_n = c_n. Lags and weights are data, so one compiled program serves every delay. Inputs of the past are
read from the same ring: it has room for what a schedule can ask for, and what is beyond it reads NaN, never another tick's.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from pcbench.protocols import Delay, Leaf
from pcbench.simulation import rng

NEVER = float(2**30)  # the arrival of a lost command


class Numbers(NamedTuple):
    """Of the network; ticks."""

    every: Leaf  # p, between decisions
    delay: Leaf  # d
    jitter: Leaf
    loss: Leaf  # probability
    std: Leaf  # [m] of a command's noise


class CommandDraws(NamedTuple):
    """What a run draws for one decision."""

    late: Leaf  # [1] uniform
    lost: Leaf  # [1] uniform
    noise: Leaf  # [m] standard normal


class Commands(NamedTuple):
    """Commands and inputs of a closed loop; R rows of the past, P decisions on their way, m inputs."""

    sent: Array  # [R, m] tick n in row n mod R
    held: Array  # [R, m] the input over tick n without its noise, likewise
    waiting: Array  # [P, 2 m + 1] c, its noise, its tick of arrival; decision j in row j mod P
    newest: Array  # tick of the decision that is held; -1: none
    noise: Array  # [m] of what is held


def room(every: int, delay: int, jitter: int) -> int:
    """Return how many decisions may be on their way."""
    return (delay + jitter) // every + 1


def empty(rows: int, waiting: int, inputs: int) -> Commands:
    """Return a network on which nothing has been sent."""
    nothing = jnp.zeros((rows, inputs))
    on_the_way = jnp.zeros((waiting, 2 * inputs + 1)).at[:, -1].set(NEVER)
    return Commands(nothing, nothing, on_the_way, jnp.asarray(-1.0), jnp.zeros(inputs))


def command_sampler(p: Numbers, root_seed: Array, seeds: Array) -> Callable[[Array], CommandDraws]:
    """Return what draws the numbers [.., L] of the decision of tick k; at ticks without one they are of no use, and zero."""
    late, lost, noise = (
        rng.run_keys(root_seed, seeds, stream, many)
        for stream, many in (("command_jitter", 1), ("command_loss", 1), ("command", p.std.shape[0]))
    )

    def one(k: Array) -> tuple[Array, Array, Array]:
        j = k // p.every
        return rng.uniform(late, j), rng.uniform(lost, j), rng.normals(noise, [j for _ in noise])

    def none(k: Array) -> tuple[Array, Array, Array]:
        return tuple(jnp.zeros((many, len(seeds))) for many in (1, 1, len(noise)))  # type: ignore[return-value]

    def drawn(k: Array) -> CommandDraws:
        return CommandDraws(*lax.cond(k % p.every == 0, one, none, k))

    return drawn


def send(
    p: Numbers, k: Int[Array, ""], commands: Commands, command: Float[Array, " m"], drawn: CommandDraws
) -> Commands:
    """Send the command of tick k where there is a decision, and hold what has arrived."""
    m, P, R = command.shape[0], commands.waiting.shape[0], commands.held.shape[0]
    number, decides = k // p.every, k % p.every == 0
    arrives = k + p.delay + jnp.floor(drawn.late * (p.jitter + 1))
    arrives = jnp.where(drawn.lost < p.loss, NEVER, arrives)
    new = jnp.concatenate([command, p.std * drawn.noise, arrives])
    old = lax.dynamic_index_in_dim(commands.waiting, number % P, 0, False)
    waiting = lax.dynamic_update_index_in_dim(commands.waiting, jnp.where(decides, new, old), number % P, 0)
    ticks = (number - (number - jnp.arange(P)) % P) * p.every * 1.0  # of the decision in each row
    arrived = (waiting[:, -1] <= k) & (ticks > commands.newest)
    newest = jnp.max(jnp.where(arrived, ticks, commands.newest))
    chosen = arrived & (ticks == newest)
    came = jnp.any(chosen)
    found = jnp.sum(jnp.where(chosen[:, None], waiting[:, :-1], 0.0), 0)
    last = lax.dynamic_index_in_dim(commands.held, (k - 1) % R, 0, False)
    held = jnp.where(came, found[:m], last)
    return Commands(
        sent=lax.dynamic_update_index_in_dim(commands.sent, command, k % R, 0),
        held=lax.dynamic_update_index_in_dim(commands.held, held, k % R, 0),
        waiting=waiting,
        newest=newest,
        noise=jnp.where(came, found[m:], commands.noise),
    )


def input_at(commands: Commands, n: Int[Array, ""], newest: Int[Array, ""]) -> Float[Array, " m"]:
    """Return the input over tick n without its noise; that of a tick beyond the ring is NaN."""
    R = commands.held.shape[0]
    row = lax.dynamic_index_in_dim(commands.held, jnp.minimum(n, newest) % R, 0, False)
    return jnp.where(n > newest - R, row, jnp.nan)


class Line(NamedTuple):
    """When the line is read: a row for each tick from -R on, R the ring's rows; empty in an open loop."""

    lag: Leaf  # [R + N + 1 + ahead] ticks
    weight: Leaf  # [R + N + 1 + ahead] 0 .. 1


NONE = Line(np.zeros(0, int), np.zeros(0))


def line(delay: Delay, dt: float, rows: int, ticks: int) -> Line:
    """Return the line of a delay [s] of the time, 0 or at least half a tick, for ticks -`rows` .. `ticks`."""
    n = np.arange(-rows, ticks + 1)
    late = delay((n + 0.5) * dt) / dt
    read = n + 0.5 - late
    whole = np.floor(read).astype(int)
    straight = late == 0
    return Line(np.where(straight, 1, n - whole), np.where(straight, 1.0, read - whole))


def held_line(late: int, rows: int, ticks: int) -> Line:
    """Return the line whose input over a tick is the command of `late` ticks before, for ticks -`rows` .. `ticks`."""
    many = rows + ticks + 1
    return Line(np.full(many, max(late, 1)), np.full(many, float(late == 0)))


def rows_needed(delay: Delay, dt: float, ticks: int, oldest: int) -> int:
    """Return the rows of a ring from which inputs up to `oldest` ticks old can be read."""
    return oldest + int(line(delay, dt, 0, ticks).lag.max()) + 2


def read(line: Line, commands: Float[Array, "R m"], n: Int[Array, ""], newest: Int[Array, ""]) -> Float[Array, " m"]:
    """Return the input held over tick n, from commands up to that of tick `newest`; a later one is taken for the newest."""
    R = commands.shape[0]
    row = jnp.clip(n + R, 0, line.lag.shape[0] - 1)
    first, w = n - line.lag[row], line.weight[row]
    older, newer = (
        lax.dynamic_index_in_dim(commands, jnp.minimum(tick, newest) % R, 0, False) for tick in (first, first + 1)
    )
    return jnp.where(first > newest - R, (1 - w) * older + w * newer, jnp.nan)


def write(commands: Float[Array, "R m"], k: Int[Array, ""], command: Float[Array, " m"]) -> Float[Array, "R m"]:
    """Put the command of tick k on the line."""
    return lax.dynamic_update_index_in_dim(commands, command, k % commands.shape[0], 0)
