"""The joint mean and covariance of z and of what a sample is expected to say, y, and what z is once y is known.

    (z, y) ~ (m, J),   channel by channel with c the row that picks y_j:   K = J c (c'J c + r)^-1,   m <- m + K (y_j - c'm)

and J in Joseph's form (`parts/kalman`). How J is found is the filter's: by a slope, or by points. Where y = C z all are one.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from pcbench.observers.parts import kalman
from pcbench.observers.parts.nonlinear_model import Gains, value_of
from pcbench.observers.parts.reordering import Measurement
from pcbench.protocols import Surprise


def by_slope(P: Float[Array, "N N"], H: Float[Array, "q N"]) -> Float[Array, "N+q N+q"]:
    """Return the covariance of z and of what moves as H z does."""
    across = H @ P
    return jnp.block([[P, across.T], [across, across @ H.T]])


def used(
    gains: Gains, mean: Float[Array, " joint"], J: Float[Array, "joint joint"], sample: Measurement
) -> tuple[Array, Array, Surprise]:
    """Return mean [N] and covariance [N, N] of z once a sample is known, and how far it was from what was expected."""
    value, N, total = value_of(gains, sample.value), gains.P0.shape[0], kalman.unjudged()
    for channel in range(gains.C.shape[0]):
        r, fresh, c = gains.R[channel], sample.fresh[channel], jnp.eye(mean.shape[0])[N + channel]
        nu, s = value[channel] - mean[N + channel], J[N + channel, N + channel] + r
        total = kalman.judged(total, nu, s, fresh)
        K = kalman.gain(J[:, N + channel], s, fresh)
        mean, J = mean + K * nu, kalman.covariance(J, K, c, r)
    return mean[:N], J[:N, :N], total
