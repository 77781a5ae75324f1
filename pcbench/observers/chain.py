"""chain: chain observer for unequal measurement delays, which uses each sensor's samples as soon as they arrive.

With theta_1 < ... < theta_q the distinct delays in samples, link i propagates an estimate over d_i samples, from its source s
= k - theta_i to its stamp t = k - theta_(i-1). The first link starts at the longest delay, and the last one ends at the
present:

    ybar_i(s)[j] = y_j(s) where tau_j <= theta_i, else yhat_(i+1)(s)[j]
    xhat_i(t) = F_i xhat_i(s) + K_i ybar_i(s) + response to the known input                  (26), F = inv(T) G T, K = inv(T) L
    yhat_i(t) = W_i xhat_i(s) + V_i ybar_i(s) + response to the known input                  (27)

The code subtracts the response to the known input (`parts/sample_rate`): z = xhat - xbar, and y - D u - C xbar. This is the
same observer. Before a link's first source (s < 0), its estimate is the model's. A lost sample is replaced by C xhat_i(s), so
it causes no correction.
Delays are arrays, so they may be equal, zero and in any order, and delay vectors may be an axis of a study. At least one
delay must be positive.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorem 3. Different from print: T = I; Q_0 = D, and V D is subtracted from
Q_d.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: noise filtering with the printed poles.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import sample_rate
from pcbench.observers.parts.common import known_input
from pcbench.observers.parts.options import StrictOptions, method_option, tunable
from pcbench.observers.parts.sample_rate import ModelRun, Pole, SampledModel, at_sample, ring, write
from pcbench.protocols import Arrival, Leaf, Now, Observer, Room
from pcbench.synthesis import chain
from pcbench.synthesis.certificate import Design, DesignContext, require_certified
from pcbench.synthesis.error_bounds import rate_of
from pcbench.synthesis.sampled_model import sample_plant


class Links(NamedTuple):
    """One link, or all q of them on a leading axis, with the longest delay first; n states, q outputs."""

    stamp: Int[Leaf, "..."]  # samples ago
    source: Int[Leaf, "..."]
    has_arrived: Float[Leaf, "... q"]  # 1 for a channel whose sample of the source has arrived, else 0
    F: Float[Leaf, "... n n"]
    K: Float[Leaf, "... n q"]
    V: Float[Leaf, "... q q"]
    W: Float[Leaf, "... q n"]


class Gains(NamedTuple):
    """n states, q outputs."""

    model: SampledModel
    tau: Int[Leaf, " q"]  # samples
    links: Links
    room: Room  # for the samples of the longest delay of the study


class Memory(NamedTuple):
    """Deviations from the model without measurements."""

    run: ModelRun
    past: Float[Array, "ring n"]  # the links' estimates, by sample number
    residuals: tuple[Float[Array, " ring"], ...]  # [q] y - D u - C xbar of each channel, by sample number
    has_arrived: tuple[Bool[Array, " ring"], ...]  # [q] whether it has arrived, by sample number
    value: Float[Array, " q"]  # y - D u - C xbar of the samples that have arrived since the last sampling tick
    mask: Bool[Array, " q"]


class Options(StrictOptions):
    """Design of the links' gains and outputs."""

    gain: Literal["poles", "companion", "riccati"] = method_option(
        "poles",
        description="gain of each link: pole placement, the companion form of the source, or a Riccati equation",
    )
    pole: Pole = tunable(1e-4, (-1, 1), description="pole of each link over its delay; no effect on riccati")
    pole_per_tick: Pole | None = Field(None, description="pole per sample, instead of `pole`")
    output: Literal["updated", "deadbeat"] = Field(
        "updated", description="predicted output of a link: from its corrected estimate, or with V = C A^d pinv(C)"
    )
    q: float | None = tunable(None, ge=0, description="riccati: additional process noise through the input [1/s]")
    shared: bool = Field(
        False, description="search for a common Lyapunov matrix of all links too (condition (29) of the source)"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), before the first sample."""
    (q, n), room = gains.model.C.shape, gains.room
    residuals = (ring(room, jnp.zeros(())),) * q
    has_arrived = (ring(room, jnp.asarray(False)),) * q
    past = ring(room, jnp.zeros(n))
    return Memory(sample_rate.start(xhat0), past, residuals, has_arrived, jnp.zeros(q), jnp.zeros(q, bool))


def snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, " q"]:
    """Return the model's prediction of the sample, C xbar."""
    return gains.model.C @ memory.run.xbar


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Store the arriving sample, minus D u and C xbar."""
    y = arrival.value - known_input(gains.model.D, now, arrival.age) - arrival.snapshot
    return memory._replace(value=jnp.where(arrival.mask, y, memory.value), mask=memory.mask | arrival.mask)


def links(gains: Gains, memory: Memory) -> Float[Array, "q n"]:
    """Return the estimate at the stamp of each link [q, n], longest delay first, from all samples that have arrived."""
    k, C, channels = memory.run.sample, gains.model.C, range(gains.model.C.shape[0])

    def link(previous: tuple[Array, Array], params: Links) -> tuple[tuple[Array, Array], Array]:
        nonempty = params.source > params.stamp  # a link over no samples passes its inputs on
        z = at_sample(memory.past, k - params.source)
        expected = C @ z
        y = jnp.stack([_sample(gains, memory, j, params.source, expected[j]) for j in channels])
        ybar = jnp.where(params.has_arrived > 0, y, previous[1])
        estimate = jnp.where(nonempty, params.F @ z + params.K @ ybar, previous[0])
        yhat = jnp.where(nonempty, params.W @ z + params.V @ ybar, previous[1])
        return (estimate, yhat), estimate

    return lax.scan(link, (jnp.zeros(C.shape[1]), jnp.zeros(C.shape[0])), gains.links)[1]


def _sample(gains: Gains, memory: Memory, j: int, age: Int[Array, ""], expected: Float[Array, ""]) -> Float[Array, ""]:
    """Return channel j's reduced sample of `age` samples ago, or `expected` if it has not arrived."""
    sample, is_newest = memory.run.sample - age, age == gains.tau[j]
    has_arrived = jnp.where(is_newest, memory.mask[j], at_sample(memory.has_arrived[j], sample)) & (sample >= 0)
    value = jnp.where(is_newest, memory.value[j], at_sample(memory.residuals[j], sample))
    return jnp.where(has_arrived, value, expected)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick; at a sampling tick, store the samples that have arrived."""
    run, is_sample = sample_rate.flow(gains.model, memory.run, now)
    k, past = memory.run.sample, memory.past
    stamp, source = gains.links.stamp, gains.links.source
    for i, estimate in enumerate(links(gains, memory)):
        past = write(past, k - stamp[i], estimate, is_sample & (source[i] > stamp[i]))
    channels = range(len(memory.residuals))
    return Memory(
        run,
        past,
        tuple(write(memory.residuals[j], k - gains.tau[j], memory.value[j], is_sample) for j in channels),
        tuple(write(memory.has_arrived[j], k - gains.tau[j], memory.mask[j], is_sample) for j in channels),
        memory.value,
        memory.mask & ~is_sample,
    )


def estimate(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return the last link's estimate, propagated to the present."""
    return memory.run.xbar + memory.run.transition @ links(gains, memory)[-1]


