"""Cascade predictors: a chain of observers, each a part of the delay ahead of the one before.

With m links over d_1 + .. + d_m = delay, link j estimates the state of lag_j = d_(j+1) + .. + d_m ago:

    x_j' = A x_j + B u(t - lag_j) - K (C x_j(t - d_j) - y_j(t)),   y_1 the delayed output,  y_j = C x_(j-1)

and the last link estimates the present. The error of a single predictor decays for a limited delay only, for x' = a x with
a d < 1. With links, this holds for each d_j. More links allow longer delays; they do not make the error decay faster.
Here a tick is exact under the held input, x_j(k+1) = Phi x_j(k) + Gamma u(k - lag_j) - K (..), with the gains of
`synthesis.cascade`. Between samples the output of `delay` ago is predicted,
y_1(k+1) = y_1(k) + C (Phi - I) x_1(k - d_1) + C Gamma u(k - delay), and a sample that arrives sets it.

Source: Germani, Manes, Pepe, IEEE TAC 47(1), 2002, for continuous measurement. The choice of the gain, the output
between samples and the tick are this project's. Linear plants only.
Schedule: one constant delay, as each link has a fixed length; sampling intervals may vary, and a lost sample is predicted.
The certificate is for the mean period. Time index: the estimate is of the present; what arrives at tick k corrects it from tick
k + 1 on. A link stays at xhat(0) until tick lag_j. Not claimed: that it filters noise well.
"""

from math import exp
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers.parts.common import known_input, no_snapshot
from pcbench.observers.parts.options import StrictOptions
from pcbench.observers.parts.sample_rate import read, ring, write
from pcbench.protocols import Arrival, Leaf, Now, Observer, Room
from pcbench.synthesis import cascade
from pcbench.synthesis.certificate import Design, DesignContext, one_clock, power_of_2
from pcbench.synthesis.error_bounds import rate_of


class Gains(NamedTuple):
    """j links, n states, m inputs, q outputs."""

    Phi: Float[Leaf, "n n"]  # one tick
    Gamma: Float[Leaf, "n m"]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    K: Float[Leaf, "n q"]
    d: Int[Leaf, " j"]  # [ticks] of each link
    lag: Int[Leaf, " j"]  # [ticks] of each link's estimate behind the present
    delay: Int[Leaf, ""]  # [ticks]
    room: Room  # for the ticks of the longest link


class Memory(NamedTuple):
    """The links' states and their past; the output of `delay` ago."""

    x: Float[Array, "j n"]
    y: Float[Array, " q"]
    past: Float[Array, "rows j n"]
    tick: Int[Array, ""]


class Options(StrictOptions):
    """The number of links and their bandwidth."""

    links: int | None = Field(None, ge=1, le=64, description="number of links; default: the least that is certified")
    omega: float | None = Field(
        None,
        gt=0,
        description="bandwidth of a link without its delay [1/s]; default: 1 / max(3 d, 1.5 T), d its part of the delay",
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Start every link from xhat(0), as if its output had been measured."""
    x = jnp.broadcast_to(xhat0, (gains.d.shape[0], xhat0.shape[0]))
    return Memory(x, gains.C @ xhat0, ring(gains.room, x), jnp.asarray(0))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Take what arrived for the output of `delay` ago."""
    y = arrival.value - known_input(gains.D, now, arrival.age)
    return memory._replace(y=jnp.where(arrival.mask, y, memory.y))


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Move every link by one tick, and predict the output."""
    C, k, many = gains.C, memory.tick, gains.d.shape[0]
    past = write(memory.past, k, memory.x, jnp.asarray(True))
    moved, y, compared = [], memory.y, memory.y
    for j in range(many):
        old, then = read(past, k - gains.d[j])[j], now.past_u(gains.lag[j])
        x = gains.Phi @ memory.x[j] + gains.Gamma @ then + gains.K @ (compared - C @ old)
        moved.append(jnp.where(k >= gains.lag[j], x, memory.x[j]))
        compared = C @ memory.x[j]
        if j == 0:
            ahead = C @ (gains.Phi @ old + gains.Gamma @ now.past_u(gains.delay) - old)
            y = jnp.where(k >= gains.delay, y + ahead, y)
    return Memory(jnp.stack(moved), y, past, k + 1)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return the last link's estimate, of the present."""
    return memory.x[gains.d.shape[0] - 1]


OBSERVER = Observer(init, no_snapshot, jump, flow, estimate)


def design(setting: DesignContext, options: Options) -> Design:
    """Divide the delay, place the poles of each link, and certify the maps of their errors."""
    where, period, delay = (
        f"cascade-predictor in {setting.scenario}",
        one_clock(setting, "cascade-predictor"),
        setting.delay[0],
    )
    if options.links is not None and options.links > max(delay, 1):
        raise UserError(
            f"{where}: got links = {options.links}, expected at most {max(delay, 1)}, one per tick of the delay; give fewer."
        )
    Phi, Gamma = linear.one_tick(setting.model, setting.dt)
    decay = None if options.omega is None else exp(-options.omega * setting.dt)
    links, certificate = cascade.design(Phi, setting.model.C, delay, period, options.links, decay, where)
    d = np.array(links.d)
    gains = Gains(
        Phi=Phi,
        Gamma=Gamma,
        C=setting.model.C,
        D=setting.model.feedthrough,
        K=links.K,
        d=d,
        lag=delay - np.cumsum(d),
        delay=np.asarray(delay),
        room=np.zeros(power_of_2(max(setting.reach * period, int(d.max())))),  # one size for all delays of a study
    )
    return Design(gains, certificate._replace(rate=rate_of(1 - certificate.margin, period * setting.dt)))
