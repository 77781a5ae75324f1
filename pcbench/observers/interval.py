"""interval: interval observer: an estimate with bounds of the state for all noise within given bounds.

It corrects at each sampling time, and predicts to the present (`parts/prediction`):

    xbar_m = Phi^s xhat_(m-1) + I(t_(m-1), t_m),   xhat_m = xbar_m + L (y_m - C xbar_m),   s ticks from sample to sample

b_j are the columns of the process noise per tick, |w_j| <= wmax_j and |v_i| <= vmax_i. r_m bounds |V^-1 (x - xbar)| at t_m:

    B_m = [(I - L C) V diag(r_m),  L diag(vmax)],   q(s) = sum_(i<s) |V^-1 Phi^i b| wmax
    r(s) = |V^-1 Phi^s B_m| 1 + q(s),               x in xhat +- |V| r(s)  s ticks after t_m,   r_(m+1) = r(interval)

Proof: just after t_m, x - xhat = (I - L C) (x - xbar) - L v = B_m z with all |z_i| <= 1. Phi^s propagates it over s ticks,
and the noise of tick i is propagated by Phi^(s-1-i). V^-1 times the sum has, entry by entry, absolute values of at most r(s).
Let V contain the modes of M = Phi^p (I - L C) at the period of p ticks. Then |V^-1 M V| = |l|, so with K = Phi^p L

    r_(m+1) = |l| r_m + q(p) + |V^-1 K| vmax

as in `synthesis.interval_observer`. The proof does not need a constant s. So the bounds also hold with jitter, lost samples
or channels, and samples in any order, but the interval is wider. Without samples, r follows |V^-1 Phi^s V|.

Source: this project's, after Mazenc, Dinh, Automatica 50(10), 2014, which was not obtained.
Schedule: samples of any age and order, with true timestamps. The certificate (r is bounded) is for the mean period.
Time index: estimate and bounds are of the present, after the jump. With a delay of one sampling period, they are those of the
Luenberger predictor, xhat + K (y - C xhat), just before the next sample is used.
Bounds are options, or `sigmas` standard deviations of the scenario's assumed noise. Process noise is bounded along the
principal axes of its covariance. Gaussian noise exceeds every bound with some probability, at 6 standard deviations 2e-9 per
number.
Not claimed: coverage 1 with noise beyond its bound, outliers, a wrong model or a wrong timestamp, or with a
`quantization_step` whose rounding `noise_bound` does not include.
Refused: unknown inputs.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after
from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError
from pcbench.observers.parts import prediction, reorder_buffer
from pcbench.observers.parts.common import xhat
from pcbench.observers.parts.options import StrictOptions, matrix, tunable
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import interval_observer
from pcbench.synthesis.certificate import Design, DesignContext, one_clock
from pcbench.synthesis.error_bounds import rate_of

ROUNDING = 1e-12  # relative widening of the interval, for rounding errors


class Gains(NamedTuple):
    """n states, m inputs, q outputs; a run has N ticks."""

    motion: Motion
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    L: Float[Leaf, "n q"]
    V: Float[Leaf, "n n"]
    V_inv: Float[Leaf, "n n"]
    start: Float[Leaf, " n"]  # r at tick 0
    vmax: Float[Leaf, " q"]
    noise: Float[Leaf, "ages n"]  # q(s), s = 0 .. N
    room: Room  # for samples that may arrive after newer ones


class Ball(NamedTuple):
    """Estimate just after a sample was used, without the response to the input, and the generators of its error."""

    free: Float[Array, " n"]
    tick: Int[Array, ""]
    B: Float[Array, "n k"]  # k = n + q


class Options(StrictOptions):
    """The gain, and bounds of noise and initial error."""

    pole: float = tunable(0.5, (0.01, 0.99), gt=0, lt=1, description="slowest pole of the error per sample")
    poles: list[float] | None = Field(
        None, description="all n poles of the error per sample, real and distinct, instead of `pole`"
    )
    L: list[list[float]] | None = Field(None, description="[n, q] gain at a sample's time, instead of a computed one")
    sigmas: float = Field(6.0, gt=0, description="assumed standard deviations to which noise and x(0) are bounded")
    noise_bound: list[float] | None = Field(
        None, description="largest noise of a sample of each output, instead of by `sigmas`"
    )
    process_bound: list[float] | None = Field(
        None, description="largest process noise of each state per tick, instead of by `sigmas`"
    )
    initial_bound: list[float] | None = Field(
        None, description="largest initial error of each state, instead of by `sigmas`"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), as if a sample had been used at tick 0."""
    n, q = gains.L.shape
    ball = Ball(xhat0, jnp.asarray(0), jnp.concatenate([gains.V * gains.start[None], jnp.zeros((n, q))], axis=1))
    return prediction.start(xhat0, ball, gains.room, q)


