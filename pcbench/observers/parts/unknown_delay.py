"""Shared parts of filters that estimate the delay: a linear model, tick by tick, and the prior of the delay.

The mean delay tau of the first channel is unknown. Timestamps show how much later one sample is than another: an arrival at
tick k with the assumed age a, where abar is the assumed mean age of the first channel, was taken at

    k - (a - abar) - tau / h,

so the filters estimate a constant error of all timestamps. Ages may vary, samples may be lost or out-of-sequence, and channels
may have their own clocks. With `stamps = false` ages are not read: all samples are delayed by tau, and the variation about it
is noise that the filter does not model. The prior of tau is N(m, s^2), cut off at 0 and at `longest`. It is the unknown of the
plant if that is a delay (`unknown0`, `unknown_std`), otherwise the assumed delay and half of it. The model is propagated again
from the time of a sample to the present under the stored inputs.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int, PyTree
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers.parts import assumed_noise
from pcbench.protocols import Arrival, Leaf, Now, Room
from pcbench.synthesis.certificate import DesignContext

MAX_TICKS = 2000  # ticks of the longest delay; every arrival propagates over it


class Gains(NamedTuple):
    """n states, m inputs, q outputs; `extra` contains the parameters of one observer of the family."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    Q: Float[Leaf, "n n"]  # a tick's process noise
    C: Float[Leaf, "q n"]
    R: Float[Leaf, " q"]
    P0: Float[Leaf, "n n"]
    delay: Leaf  # [s] prior mean
    delay_std: Leaf  # [s] prior standard deviation
    dt: Leaf  # [s]
    longest: Leaf  # [ticks] longest possible delay
    mean: Leaf  # [ticks] assumed mean age of the first channel's samples
    later: Leaf  # [ticks] largest excess of an age over `mean`
    stamps: Leaf  # 1: differences between timestamps are used; 0: they are not
    room: Room  # for samples that may arrive after newer ones
    estimated: Room  # [1] the delay is one of the estimated signals; [0]: it is not
    extra: PyTree = ()


class Options(assumed_noise.Options):
    """Assumed noise, and the prior of the delay."""

    delay: float | None = Field(None, ge=0, description="prior mean of the delay [s]; default: that of the scenario")
    delay_std: float | None = Field(
        None, gt=0, description="prior standard deviation of the delay [s]; default: that of the scenario"
    )
    longest: float | None = Field(
        None, gt=0, description="longest delay [s]; default: the mean plus three standard deviations"
    )
    stamps: bool = Field(True, description="use the differences between timestamps; false: use no timestamps")


def expected_arrival_tick(gains: Gains, now: Now, arrival: Arrival) -> Int[Array, ""]:
    """Return the tick at which a sample that arrives now would have arrived with the assumed mean delay.

    No timestamp is below 0, so a sample with timestamp 0 may have been taken earlier. It counts as delayed by the mean, but
    as arriving at the present tick at the latest.
    """
    age = jnp.max(jnp.where(arrival.mask, arrival.age, 0))  # channels that arrive together were sampled together
    by_timestamp = jnp.where(age < now.tick, now.tick - age + gains.mean, jnp.minimum(now.tick, gains.mean))
    return jnp.where(gains.stamps, by_timestamp, now.tick)


def predict_linear(
    Phi: Array, Gamma: Array, Q: Array, now: Now, x: Array, P: Array, start: Array, stop: Array
) -> tuple[Array, Array]:
    """Return mean and covariance at tick `stop` from those at tick `start`, by a linear model and the stored inputs."""

    def tick(k: Array, xP: tuple[Array, Array]) -> tuple[Array, Array]:
        x, P = xP
        return Phi @ x + Gamma @ now.past_u(now.tick - k), Phi @ P @ Phi.T + Q

    return lax.fori_loop(start, stop, tick, (x, P))


def design(context: DesignContext, options: Options, name: str) -> Gains:
    """Return the assumptions.

    Raises UserError for a plant with feedthrough or an unknown input, for a delay that is too long, and for channels with
    different delays if the timestamps are not used.
    """
    where, model, dt = f"{name} in {context.scenario}", context.model, context.dt
    if model.E is not None or np.any(model.feedthrough):
        raise UserError(
            f"{where}: got a plant with {'an unknown input' if model.E is not None else 'feedthrough D'}, expected "
            f"x' = A x + B u, y = C x, in which only the delay is unknown; leave {name} out, or use kf."
        )
    if not options.stamps and len(set(context.delay)) > 1:
        delays = ", ".join(f"{d * dt:g}" for d in context.delay)
        raise UserError(
            f"{where}: got stamps = false with delays of {delays} s, expected one for all channels, "
            "because it then assumes equal delays; leave stamps out, or give one delay."
        )
    is_unknown = len(context.unknown_std) == 1
    mean = context.unknown0[0] if is_unknown else context.delay[0] * dt
    mean = mean if options.delay is None else options.delay
    std = options.delay_std or (context.unknown_std[0] if is_unknown else max(0.5 * mean, dt))
    longest = round((options.longest or mean + 3 * std) / dt)
    if not 1 <= longest <= min(MAX_TICKS, context.ticks):
        limit = min(MAX_TICKS, context.ticks) * dt
        raise UserError(
            f"{where}: got a longest delay of {longest * dt:g} s, expected a tick, {dt:g} s, to {limit:g} s, "
            "over which every arrival propagates; write longest, or use a longer tick."
        )
    Phi, Gamma = linear.one_tick(model, dt)
    q = assumed_noise.input_intensity(options.q, model.B.shape[1], context.input_intensity, where)
    Q = linear.input_noise(model, q, dt, np.zeros(0)) + assumed_noise.process_covariance(context, options.Q, where)
    mix, C, R = assumed_noise.decorrelate_outputs(context, options.R, model.C, where)
    if mix is not None:
        raise UserError(f"{where}: R: got noise that is correlated between outputs, expected a number for each.")
    return Gains(
        Phi=Phi,
        Gamma=Gamma,
        Q=Q,
        C=C,
        R=R,
        P0=context.P0,
        delay=np.asarray(float(mean)),
        delay_std=np.asarray(float(std)),
        dt=np.asarray(dt),
        longest=np.asarray(longest),
        mean=np.asarray(context.delay[0]),
        later=np.asarray(max(context.latest - context.delay[0], 0) if options.stamps else 0),
        stamps=np.asarray(int(options.stamps)),
        room=context.room if options.stamps else np.zeros(0),
        estimated=np.zeros(int(is_unknown)),
    )


def signals_of(gains: Gains, xhat: Array, delay: Array) -> Array:
    """Return the estimated signals: the state, and the delay [s] if it is the plant's unknown."""
    return jnp.append(xhat, delay) if gains.estimated.shape[0] else xhat


def signal_covariance(gains: Gains, P: Float[Array, "N N"]) -> Array:
    """Return the covariance of the estimated signals from that of state and delay."""
    n = gains.C.shape[1] + gains.estimated.shape[0]
    return P[:n, :n]
