"""KFBO: Kalman-filter-based observer, which uses the held, delayed sample as a continuous measurement.

    z'(t) = (A - K C) z + B u(t - d) + K Y(t),  t >= d;   z = xhat(0) before                 (25)
    g' = A g + B u,  g(0) = 0                                                                (28)
    xhat(t) = g(t) + e^{A min(t, d)} [z(t) - g(t - d)]                                       (29)

z estimates the state d ago. Y is the newest sample that has arrived, held (0 before the first). The code stores s(t) = g(t) -
e^{A d} g(t - d), the response to the input of the last d, as one state: s' = A s + B u - e^{A d} B u(t - d). So it stores no
history of g.

Source: Mohammed et al. 2017, section 5 (after Roberts 1986). Different from print: K = P C' R^-1 and Q = 0.002 B B' (see
`synthesis.riccati`).
Schedule: one constant delay of all channels. The observer does not use the age of a sample, so schedules with varying ages
are refused. After a lost sample it holds the previous one.
Not claimed: perfect start. The design ignores that Y is held, so at constant velocity the estimate lags by velocity x te / 2.
Options: `lag_aware` uses d + te / 2 instead of d (te must be an even number of ticks). `sampled_innovation` holds the
innovation Y_i - C z(t_i) instead of the measurement, z' = A z + B u(t - d) + K (Y_i - C z(t_i)), which can be unstable.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field, model_validator

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers.parts import assumed_noise
from pcbench.observers.parts.assumed_noise import Sizes, Variance, Variances
from pcbench.observers.parts.common import known_input, no_snapshot, xhat
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import Design, DesignContext, require_certified


class Gains(NamedTuple):
    """n states, m inputs, q outputs; maps over one tick."""

    Phi: Float[Leaf, "n n"]  # of A
    Gamma: Float[Leaf, "n m"]  # of A, B
    Phi_z: Float[Leaf, "n n"]  # of the filter, A - K C (A with `sampled_innovation`)
    Gamma_z: Float[Leaf, "n m"]  # of the filter, B
    Gain_z: Float[Leaf, "n q"]  # of the filter, K
    E: Float[Leaf, "n n"]  # e^{A d}
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    lag: Int[Leaf, ""]  # [ticks] d
    holds_innovation: Float[Leaf, ""]  # 1: the innovation is held; 0: the measurement is held


class Memory(NamedTuple):
    """Memory between ticks."""

    z: Float[Array, " n"]  # estimate of the state d ago
    s: Float[Array, " n"]  # response to the input of the last d
    xhat: Float[Array, " n"]
    Y: Float[Array, " q"]  # input of the filter: the newest sample (or innovation), held


class Options(StrictOptions):
    """Noise intensities of the Riccati equation, and the two variants."""

    R: Variances | Literal["noise"] = tunable(
        1.0,
        description='assumed intensity of the measurement noise: one number, q numbers, or [q, q]; "noise": the variance of a '
        "sample times the period",
    )
    Q: Variance | Sizes = Field(
        0.002,
        description="assumed intensity of the process noise: one number (through the input), n numbers, or [n, n]",
    )
    lag_aware: bool = Field(False, description="add half a sampling period to the delay")
    sampled_innovation: bool = Field(False, description="hold the innovation instead of the measurement")

    @model_validator(mode="after")
    def _require_one_variant(self) -> "Options":
        if self.lag_aware and self.sampled_innovation:
            raise ValueError("one of lag_aware and sampled_innovation, not both (they disagree about z's time)")
        return self


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), before the first sample."""
    return Memory(xhat0, jnp.zeros_like(xhat0), xhat0, jnp.zeros(gains.C.shape[0]))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Hold the arriving sample, or its innovation."""
    Y = arrival.value - known_input(gains.D, now, arrival.age) - gains.holds_innovation * (gains.C @ memory.z)
    return memory._replace(Y=jnp.where(arrival.mask, Y, memory.Y))


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Propagate filter and prediction by one tick, exactly for held input and held Y."""
    u, is_past_lag = now.u, now.tick >= gains.lag
    u_delayed = now.past_u(gains.lag)
    z = jnp.where(is_past_lag, gains.Phi_z @ memory.z + gains.Gamma_z @ u_delayed + gains.Gain_z @ memory.Y, memory.z)
    old_response = jnp.where(is_past_lag, gains.E @ (gains.Gamma @ u_delayed), 0.0)
    increment = gains.Gamma @ u
    s = gains.Phi @ memory.s + increment - old_response
    return Memory(z, s, jnp.where(is_past_lag, gains.E @ z + s, gains.Phi @ memory.xhat + increment), memory.Y)


OBSERVER = Observer(init, no_snapshot, jump, flow, xhat)


def design(context: DesignContext, options: Options) -> Design:
    """Solve the Riccati equation (27), check that A - K C is Hurwitz, and discretise exactly."""
    model, where = context.model, f"kfbo in {context.scenario}"
    if model.discrete or len(set(context.delay)) > 1:
        mismatch = "a discrete plant" if model.discrete else f"channels with delays {context.delay} (ticks)"
        raise UserError(
            f"{where}: got {mismatch}, expected a continuous plant and one delay for all channels; leave kfbo out."
        )
    delay, period = context.delay[0], context.period[0]
    A, B, C, h, m = model.A, model.B, model.C, context.dt, model.B.shape[1]
    if options.R == "noise":
        R = np.diag(context.noise_variance * context.period * h)
    else:
        R = assumed_noise.covariance(options.R, len(C), f"{where}: R", "output")
    if isinstance(options.Q, list):
        Q = assumed_noise.covariance(options.Q, len(A), f"{where}: Q", "state")
    else:
        Q = options.Q * B @ B.T
    stationary = riccati.continuous(model, Q, R, where)
    certificate = require_certified(stationary.certificate, where)
    certificate = certificate._replace(numbers={**certificate.numbers, **assumed_noise.covariance_option("R", R)})
    K = stationary.K
    if options.lag_aware and (period % 2 or len(set(context.period)) > 1):
        raise UserError(
            f"{where}: lag_aware shifts by te/2, got te = {context.period} ticks, expected one even te for all channels."
        )
    lag = delay + (period // 2 if options.lag_aware else 0)
    Phi, Gamma = linear.one_tick(model, h)
    Phi_z, Gammas = linear.discretize_zoh(A if options.sampled_innovation else A - K @ C, np.hstack([B, K]), h)
    E = linear.over(linear.doublings(model, h, linear.bits_for(lag)), lag)
    gains = Gains(
        Phi=Phi,
        Gamma=Gamma,
        Phi_z=Phi_z,
        Gamma_z=Gammas[:, :m],
        Gain_z=Gammas[:, m:],
        E=E,
        C=C,
        D=model.feedthrough,
        lag=np.asarray(lag),
        holds_innovation=np.asarray(float(options.sampled_innovation)),
    )
    return Design(gains, certificate)
