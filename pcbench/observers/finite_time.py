"""finite-time: observer with an internal delay, which converges in finite time (Engel and Kreisselmeier).

Two current estimators z1, z2 with different poles run in parallel, and are corrected at each sampling time:

    zbar_i = Phi z_i + I(t_(m-1), t_m),   z_i = zbar_i + L_i (y_m - C zbar_i)
    xhat_m = K1 z1_m + K2 z2_m - H (z1_(m-N) - z2_(m-N)),   K1 + K2 = I                  with `synthesis.finite_time`

With a true model and without noise, the error is 0 from N samples after the first one on, for every initial error. Until then
xhat is z1. The estimate is predicted to the present (`parts/prediction`), so a delay adds to that time.

Source: Engel, Kreisselmeier, IEEE TAC 47(7), 2002, for continuous measurement, z_i' = A z_i + B u + L_i (y - C z_i). The form
for samples and the prediction over the delay are this project's.
Schedule: samples of any age and order. H is for the mean period. With varying intervals or lost samples, the error does not
vanish in finite time; it then decays as those of z1 and z2.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: noise filtering; a short time makes K1 and K2 large. Modes that decay by 99 % or more per sample keep their rate.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import after
from pcbench.errors import UserError
from pcbench.observers.parts import prediction
from pcbench.observers.parts.common import select_memory, xhat
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import finite_time
from pcbench.synthesis.certificate import Design, DesignContext, one_clock, require_certified
from pcbench.synthesis.error_bounds import rate_of


class Gains(NamedTuple):
    """n states, m inputs, q outputs."""

    motion: Motion
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    L: Float[Leaf, "2 n q"]
    K: Float[Leaf, "2 n n"]
    H: Float[Leaf, "n n"]
    window: Room  # for the N samples
    room: Room  # for samples that may arrive after newer ones


class Pair(NamedTuple):
    """Both estimators at a sampling time, without the response to the input; `past` contains the newest first."""

    z: Float[Array, "n 2"]
    free: Float[Array, " n"]  # xhat without the response to the input
    tick: Int[Array, ""]
    past: Float[Array, "N n 2"]
    n_used: Int[Array, ""]  # number of samples used


class Options(StrictOptions):
    """Poles and convergence time."""

    pole: float = tunable(0.6, (0.01, 0.99), gt=0, lt=1, description="pole of the slower estimator per sample")
    ratio: float = Field(2.0, gt=1, description="the pole of the faster estimator is pole^ratio")
    samples: int | None = Field(
        None, ge=1, le=64, description="sampling periods until the error is 0; default: 2 n, with n states"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory with both estimators at xhat(0)."""
    z = jnp.stack([xhat0, xhat0], axis=1)
    past = jnp.zeros((gains.window.shape[0], *z.shape))
    pair = Pair(z, xhat0, jnp.asarray(0), past, jnp.asarray(0))
    return prediction.start(xhat0, pair, gains.room, gains.C.shape[0])


def correct(gains: Gains, before: Pair, sample: Measurement) -> Pair:
    """Correct both estimators at the sampling time, and combine them."""
    z = after(gains.motion.powers, sample.tick - before.tick, before.z)
    innovation = (sample.value - gains.C @ sample.snapshot)[:, None] - gains.C @ z
    innovation = jnp.where(sample.mask[:, None], innovation, 0.0)
    z = z + jnp.stack([gains.L[i] @ innovation[:, i] for i in range(2)], axis=1)
    oldest = before.past[-1]
    combination = gains.K[0] @ z[:, 0] + gains.K[1] @ z[:, 1] - gains.H @ (oldest[:, 0] - oldest[:, 1])
    free = jnp.where(before.n_used >= before.past.shape[0], combination, z[:, 0])
    past = jnp.concatenate([z[None], before.past[:-1]])
    return select_memory(sample.mask, Pair(z, free, sample.tick, past, before.n_used + 1), before)


jump = prediction.make_jump(correct, lambda pair: Point(pair.free, pair.tick))
OBSERVER = Observer(init, prediction.snapshot, jump, prediction.flow, xhat)


def design(context: DesignContext, options: Options) -> Design:
    """Place the poles at the mean period, combine the estimators, and certify them."""
    period, where, model = one_clock(context, "finite-time"), f"finite-time in {context.scenario}", context.model
    n, q = model.C.shape[1], len(model.C)
    N = 2 * n if options.samples is None else options.samples
    if N * q < n:
        raise UserError(
            f"{where}: got samples = {N}, expected at least {-(-n // q)} for {n} states and {q} outputs; give more."
        )
    Phi = linear.over(linear.doublings(model, context.dt, linear.bits_for(period)), period)
    matrices, certificate = finite_time.design(Phi, model.C, options.pole, options.ratio, N, where)
    require_certified(certificate, where)
    gains = Gains(
        motion=prediction.motion_of(model, context),
        C=model.C,
        D=model.feedthrough,
        **matrices._asdict(),
        window=np.zeros(N),
        room=context.room,
    )
    return Design(gains, certificate._replace(rate=rate_of(1 - certificate.margin, period * context.dt)))