OBSERVER = Observer(init, snapshot, jump, flow, estimate)


def design(context: DesignContext, options: Options) -> Design:
    """Return the gains of all links, with a certified map of one sample; raise UserError without a delay."""
    where, plant = f"chain in {context.scenario}", sample_plant(context, "chain", options.q)
    if max(plant.tau) == 0:
        raise UserError(
            f"{where}: got an assumed delay of 0 in every channel, expected one above 0: without delays there is nothing "
            "to chain; use kf or pccebo."
        )
    per_sample = options.pole_per_tick is not None
    pole = options.pole if options.pole_per_tick is None else options.pole_per_tick
    link_list = chain.links(plant, options.gain, pole, per_sample, options.output, where)
    certificate = require_certified(chain.certify(link_list, plant.C, options.gain), where)
    certificate = certificate._replace(rate=rate_of(1 - certificate.margin, plant.period * context.dt))
    if options.shared:
        extra = chain.check(link_list, plant.scale)
        certificate = certificate._replace(numbers=dict(certificate.numbers) | extra)
    latest_first, theta = link_list[::-1], np.array(chain.ages(plant.tau)[::-1])
    matrices = {
        name: np.stack([getattr(link, name) for link in latest_first]) for name in ("has_arrived", "F", "K", "V", "W")
    }
    links = Links(stamp=theta[1:], source=theta[:-1], **matrices)
    room = np.zeros(max(context.reach, *plant.tau))
    return Design(Gains(sample_rate.model_of(context), np.array(plant.tau), links, room), certificate)
