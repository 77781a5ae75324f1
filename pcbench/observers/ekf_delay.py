"""ekf-delay: an extended Kalman filter that has the delay of its samples as one more state.

z = (x, tau), x the state as many ticks ago as the longest delay of the oldest sample, L: at tick b = k - L when a sample
arrives at tick k. Then a sample's time lies ahead of b whatever tau is, and no motion is undone (a cart that brakes at 122 1/s
grows e^24 times in 0.2 s backwards). With x_i the prediction of tick i from x_b, i = k - (a - abar) - tau / h (a: the sample's
age, `parts/unknown_delay`) between whole ticks by a straight line,

    y = C x_i + v,   H = [C F_i, -C x'_i],   x'_i = (x_(i+1) - x_i) / h,   F_i the slope of x_i by x_b

one update in Joseph's form, channel by channel, at the predicted z; tau is kept within [0, L h] and walks with `delay_walk`.
Then x_b is carried to now. Before L ticks have passed b = 0.

Findings, on cart/unknown-delay (guide, unknown_delay): begun near, it is as good as the bound allows, and honest; that it is
always biased and optimistic (arXiv:2106.00391, arXiv:2605.13266) does not hold there. Begun two of its deviations off it is
both: the first samples are used at slopes of the wrong time, and the error that they leave stays. `mmae-delay` is not.
Not claimed: that the delay is found from far; where the motion does not show it (x' = 0) nothing is learnt. The process noise
between b and a sample's time is not counted, so with much of it the filter is optimistic.
Time index: the estimate is of now, after the jump. Samples of any age and in any order: each lies ahead of b.
Source: Nilsson, Skog, Haendel, Joint state and measurement time-delay estimation of nonlinear state space systems, ISSPA 2010.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.observers.parts import kalman, unknown_delay
from pcbench.observers.parts.common import no_snapshot
from pcbench.observers.parts.unknown_delay import Gains, predict_linear, read, spread
from pcbench.protocols import Arrival, Leaf, Now, Observer, vmap_as_unit
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate


class Memory(NamedTuple):
    """State and delay of `at`, and the estimate of now."""

    z: Float[Array, " n+1"]
    P: Float[Array, "n+1 n+1"]
    at: Int[Array, ""]  # tick
    xhat: Float[Array, " n"]


class Options(unknown_delay.Options):
    """What the filter assumes."""

    delay_walk: float = Field(0.0, ge=0, description="variance of the random walk of the delay per second [s^2/s]")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Start from the prior."""
    n = xhat0.shape[0]
    P = jnp.zeros((n + 1, n + 1)).at[:n, :n].set(gains.P0).at[n, n].set(gains.delay_std**2)
    return Memory(jnp.append(xhat0, gains.delay), P, jnp.asarray(0), xhat0)


def joint(gains: Gains) -> tuple[Array, Array, Array]:
    """Return Phi, Gamma and Q of state and delay, which stands still but for its walk."""
    n, m = gains.Gamma.shape

    def beside(A: Leaf, last: Leaf) -> Array:
        return jnp.zeros((n + 1, n + 1)).at[:n, :n].set(A).at[n, n].set(last)

    Gamma = jnp.concatenate([gains.Gamma, jnp.zeros((1, m))])
    return beside(gains.Phi, 1.0), Gamma, beside(gains.Q, gains.own)


class SamplePrediction(NamedTuple):
    """The tick of a sample and the next, as predicted from the base, and their slopes by it."""

    x: Float[Array, " n"]
    F: Float[Array, "n n"]
    before: tuple[Array, Array]  # x, F of the tick at or before the sample's time
    after: tuple[Array, Array]  # and of the next


def predict_sample(gains: Gains, now: Now, x: Array, base: Array, first: Array) -> SamplePrediction:
    """Return what the model says of ticks `first` and `first` + 1, and of now, from the state at `base`."""

    def tick(k: Array, c: SamplePrediction) -> SamplePrediction:
        here = c.x, c.F
        before = tuple(jnp.where(k == first, a, b) for a, b in zip(here, c.before, strict=True))
        x, F = gains.Phi @ c.x + gains.Gamma @ now.past_u(now.tick - k), gains.Phi @ c.F
        after = tuple(jnp.where(k == first, a, b) for a, b in zip((x, F), c.after, strict=True))
        return SamplePrediction(x, F, before, after)  # type: ignore[arg-type]

    here = x, jnp.eye(x.shape[0])
    return lax.fori_loop(base, now.tick, tick, SamplePrediction(*here, here, here))


def _update_at_sample(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Carry state and delay to the base, update there by a sample between ticks, and go to now."""
    base, n = jnp.maximum(now.tick - gains.longest - gains.later, 0), gains.C.shape[1]
    z, P = predict_linear(*joint(gains), now, memory.z, memory.P, memory.at, base)
    place = jnp.clip(unknown_delay.due(gains, now, arrival) - z[n] / gains.dt, base, now.tick)
    first = jnp.clip(jnp.floor(place), base, jnp.maximum(now.tick - 1, base)).astype(int)
    part, seen = place - first, predict_sample(gains, now, z[:n], base, first)
    (xa, Fa), (xb, Fb) = seen.before, seen.after
    H = jnp.concatenate([gains.C @ ((1 - part) * Fa + part * Fb), -(gains.C @ (xb - xa) / gains.dt)[:, None]], 1)
    y, start = gains.C @ ((1 - part) * xa + part * xb), z
    for channel in range(gains.C.shape[0]):
        c, r, mask = H[channel], gains.R[channel], arrival.mask[channel]
        nu = arrival.value[channel] - y[channel] - c @ (z - start)
        K = kalman.gain(P @ c, c @ P @ c + r, mask)
        z, P = z + jnp.where(mask, K * nu, 0.0), kalman.covariance(P, K, c, r)
    z = z.at[n].set(jnp.clip(z[n], 0.0, gains.longest * gains.dt))
    return Memory(z, P, base, seen.x + seen.F @ (z[:n] - start[:n]))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Update state and delay by what arrives, and go to now."""
    return vmap_as_unit(lambda memory, arrival: _update_at_sample(gains, memory, now, arrival))(memory, arrival)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Move the estimate of now by one tick."""
    return memory._replace(xhat=gains.Phi @ memory.xhat + gains.Gamma @ now.u)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " signals"]:
    """Return xhat of now, and the delay where the plant has one that is unknown."""
    return read(gains, memory.xhat, memory.z[-1])


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the covariance that is assumed of the error now: P at its base, carried on."""

    def present(z: Array, P: Array, at: Array) -> Array:
        return spread(gains, predict_linear(*joint(gains), now, z, P, at, now.tick)[1])

    return vmap_as_unit(present)(memory.z, memory.P, memory.at)


def delay(gains: Gains, memory: Memory, now: Now) -> Float[Array, "2"]:
    """Return the mean delay and its standard deviation [s]: the last state, which does not move between samples."""
    walked = gains.own * (now.tick - memory.at)
    return jnp.stack([memory.z[-1], jnp.sqrt(memory.P[-1, -1] + walked)])


OBSERVER = Observer(init, no_snapshot, jump, flow, estimate, covariance=covariance, delay=delay)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; a delay among the states makes it nonlinear, and nothing proves it."""
    gains = unknown_delay.design(setting, options, "ekf-delay")
    walk = np.asarray(options.delay_walk * setting.dt)
    return Design(gains._replace(own=walk), no_certificate("the delay is a state, so the filter is nonlinear"))
