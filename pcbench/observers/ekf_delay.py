"""ekf-delay: extended Kalman filter with the delay of the samples as an additional state.

The state is z = (x, tau). x is the plant's state at tick b = k - L, where k is the tick of the arrival and L is the longest
possible age of a sample. So the sampling time is after b for every tau, and the filter never integrates backwards. (A cart
that brakes at 122 1/s would grow by e^24 in 0.2 s backwards.) Let x_i be the prediction from x_b to i = k - (a - abar) - tau
/ h, with the age a of the sample (`parts/unknown_delay`), linearly interpolated between ticks:

    y = C x_i + v,   H = [C F_i, -C x'_i],   x'_i = (x_(i+1) - x_i) / h,   F_i = dx_i / dx_b

One update in Joseph form, channel by channel, uses this H at the predicted z. tau is clipped to [0, L h] and is a random walk
of variance `delay_walk`. Then x_b is predicted to the present. Before tick L, b = 0.

Properties on cart/unknown-delay (see the guide, unknown_delay):

- From an accurate initial delay, the error is as small as the bound allows, and the covariance is consistent. The literature
  describes such filters as always biased and optimistic (arXiv:2106.00391, arXiv:2605.13266); that is not so here.
- From an initial delay two standard deviations off, it is biased and optimistic: the first updates use Jacobians of the wrong
  time, and their error persists. `mmae-delay` does not have this problem.

Not claimed: convergence from a large initial error of the delay. If the motion contains no information (x' = 0), the delay is
not observable. The process noise between b and the sampling time is neglected, so with large process noise the filter is
optimistic.
Time index: xhat is the estimate of the present, after the jump. Samples may have any age and order, as each is newer than b.
Source: Nilsson, Skog, Haendel, Joint state and measurement time-delay estimation of nonlinear state space systems, ISSPA
2010.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.observers.parts import kalman, unknown_delay
from pcbench.observers.parts.common import no_snapshot
from pcbench.observers.parts.unknown_delay import Gains, predict_linear, signal_covariance, signals_of
from pcbench.protocols import Arrival, Leaf, Now, Observer, vmap_as_unit
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate


class Memory(NamedTuple):
    """State and delay at tick `tick`, and the present estimate."""

    z: Float[Array, " n+1"]
    P: Float[Array, "n+1 n+1"]
    tick: Int[Array, ""]
    xhat: Float[Array, " n"]


class Options(unknown_delay.Options):
    """Assumptions of the filter."""

    delay_walk: float = Field(0.0, ge=0, description="variance of the random walk of the delay per second [s^2/s]")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at the prior."""
    n = xhat0.shape[0]
    P = jnp.zeros((n + 1, n + 1)).at[:n, :n].set(gains.P0).at[n, n].set(gains.delay_std**2)
    return Memory(jnp.append(xhat0, gains.delay), P, jnp.asarray(0), xhat0)


def joint(gains: Gains) -> tuple[Array, Array, Array]:
    """Return Phi, Gamma and Q of state and delay; the delay is a random walk."""
    n, m = gains.Gamma.shape

    def extend(A: Leaf, last: Leaf) -> Array:
        return jnp.zeros((n + 1, n + 1)).at[:n, :n].set(A).at[n, n].set(last)

    Gamma = jnp.concatenate([gains.Gamma, jnp.zeros((1, m))])
    return extend(gains.Phi, 1.0), Gamma, extend(gains.Q, gains.extra)


class SamplePrediction(NamedTuple):
    """Predictions from the base tick at the present and on both sides of the sampling time, with Jacobians."""

    x: Float[Array, " n"]
    F: Float[Array, "n n"]
    before: tuple[Array, Array]  # x, F at the last tick up to the sampling time
    after: tuple[Array, Array]  # x, F at the next tick


