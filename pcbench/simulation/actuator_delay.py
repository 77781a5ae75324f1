"""The actuator line of a closed loop: commands on their way to the plant, kept in a ring, and the inputs they become.

Over tick n the plant is held at the command of the time at which the line is read, the middle of the tick less the delay,
t_n + h/2 - tau(t_n + h/2), by linear interpolation between the commands c of the ticks on both sides:

    u_n = (1 - w_n) c[n - lag_n] + w_n c[n - lag_n + 1]

With no delay at all u_n = c_n. Lags and weights are data, so one compiled program serves every delay. Inputs of the past are
read from the same ring: it has room for what a schedule can ask for, and what is beyond it reads NaN, never another tick's.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from pcbench.protocols import Delay, Leaf


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
