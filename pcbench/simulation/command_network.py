"""Commands on their way to the plant: over a network with random delay, loss and noise, or through an actuator delay.

Network
    Decision j is made at tick j p and sent as c_j. It is lost, or arrives at tick j p + d + J_j with J_j uniform over
    0 .. jitter. Over tick k the plant's input is the newest decision that has arrived, with its noise:

        u_k = c_j + std v_j,   j = max {i : decision i arrived at tick k or before};   0 before the first arrival

    A decision that arrives after a newer one is ignored. Observers receive the command in use (the network acknowledges it)
    without its noise. Random numbers are addressed by run and decision, in the streams `command_jitter`, `command_loss` and
    `command`. Source: Schenato et al., Proc. IEEE 95 (2007), 163 (TCP-like).

Actuator delay
    Commands are stored in a ring. The input over tick n is the command at the middle of the tick minus the delay,
    t_n + h/2 - tau(t_n + h/2), interpolated linearly between the commands c of the two neighbouring ticks:

        u_n = (1 - w_n) c[n - lag_n] + w_n c[n - lag_n + 1]

    Without a delay u_n = c_n. Lags and weights are data, so one compiled program covers every delay. Past inputs are read
    from the same ring. A tick outside the ring reads NaN.
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
    """Parameters of the network, in ticks."""

    every: Leaf  # p, between decisions
    delay: Leaf  # d
    jitter: Leaf
    loss: Leaf  # probability
    std: Leaf  # [m] of a command's noise


class CommandDraws(NamedTuple):
    """The random numbers of one decision."""

    late: Leaf  # [1] uniform
    lost: Leaf  # [1] uniform
    noise: Leaf  # [m] standard normal


class Commands(NamedTuple):
    """Commands and inputs of a closed loop: R ring rows, P decisions on their way, m inputs."""

    sent: Array  # [R, m] command of tick n in row n mod R
    held: Array  # [R, m] input over tick n without noise, in row n mod R
    waiting: Array  # [P, 2 m + 1] command, noise, arrival tick; decision j in row j mod P
    newest: Array  # tick of the decision in use; -1: none
    noise: Array  # [m] noise of the decision in use


def room(every: int, delay: int, jitter: int) -> int:
    """Return the largest number of decisions on their way at one time."""
    return (delay + jitter) // every + 1


def empty(rows: int, waiting: int, inputs: int) -> Commands:
    """Return a network on which nothing has been sent."""
    nothing = jnp.zeros((rows, inputs))
    on_the_way = jnp.zeros((waiting, 2 * inputs + 1)).at[:, -1].set(NEVER)
    return Commands(nothing, nothing, on_the_way, jnp.asarray(-1.0), jnp.zeros(inputs))


def command_sampler(p: Numbers, root_seed: Array, seeds: Array) -> Callable[[Array], CommandDraws]:
    """Return a function of the tick that draws the numbers [.., L] of its decision, or zeros at ticks without a decision."""
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
    """Send the command of tick k if there is a decision, and update the input with the newest arrival."""
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
    """Return the noise-free input over tick n; NaN for a tick outside the ring."""
    R = commands.held.shape[0]
    row = lax.dynamic_index_in_dim(commands.held, jnp.minimum(n, newest) % R, 0, False)
    return jnp.where(n > newest - R, row, jnp.nan)


class Line(NamedTuple):
    """The position read from the ring, one row per tick from -R on, R ring rows; empty for an open loop."""

    lag: Leaf  # [R + N + 1 + ahead] ticks
    weight: Leaf  # [R + N + 1 + ahead] 0 .. 1


NONE = Line(np.zeros(0, int), np.zeros(0))


def line(delay: Delay, dt: float, rows: int, ticks: int) -> Line:
    """Return the `Line` of a delay [s] that is a function of time, 0 or at least half a tick, for ticks -`rows` .. `ticks`."""
    n = np.arange(-rows, ticks + 1)
    late = delay((n + 0.5) * dt) / dt
    read = n + 0.5 - late
    whole = np.floor(read).astype(int)
    straight = late == 0
    return Line(np.where(straight, 1, n - whole), np.where(straight, 1.0, read - whole))


def held_line(late: int, rows: int, ticks: int) -> Line:
    """Return the `Line` whose input is the command of `late` ticks earlier, for ticks -`rows` .. `ticks`."""
    many = rows + ticks + 1
    return Line(np.full(many, max(late, 1)), np.full(many, float(late == 0)))


def rows_needed(delay: Delay, dt: float, ticks: int, oldest: int) -> int:
    """Return the number of ring rows needed to read inputs up to `oldest` ticks old."""
    return oldest + int(line(delay, dt, 0, ticks).lag.max()) + 2


def read(line: Line, commands: Float[Array, "R m"], n: Int[Array, ""], newest: Int[Array, ""]) -> Float[Array, " m"]:
    """Return the input over tick n from commands up to tick `newest`; a later tick reads the newest command."""
    R = commands.shape[0]
    row = jnp.clip(n + R, 0, line.lag.shape[0] - 1)
    first, w = n - line.lag[row], line.weight[row]
    older, newer = (
        lax.dynamic_index_in_dim(commands, jnp.minimum(tick, newest) % R, 0, False) for tick in (first, first + 1)
    )
    return jnp.where(first > newest - R, (1 - w) * older + w * newer, jnp.nan)


def write(commands: Float[Array, "R m"], k: Int[Array, ""], command: Float[Array, " m"]) -> Float[Array, "R m"]:
    """Store the command of tick k in the ring."""
    return lax.dynamic_update_index_in_dim(commands, command, k % commands.shape[0], 0)
