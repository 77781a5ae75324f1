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


class NetworkParams(NamedTuple):
    """Parameters of the network; times in ticks."""

    period_ticks: Leaf  # p, between decisions
    delay: Leaf  # d
    jitter: Leaf
    loss: Leaf  # probability
    std: Leaf  # [m] of a command's noise


class CommandDraws(NamedTuple):
    """The random numbers of one decision."""

    delay: Leaf  # [1] uniform
    loss: Leaf  # [1] uniform
    noise: Leaf  # [m] standard normal


class Commands(NamedTuple):
    """Commands and inputs of a closed loop: R ring rows, P decisions on their way, m inputs."""

    commands: Array  # [R, m] command of tick n in row n mod R
    inputs: Array  # [R, m] input over tick n without noise, in row n mod R
    in_transit: Array  # [P, 2 m + 1] command, noise, arrival tick; decision j in row j mod P
    newest: Array  # tick of the decision in use; -1: none
    noise: Array  # [m] noise of the decision in use


def room(period_ticks: int, delay: int, jitter: int) -> int:
    """Return the largest number of decisions on their way at one time."""
    return (delay + jitter) // period_ticks + 1


def empty(rows: int, slots: int, inputs: int) -> Commands:
    """Return a network on which nothing has been sent."""
    zeros = jnp.zeros((rows, inputs))
    in_transit = jnp.zeros((slots, 2 * inputs + 1)).at[:, -1].set(NEVER)
    return Commands(zeros, zeros, in_transit, jnp.asarray(-1.0), jnp.zeros(inputs))


def command_sampler(p: NetworkParams, root_seed: Array, seeds: Array) -> Callable[[Array], CommandDraws]:
    """Return a function of the tick that draws the numbers [.., L] of its decision, or zeros at ticks without a decision."""
    delay_keys, loss_keys, noise_keys = (
        rng.run_keys(root_seed, seeds, stream, count)
        for stream, count in (("command_jitter", 1), ("command_loss", 1), ("command", p.std.shape[0]))
    )

    def one(k: Array) -> tuple[Array, Array, Array]:
        j = k // p.period_ticks
        return rng.uniform(delay_keys, j), rng.uniform(loss_keys, j), rng.normals(noise_keys, [j for _ in noise_keys])

    def none(k: Array) -> tuple[Array, Array, Array]:
        return tuple(jnp.zeros((count, len(seeds))) for count in (1, 1, len(noise_keys)))  # type: ignore[return-value]

    def sample(k: Array) -> CommandDraws:
        return CommandDraws(*lax.cond(k % p.period_ticks == 0, one, none, k))

    return sample


def send(
    p: NetworkParams, k: Int[Array, ""], commands: Commands, command: Float[Array, " m"], draws: CommandDraws
) -> Commands:
    """Send the command of tick k if there is a decision, and update the input with the newest arrival."""
    m, P, R = command.shape[0], commands.in_transit.shape[0], commands.inputs.shape[0]
    number, decides = k // p.period_ticks, k % p.period_ticks == 0
    arrives = k + p.delay + jnp.floor(draws.delay * (p.jitter + 1))
    arrives = jnp.where(draws.loss < p.loss, NEVER, arrives)
    new = jnp.concatenate([command, p.std * draws.noise, arrives])
    old = lax.dynamic_index_in_dim(commands.in_transit, number % P, 0, False)
    in_transit = lax.dynamic_update_index_in_dim(commands.in_transit, jnp.where(decides, new, old), number % P, 0)
    ticks = (number - (number - jnp.arange(P)) % P) * p.period_ticks * 1.0  # of the decision in each row
    arrived = (in_transit[:, -1] <= k) & (ticks > commands.newest)
    newest = jnp.max(jnp.where(arrived, ticks, commands.newest))
    is_newest = arrived & (ticks == newest)
    has_new = jnp.any(is_newest)
    row = jnp.sum(jnp.where(is_newest[:, None], in_transit[:, :-1], 0.0), 0)
    last = lax.dynamic_index_in_dim(commands.inputs, (k - 1) % R, 0, False)
    u = jnp.where(has_new, row[:m], last)
    return Commands(
        commands=lax.dynamic_update_index_in_dim(commands.commands, command, k % R, 0),
        inputs=lax.dynamic_update_index_in_dim(commands.inputs, u, k % R, 0),
        in_transit=in_transit,
        newest=newest,
        noise=jnp.where(has_new, row[m:], commands.noise),
    )


def input_at(commands: Commands, n: Int[Array, ""], newest: Int[Array, ""]) -> Float[Array, " m"]:
    """Return the noise-free input over tick n; NaN for a tick outside the ring."""
    R = commands.inputs.shape[0]
    row = lax.dynamic_index_in_dim(commands.inputs, jnp.minimum(n, newest) % R, 0, False)
    return jnp.where(n > newest - R, row, jnp.nan)


class DelayLine(NamedTuple):
    """An actuator delay: the position read from the ring, one row per tick from -R on, R ring rows; empty for an open loop."""

    lag: Leaf  # [R + N + 1 + ahead] ticks
    weight: Leaf  # [R + N + 1 + ahead] 0 .. 1


NO_DELAY_LINE = DelayLine(np.zeros(0, int), np.zeros(0))


def delay_line(delay: Delay, dt: float, rows: int, ticks: int) -> DelayLine:
    """Return the `DelayLine` of a delay of time [s], 0 or at least half a tick, for ticks -`rows` .. `ticks`."""
    n = np.arange(-rows, ticks + 1)
    delay_ticks = delay((n + 0.5) * dt) / dt
    position = n + 0.5 - delay_ticks
    lower = np.floor(position).astype(int)
    undelayed = delay_ticks == 0
    return DelayLine(np.where(undelayed, 1, n - lower), np.where(undelayed, 1.0, position - lower))


def constant_delay_line(lag: int, rows: int, ticks: int) -> DelayLine:
    """Return the `DelayLine` whose input is the command of `lag` ticks earlier, for ticks -`rows` .. `ticks`."""
    count = rows + ticks + 1
    return DelayLine(np.full(count, max(lag, 1)), np.full(count, float(lag == 0)))


def rows_needed(delay: Delay, dt: float, ticks: int, oldest: int) -> int:
    """Return the number of ring rows needed to read inputs up to `oldest` ticks old."""
    return oldest + int(delay_line(delay, dt, 0, ticks).lag.max()) + 2


def delayed_command(
    line: DelayLine, commands: Float[Array, "R m"], n: Int[Array, ""], newest: Int[Array, ""]
) -> Float[Array, " m"]:
    """Return the input over tick n from commands up to tick `newest`; a later tick reads the newest command."""
    R = commands.shape[0]
    row = jnp.clip(n + R, 0, line.lag.shape[0] - 1)
    first, w = n - line.lag[row], line.weight[row]

    def command_of(tick: Array) -> Array:
        return lax.dynamic_index_in_dim(commands, jnp.minimum(tick, newest) % R, 0, False)

    older, newer = command_of(first), command_of(first + 1)
    return jnp.where(first > newest - R, (1 - w) * older + w * newer, jnp.nan)


def write(commands: Float[Array, "R m"], k: Int[Array, ""], command: Float[Array, " m"]) -> Float[Array, "R m"]:
    """Store the command of tick k in the ring."""
    return lax.dynamic_update_index_in_dim(commands, command, k % commands.shape[0], 0)