def predict_sample(gains: Gains, now: Now, x: Array, base: Array, first: Array) -> SamplePrediction:
    """Return predictions from the state at tick `base`: at ticks `first` and `first` + 1, and at the present."""

    def tick(k: Array, c: SamplePrediction) -> SamplePrediction:
        state = c.x, c.F
        before = tuple(jnp.where(k == first, a, b) for a, b in zip(state, c.before, strict=True))
        x, F = gains.Phi @ c.x + gains.Gamma @ now.past_u(now.tick - k), gains.Phi @ c.F
        after = tuple(jnp.where(k == first, a, b) for a, b in zip((x, F), c.after, strict=True))
        return SamplePrediction(x, F, before, after)  # type: ignore[arg-type]

    state = x, jnp.eye(x.shape[0])
    return lax.fori_loop(base, now.tick, tick, SamplePrediction(*state, state, state))


def _update_at_sample(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Predict to the base tick, update there by a sample taken between ticks, and predict to the present."""
    base, n = jnp.maximum(now.tick - gains.longest - gains.later, 0), gains.C.shape[1]
    z, P = predict_linear(*joint(gains), now, memory.z, memory.P, memory.tick, base)
    sampling_tick = jnp.clip(unknown_delay.expected_arrival_tick(gains, now, arrival) - z[n] / gains.dt, base, now.tick)
    first = jnp.clip(jnp.floor(sampling_tick), base, jnp.maximum(now.tick - 1, base)).astype(int)
    fraction, prior = sampling_tick - first, predict_sample(gains, now, z[:n], base, first)
    (xa, Fa), (xb, Fb) = prior.before, prior.after
    H_x, H_tau = gains.C @ ((1 - fraction) * Fa + fraction * Fb), -(gains.C @ (xb - xa) / gains.dt)
    H = jnp.concatenate([H_x, H_tau[:, None]], 1)
    y, z_prior = gains.C @ ((1 - fraction) * xa + fraction * xb), z
    for channel in range(gains.C.shape[0]):
        c, r, mask = H[channel], gains.R[channel], arrival.mask[channel]
        nu = arrival.value[channel] - y[channel] - c @ (z - z_prior)
        K = kalman.gain(P @ c, c @ P @ c + r, mask)
        z, P = z + jnp.where(mask, K * nu, 0.0), kalman.covariance(P, K, c, r)
    z = z.at[n].set(jnp.clip(z[n], 0.0, gains.longest * gains.dt))
    return Memory(z, P, base, prior.x + prior.F @ (z[:n] - z_prior[:n]))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Update state and delay by the arriving sample, and predict to the present."""
    return vmap_as_unit(lambda memory, arrival: _update_at_sample(gains, memory, now, arrival))(memory, arrival)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Propagate the present estimate by one tick."""
    return memory._replace(xhat=gains.Phi @ memory.xhat + gains.Gamma @ now.u)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " signals"]:
    """Return the present xhat, and the delay if it is the plant's unknown."""
    return signals_of(gains, memory.xhat, memory.z[-1])


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "signals signals"]:
    """Return the present covariance: P at the base tick, propagated."""

    def present(z: Array, P: Array, tick: Array) -> Array:
        return signal_covariance(gains, predict_linear(*joint(gains), now, z, P, tick, now.tick)[1])

    return vmap_as_unit(present)(memory.z, memory.P, memory.tick)


def delay(gains: Gains, memory: Memory, now: Now) -> Float[Array, "2"]:
    """Return mean and standard deviation of the delay [s]; the mean is constant between samples."""
    walk_variance = gains.extra * (now.tick - memory.tick)
    return jnp.stack([memory.z[-1], jnp.sqrt(memory.P[-1, -1] + walk_variance)])


OBSERVER = Observer(init, no_snapshot, jump, flow, estimate, covariance=covariance, delay=delay)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; with the delay as a state the filter is nonlinear, so it has no certificate."""
    gains = unknown_delay.design(context, options, "ekf-delay")
    walk = np.asarray(options.delay_walk * context.dt)
    return Design(gains._replace(extra=walk), no_certificate("the delay is a state, so the filter is nonlinear"))
