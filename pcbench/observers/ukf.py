"""ukf: unscented Kalman filter, which propagates mean and covariance by sigma points instead of Jacobians.

    z_0 = m,   z_(+-i) = m +- g l_i,   P = L L', l_i the columns of L,   g^2 = alpha^2 (N + kappa)
    m' = W f(z_0) + w sum_i f(z_i),   P' = (W + 1 - alpha^2 + beta) d_0 d_0' + w sum_i d_i d_i' + Q,   d_i = f(z_i) - m'
    w = 1 / (2 g^2),   W = 1 - N / g^2

N is the number of states and unknowns. The output is predicted in the same way, from new sigma points at the sampling time.
With `form = "cubature"`, g^2 = N and the centre has no weight (cubature rule of degree 3). L is the Cholesky factor; a
direction without variance has no points.
The filter propagates to the present tick by tick, and uses a sample of any age at its sampling time (`parts/repropagation`).
p is clipped to the plant's range after every update and tick.
Source: Julier, Uhlmann 1997; weights as in Wan, van der Merwe 2000; cubature: Arasaratnam, Haykin 2009.
On a linear plant both forms equal `kf` up to rounding. A small alpha loses digits, because weights grow as 1/alpha^2.
Time index: xhat is the estimate of the present, after the jump. Not claimed: that P stays positive definite if the weight of
the centre is negative.
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
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.nonlinear_model import Gains, clip_parameters, outputs_at_points
from pcbench.observers.parts.options import tunable
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import InnovationStats, Leaf, Now
from pcbench.synthesis.certificate import Design, DesignContext

VARIANCE_TOL = 1e-14  # relative size of a remaining variance that counts as rounding error


class Points(NamedTuple):
    """Spread and weights of the sigma points."""

    reach: Float[Leaf, ""]  # g
    weight: Float[Leaf, ""]  # w
    centre: Float[Leaf, ""]  # weight of the centre in a covariance


class Options(nonlinear_model.Options):
    """Assumptions of the filter, and its sigma points."""

    form: Literal["unscented", "cubature"] = Field("unscented", description="sigma points and weights")
    alpha: float = tunable(0.1, (1e-3, 1.0), ge=1e-3, le=1, description="unscented: spread of the sigma points")
    beta: float = tunable(2.0, ge=0, description="unscented: parameter of the distribution, 2 for a Gaussian one")
    kappa: float = Field(0.0, description="unscented: second spread parameter, added to the number of states")


def root(P: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """Return L with L L' = P, by columns; a column without remaining variance is 0."""
    size = jnp.diagonal(P)

    def column(remainder: Array, e: Array) -> tuple[Array, Array]:
        v = remainder @ e
        positive = e @ v > VARIANCE_TOL * (e @ size)
        L_column = jnp.where(positive, v / jnp.sqrt(jnp.where(positive, e @ v, 1.0)), 0.0)
        return remainder - jnp.outer(L_column, L_column), L_column

    # A loop, because the compiler would otherwise compute each column again for every column after it.
    return lax.scan(column, P, jnp.eye(P.shape[0]))[1].T


def sigma_points(gains: Gains, state: Posterior) -> Float[Array, "points N"]:
    """Return the sigma points, the centre first."""
    offsets = gains.extra.reach * root(state.P).T
    return jnp.concatenate([state.mean[None], state.mean[None] + offsets, state.mean[None] - offsets])


def moments(gains: Gains, points: Float[Array, "points joint"]) -> tuple[Array, Array]:
    """Return mean and covariance of propagated sigma points."""
    params, offsets = gains.extra, points[1:] - points[:1]
    m = points[0] + params.weight * jnp.sum(offsets, axis=0)
    d, d0 = points[1:] - m[None], points[0] - m
    return m, params.weight * jnp.sum(d[:, :, None] * d[:, None, :], axis=0) + params.centre * jnp.outer(d0, d0)


def tick(gains: Gains, now: Now, state: Posterior) -> Posterior:
    """Propagate the state by one tick."""
    m, P = moments(gains, jax.vmap(lambda z: gains.motion(now, z))(sigma_points(gains, state)))
    return state._replace(mean=clip_parameters(gains, m), P=P + gains.Q)


def update_by_points(
    gains: Gains, now: Now, state: Posterior, sample: Measurement
) -> tuple[Array, Array, InnovationStats]:
    """Return mean, covariance and innovation statistics after a sample."""
    if gains.sensor is None:  # linear: no points are needed
        return kalman.update_linearized(gains, now, state.mean, state.P, sample, state.mean)

    points = sigma_points(gains, state)
    joint = jnp.concatenate([points, outputs_at_points(gains, now, points)], axis=1)
    return kalman.update_by_moments(gains, *moments(gains, joint), sample)


def update(gains: Gains, now: Now, state: Posterior, sample: Measurement) -> Posterior:
    """Update by a sample of the state's tick."""
    z, P, _ = update_by_points(gains, now, state, sample)
    return state._replace(mean=clip_parameters(gains, z), P=P)


def innovation_by_points(gains: Gains, now: Now, state: Posterior, sample: Measurement) -> InnovationStats:
    """Return the innovation statistics of a sample."""
    return update_by_points(gains, now, state, sample)[2]


OBSERVER = repropagation.observer(repropagation.FilterFunctions(tick, update, innovation_by_points))


def points_of(options: Options, N: int, where: str) -> Points:
    """Return spread and weights for N states and unknowns; raise UserError for options without such points."""
    if options.form == "cubature":
        if names := {"alpha", "beta", "kappa"} & options.model_fields_set:
            raise UserError(
                f"{where}: got {min(names)} with form = 'cubature', expected it only with form = 'unscented'; leave it out."
            )
        return Points(*map(np.asarray, (np.sqrt(N), 0.5 / N, 0.0)))
    if N + options.kappa <= 0:
        raise UserError(
            f"{where}: got kappa = {options.kappa:g} with {N} states and unknowns, expected more than {-N}; write 0."
        )
    square = options.alpha**2 * (N + options.kappa)
    centre = 1 - N / square + 1 - options.alpha**2 + options.beta
    return Points(*map(np.asarray, (np.sqrt(square), 0.5 / square, centre)))


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; a nonlinear model has no certificate."""
    where = f"ukf in {context.scenario}"
    return nonlinear_model.design(context, options, "ukf", lambda gains: points_of(options, len(gains.P0), where))
