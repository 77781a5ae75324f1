"""dkf: the delay-compensated discrete Kalman filter, the fair baseline.

At the arrival of sample m, taken at t_m: carry mean and covariance from the newest sample used to t_m, update there (Joseph
form, one channel after the other), then predict to now exactly as PCCEBO does:

    P-_m = E P_(m-1) E' + Q,   K = P- c (c'P- c + r)^-1,   P_m = (I - K c') P- (I - K c')' + K r K'
    xhat(t) = e^{A (t - t_m)} xhat_m + I(t_m, t)

R is the variance of one sample, the prior is N(xhat(0), P0). With q = 0 and x(0) drawn from the prior, P is the Bayesian
bound of every causal estimator, and this filter attains it. Where a scenario has no measurement noise R = 1e-12, never 0/0.
Time index: the estimate is of now, after the jump. A sample older than the newest one used is not taken back in order:
all channels share one period and one delay here.
Source: Kalman 1960; cart.md of the design pages for the numbers.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel, ConfigDict, Field

from pcbench.integrate import covariance_after
from pcbench.observers import free_response
from pcbench.observers.free_response import Motion, Resumable
from pcbench.observers.pccebo import motion
from pcbench.synthesis import linear, riccati
from pcbench.synthesis.certificate import Certificate, Design, Setting, certified, least_eigenvalue, one_clock
from pcbench.types import Arrival, Leaf, Now, Observer

NO_NOISE = 1e-12  # variance taken where a scenario has no measurement noise


class Gains(NamedTuple):
    """n states, q outputs."""

    motion: Motion
    noise: Leaf  # [bits, n, n] process noise covariance over 2^b ticks
    C: Leaf  # [q, n]
    R: Leaf  # [q] variance of one sample
    P0: Leaf  # [n, n]


class Memory(NamedTuple):
    """The mean, which can be taken up again, and the covariance at the newest sample used."""

    mean: Resumable
    P: Array  # [n, n]


class Options(BaseModel):
    """What the filter assumes, where it is not what the scenario has."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    R: float | None = Field(None, gt=0, description="assumed variance of one sample; default: the scenario's")
    q: float | None = Field(None, ge=0, description="assumed intensity of process noise through the input")


def init(gains: Gains, xhat0: Array) -> Memory:
    """Start from the prior N(xhat(0), P0)."""
    return Memory(free_response.init(xhat0), gains.P0)


def note(gains: Gains, memory: Memory, now: Now) -> Array:
    """Note the input response at the sample's time, [n]."""
    return memory.mean.g


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Update at the sample's own time, channel by channel, then predict to now."""
    mean = memory.mean
    free = free_response.at_sample(gains.motion, mean, now, arrival)
    P = covariance_after(gains.motion.doublings, gains.noise, free_response.gap(mean, now, arrival), memory.P)
    for channel in range(gains.C.shape[0]):  # independent noise: one after the other is the joint update
        c, r, fresh = gains.C[channel], gains.R[channel], arrival.fresh[channel]
        K = jnp.where(fresh, P @ c / (c @ P @ c + r), 0.0)
        free = free + K * (arrival.value[channel] - c @ (arrival.note + free))
        keep = jnp.eye(c.shape[0]) - K[:, None] * c[None, :]
        P = keep @ P @ keep.T + r * (K[:, None] * K[None, :])
    return Memory(free_response.resume(gains.motion, mean, now, arrival, free), P)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Move the mean by one tick; the covariance waits for the next sample."""
    return memory._replace(mean=free_response.flow(gains.motion, memory.mean, now))


def estimate(gains: Gains, memory: Memory) -> Array:
    """Return xhat of now, [n]."""
    return memory.mean.xhat


OBSERVER = Observer(init, note, jump, flow, estimate)


def design(setting: Setting, options: Options) -> Design:
    """Gather what the filter assumes, and check its covariance recursion over the horizon."""
    period, _ = one_clock(setting, "dkf")
    A, B, C = setting.model
    q = setting.input_intensity if options.q is None else options.q
    R = np.array([s**2 or NO_NOISE for s in setting.noise_std]) if options.R is None else np.full(len(C), options.R)
    moves = motion(setting)
    noise = linear.noise_doublings(A, q * B @ B.T, setting.dt, len(moves.doublings))
    gains = Gains(moves, noise, C, R, setting.P0)
    return Design(gains, certified(_certify(gains, period, setting), f"dkf in {setting.scenario}"))


def _certify(gains: Gains, period: int, setting: Setting) -> Certificate:
    """The margin is the least innovation variance over the horizon, relative to R, where the covariance stays >= 0."""
    E = linear.over(gains.motion.doublings, period)
    Q = np.zeros_like(E)
    for b, Qb in enumerate(gains.noise):
        if period >> b & 1:
            Q = gains.motion.doublings[b] @ Q @ gains.motion.doublings[b].T + Qb
    R = np.diag(gains.R)
    run = riccati.recursion(E, Q, gains.C, R, gains.P0, setting.ticks // period + 1)
    innovation = min(least_eigenvalue(gains.C @ P @ gains.C.T + R) for P in run.prior) / gains.R.min()
    least = min(least_eigenvalue(P) / max(np.abs(P).max(), 1e-300) for P in run.posterior)
    K = np.linalg.solve(gains.C @ run.prior[-1] @ gains.C.T + R, gains.C @ run.prior[-1]).T
    numbers = {"P_end": run.posterior[-1], "K_end": K, "R": gains.R, "innovation_over_R": innovation}
    margin = innovation if least > -1e-9 else float("nan")
    return Certificate("C P C' + R > 0 and P >= 0 at every sample", margin, "recursion", "run", numbers)
