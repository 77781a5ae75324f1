"""ukf: the unscented Kalman filter: mean and covariance go through the model by points in place of slopes.

    z_0 = m,   z_(+-i) = m +- g l_i,   P = L L', l_i the columns of L,   g^2 = alpha^2 (N + kappa)
    m' = W f(z_0) + w sum_i f(z_i),   P' = (W + 1 - alpha^2 + beta) d_0 d_0' + w sum_i d_i d_i' + Q,   d_i = f(z_i) - m'
    w = 1 / (2 g^2),   W = 1 - N / g^2

of N states and unknowns; the same for what a sample is expected to say, from points drawn anew at its own time. With
`form = "cubature"` g^2 = N and the centre has no weight: the cubature rule of degree 3. The points go on to now tick by tick,
and a sample of any age is used at its own time (`parts/repropagation`). L is Cholesky's factor; a direction without variance
has no points. p is clipped to the plant's range after every update and tick.
Source: Julier, Uhlmann 1997; weights as in Wan, van der Merwe 2000; cubature: Arasaratnam, Haykin 2009.
Found: on a linear plant both are `kf` to rounding. A small alpha loses digits: weights grow as 1/alpha^2.
Time index: the estimate is of now, after the jump. Not claimed: that P stays positive where the centre's weight is negative.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import kalman, nonlinear_model, repropagation
from pcbench.observers.parts.kalman import Linear, Posterior
from pcbench.observers.parts.nonlinear_model import Gains, at_points, clip_parameters, linearize_output
from pcbench.observers.parts.options import tunable
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import InnovationStats, Leaf, Now
from pcbench.synthesis.certificate import Design, DesignContext

NOTHING = 1e-14  # part of a variance that is left of it by rounding


class Points(NamedTuple):
    """How far out the points are, and what they weigh."""

    reach: Float[Leaf, ""]  # g
    weight: Float[Leaf, ""]  # w, of each
    centre: Float[Leaf, ""]  # of the centre in a covariance


class Options(nonlinear_model.Options):
    """What the filter assumes, and where its points are."""

    form: Literal["unscented", "cubature"] = Field("unscented", description="sigma points and weights")
    alpha: float = tunable(0.1, (1e-3, 1.0), ge=1e-3, le=1, description="unscented: spread of the sigma points")
    beta: float = tunable(2.0, ge=0, description="unscented: parameter of the distribution, 2 for a Gaussian one")
    kappa: float = Field(0.0, description="unscented: second spread parameter, added to the number of states")


def root(P: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """Return L with L L' = P, by columns; a column is 0 where no variance is left."""
    size = jnp.diagonal(P)

    def column(left: Array, e: Array) -> tuple[Array, Array]:
        each = left @ e
        there = e @ each > NOTHING * (e @ size)
        out = jnp.where(there, each / jnp.sqrt(jnp.where(there, e @ each, 1.0)), 0.0)
        return left - jnp.outer(out, out), out

    # A loop, where the compiler would compute each column anew for every use of it by those that follow.
    return lax.scan(column, P, jnp.eye(P.shape[0]))[1].T


def spread_out(gains: Gains, state: Posterior) -> Float[Array, "points N"]:
    """Return the points, the centre first."""
    out = gains.own.reach * root(state.P).T
    return jnp.concatenate([state.mean[None], state.mean[None] + out, state.mean[None] - out])


def moments(gains: Gains, points: Float[Array, "points joint"]) -> tuple[Array, Array]:
    """Return mean and covariance of what points became, by their weights."""
    own, away = gains.own, points[1:] - points[:1]
    m = points[0] + own.weight * jnp.sum(away, axis=0)
    d, d0 = points[1:] - m[None], points[0] - m
    return m, own.weight * jnp.sum(d[:, :, None] * d[:, None, :], axis=0) + own.centre * jnp.outer(d0, d0)


def tick(gains: Gains, now: Now, state: Posterior) -> Posterior:
    """Move the points by a tick."""
    m, P = moments(gains, jax.vmap(lambda z: gains.motion(now, z))(spread_out(gains, state)))
    return state._replace(mean=clip_parameters(gains, m), P=P + gains.Q)


def update_by_points(
    gains: Gains, now: Now, state: Posterior, sample: Measurement
) -> tuple[Array, Array, InnovationStats]:
    """Return what z is once a sample is known, and how far it was from what was expected."""
    if gains.sensor is None:  # linear: no points are needed
        sensor = Linear(*linearize_output(gains, now, state.mean), state.mean)
        return kalman.by_slope(gains, state.mean, state.P, sensor, sample)

    points = spread_out(gains, state)
    both = jnp.concatenate([points, at_points(gains, now, points)], axis=1)
    return kalman.by_points(gains, *moments(gains, both), sample)


def update(gains: Gains, now: Now, state: Posterior, sample: Measurement) -> Posterior:
    """Correct by a sample of the state's tick."""
    z, P, _ = update_by_points(gains, now, state, sample)
    return state._replace(mean=clip_parameters(gains, z), P=P)


def innovation_by_points(gains: Gains, now: Now, state: Posterior, sample: Measurement) -> InnovationStats:
    """Return how far a sample is from what is expected of it."""
    return update_by_points(gains, now, state, sample)[2]


OBSERVER = repropagation.observer(repropagation.Way(tick, update, innovation_by_points))


def points_of(options: Options, N: int, where: str) -> Points:
    """Return where the points of N states and unknowns are; raise UserError where there are none such."""
    if options.form == "cubature":
        if given := {"alpha", "beta", "kappa"} & options.model_fields_set:
            raise UserError(
                f"{where}: got {min(given)} with form = 'cubature', expected it only with form = 'unscented'; leave it out."
            )
        return Points(*map(np.asarray, (np.sqrt(N), 0.5 / N, 0.0)))
    if N + options.kappa <= 0:
        raise UserError(
            f"{where}: got kappa = {options.kappa:g} with {N} states and unknowns, expected more than {-N}; write 0."
        )
    square = options.alpha**2 * (N + options.kappa)
    centre = 1 - N / square + 1 - options.alpha**2 + options.beta
    return Points(*map(np.asarray, (np.sqrt(square), 0.5 / square, centre)))


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; there is no certificate for a nonlinear model."""
    where = f"ukf in {setting.scenario}"
    return nonlinear_model.design(setting, options, "ukf", lambda gains: points_of(options, len(gains.P0), where))
