"""cascade-predictor: chain of observers, in which each link predicts over a part of the delay.

With m links over the delay d_1 + .. + d_m, link j estimates the state at a lag of lag_j = d_(j+1) + .. + d_m, and the last
link estimates the present:

    x_j' = A x_j + B u(t - lag_j) - K (C x_j(t - d_j) - y_j(t)),   y_1 the delayed output,  y_j = C x_(j-1)

The error of a single predictor decays only for a limited delay; for x' = a x this requires a d < 1. With links, the limit
applies to each d_j. More links allow longer delays, but do not make the error decay faster.

- A tick is exact for a held input: x_j(k+1) = Phi x_j(k) + Gamma u(k - lag_j) - K (..), with the gains of
  `synthesis.cascade`.
- Between samples the delayed output is predicted, y_1(k+1) = y_1(k) + C (Phi - I) x_1(k - d_1) + C Gamma u(k - delay). A
  sample that arrives replaces it.
- On a nonlinear plant, each link uses the plant's own tick instead of Phi x + Gamma u, and the gains are those of the linear
  model.

Source: Germani, Manes, Pepe, IEEE TAC 47(1), 2002, for continuous measurement and nonlinear plants. The choice of the gain,
the output between samples and the discretisation are this project's. Outputs must be linear in the state.
Schedule: one constant delay, because each link has a fixed length. Sampling intervals may vary, and a lost sample is
predicted. The certificate is for the mean period. There is none for a nonlinear plant.
Time index: xhat is the estimate of the present. A sample that arrives at tick k corrects it from tick k + 1 on. A link stays
at xhat(0) until tick lag_j.
Not claimed: noise filtering.
"""

from math import exp
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers.parts import nonlinear_model
from pcbench.observers.parts.common import known_input, no_snapshot
from pcbench.observers.parts.options import StrictOptions
from pcbench.observers.parts.sample_rate import at_sample, ring, write
from pcbench.protocols import Arrival, Leaf, Now, Observer, Room
from pcbench.synthesis import cascade
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate, one_clock, power_of_2
from pcbench.synthesis.error_bounds import rate_of


class Gains(NamedTuple):
    """j links, n states, m inputs, q outputs."""

    Phi: Float[Leaf, "n n"]  # one tick
    Gamma: Float[Leaf, "n m"]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    K: Float[Leaf, "n q"]
    d: Int[Leaf, " j"]  # [ticks] of each link
    lag: Int[Leaf, " j"]  # [ticks] lag of each link's estimate
    delay: Int[Leaf, ""]  # [ticks]
    room: Room  # for the ticks of the longest link
    motion: Any = None  # (now, (x, p)) -> (x, p) one tick later, for a nonlinear plant
    unknowns: Float[Leaf, " s"] = np.zeros(0)  # p, assumed constant


class Memory(NamedTuple):
    """States of the links with their past, and the output `delay` ticks ago."""

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
    """Return the memory with every link at xhat(0), as if its output had been measured."""
    x = jnp.broadcast_to(xhat0, (gains.d.shape[0], xhat0.shape[0]))
    return Memory(x, gains.C @ xhat0, ring(gains.room, x), jnp.asarray(0))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Replace the predicted output of `delay` ticks ago by the arriving sample."""
    y = arrival.value - known_input(gains.D, now, arrival.age)
    return memory._replace(y=jnp.where(arrival.mask, y, memory.y))


def next_state(gains: Gains, now: Now, x: Float[Array, " n"], lag: Int[Array, ""]) -> Float[Array, " n"]:
    """Return the state at tick k + 1 - `lag` from that at k - `lag`, where k is the present tick."""
    if gains.motion is None:
        return gains.Phi @ x + gains.Gamma @ now.past_u(lag)
    past = nonlinear_model.now_at(now, now.tick - lag)
    return gains.motion(past, jnp.concatenate([x, gains.unknowns]))[: x.shape[0]]


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance every link by one tick, and predict the delayed output."""
    C, k, n_links = gains.C, memory.tick, gains.d.shape[0]
    past = write(memory.past, k, memory.x, jnp.asarray(True))
    links, y, reference = [], memory.y, memory.y
    for j in range(n_links):
        previous = at_sample(past, k - gains.d[j])[j]
        x = next_state(gains, now, memory.x[j], gains.lag[j]) + gains.K @ (reference - C @ previous)
        links.append(jnp.where(k >= gains.lag[j], x, memory.x[j]))
        reference = C @ memory.x[j]
        if j == 0:
            change = C @ (next_state(gains, now, previous, gains.delay) - previous)
            y = jnp.where(k >= gains.delay, y + change, y)
    return Memory(jnp.stack(links), y, past, k + 1)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return the estimate of the last link, which is that of the present."""
    return memory.x[gains.d.shape[0] - 1]


OBSERVER = Observer(init, no_snapshot, jump, flow, estimate)


def design(context: DesignContext, options: Options) -> Design:
    """Divide the delay, place the poles of each link, and certify the error maps."""
    where, delay = f"cascade-predictor in {context.scenario}", context.delay[0]
    period = one_clock(context, "cascade-predictor")
    if options.links is not None and options.links > max(delay, 1):
        raise UserError(
            f"{where}: got links = {options.links}, expected at most {max(delay, 1)}, one per tick of the delay; give fewer."
        )
    if context.sensor is not None or context.residual is not None:
        raise UserError(f"{where}: got a nonlinear output, expected one that is linear in the state; use ekf.")
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    is_nonlinear = context.field is not None or context.successor is not None
    decay = None if options.omega is None else exp(-options.omega * context.dt)
    links, certificate = cascade.design(Phi, context.model.C, delay, period, options.links, decay, where)
    d = np.array(links.d)
    gains = Gains(
        Phi=Phi,
        Gamma=Gamma,
        C=context.model.C,
        D=context.model.feedthrough,
        K=links.K,
        d=d,
        lag=delay - np.cumsum(d),
        delay=np.asarray(delay),
        room=np.zeros(power_of_2(max(context.reach * period, int(d.max())))),  # one size for all delays of a study
        motion=nonlinear_model.motion_of(context)[0] if is_nonlinear else None,
        unknowns=np.array(context.unknown0, float) if is_nonlinear else np.zeros(0),
    )
    if is_nonlinear:
        reason = "the plant is nonlinear; the maps are of its linear model"
        return Design(gains, no_certificate(reason)._replace(numbers=certificate.numbers))
    return Design(gains, certificate._replace(rate=rate_of(1 - certificate.margin, period * context.dt)))