def radius(gains: Gains, ball: Ball, tick: Int[Array, ""]) -> Float[Array, " n"]:
    """Return r at a tick at or after the sample."""
    s = tick - ball.tick
    propagated_radius = jnp.sum(jnp.abs(gains.V_inv @ after(gains.motion.powers, s, ball.B)), axis=1)
    return propagated_radius + jnp.take(gains.noise, s, axis=0, mode="clip")


def correct(gains: Gains, before: Ball, sample: Measurement) -> Ball:
    """Correct at the sampling time."""
    free = prediction.predict_to(gains.motion, Point(before.free, before.tick), sample.tick)
    L = jnp.where(sample.mask[None], gains.L, 0.0)
    innovation = jnp.where(sample.mask, sample.value - gains.C @ (sample.snapshot + free), 0.0)
    columns = (gains.V - L @ (gains.C @ gains.V)) * radius(gains, before, sample.tick)[None]
    return Ball(free + L @ innovation, sample.tick, jnp.concatenate([columns, L * gains.vmax[None]], axis=1))


def bounds(gains: Gains, memory: Memory) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Return lower and upper bound of the present state."""
    ball = reorder_buffer.newest(lambda state, sample: correct(gains, state, sample), memory.buffer)
    half_width = jnp.abs(gains.V) @ radius(gains, ball, memory.tick)
    half_width = half_width + ROUNDING * (half_width + jnp.abs(memory.xhat))
    return memory.xhat - half_width, memory.xhat + half_width


jump = prediction.make_jump(correct, lambda ball: Point(ball.free, ball.tick))
OBSERVER = Observer(init, prediction.snapshot, jump, prediction.flow, xhat, bounds=bounds)


def design(context: DesignContext, options: Options) -> Design:
    """Place the poles at the mean period, find the modes, and certify that r is bounded.

    Raises UserError for a plant with an unknown input or a bound of the wrong length, and DesignError for a gain without
    certificate.
    """
    period, where, model = one_clock(context, "interval"), f"interval in {context.scenario}", context.model
    if model.E is not None:
        raise UserError(
            f"{where}: got a plant with an unknown input, expected one driven by known inputs and bounded noise; use kf."
        )
    (q, n), Phi_tick = model.C.shape, linear.one_tick(model, context.dt)[0]
    Phi = linear.over(linear.doublings(model, context.dt, linear.bits_for(period)), period)
    if options.L is not None:
        L = matrix(options.L, (n, q), f"{where}: L", "states x outputs")
    elif options.poles is not None and len(options.poles) != n:
        raise UserError(f"{where}: poles: got {len(options.poles)}, expected {n}, one for each state.")
    else:
        L = interval_observer.gain(Phi, model.C, options.pole, options.poles, where)
    modes, certificate = interval_observer.certify(Phi, model.C, L, where)
    variances, axes = np.linalg.eigh(context.process_noise)
    columns = options.sigmas * axes * np.sqrt(np.maximum(variances, 0.0))
    if options.process_bound is not None:
        columns = np.diag(_bound(options.process_bound, variances, f"{where}: process_bound", "state"))
    std = options.sigmas * np.array(context.noise_std)
    vmax = _bound(options.noise_bound, std, f"{where}: noise_bound", "output")
    initial_bound = options.sigmas * np.sqrt(np.diag(context.P0))
    initial_bound = _bound(options.initial_bound, initial_bound, f"{where}: initial_bound", "state")
    noise = interval_observer.accumulate_noise(Phi_tick, columns, modes.V_inv, context.ticks)
    width = interval_observer.final_width(modes, Phi, model.C, noise[min(period, context.ticks)], vmax)
    gains = Gains(
        motion=prediction.motion_of(model, context),
        C=model.C,
        D=model.feedthrough,
        **modes._asdict(),
        start=np.abs(modes.V_inv) @ initial_bound,
        vmax=vmax,
        noise=noise,
        room=context.room,
    )
    numbers = dict(certificate.numbers) | {"width_before_sample": width}
    rate = rate_of(1 - certificate.margin, period * context.dt)
    return Design(gains, certificate._replace(numbers=numbers, rate=rate))


def _bound(bound: list[float] | None, default: Matrix, where: str, signal: str) -> Matrix:
    """Return the option `bound`, one number per state or output, or `default` if it is None."""
    if bound is None:
        return default
    if len(bound) != len(default) or min(bound) < 0:
        raise UserError(f"{where}: got {bound}, expected {len(default)} numbers of at least 0, one for each {signal}.")
    return np.array(bound)
