"""What z ~ N(m, P) is once a sample is known, channel by channel, and how far the sample was from what was expected of it.

By a slope: y ~ yhat + H (z - about), in Joseph's form (`parts/kalman`), which keeps P >= 0 where R is far smaller than H P H'.
By points: the joint covariance J of z and y is what points say, and c is the row that picks y_j:

    K = J c (c'J c + r)^-1,   m <- m + K (y_j - c'm),   J likewise

Where y = H z, both are Kalman's update.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from pcbench.observers.parts import kalman
from pcbench.observers.parts.nonlinear_model import Gains, value_of
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import InnovationStats


class Linear(NamedTuple):
    """What a sensor says near a point."""

    y: Float[Array, " q"]
    H: Float[Array, "q N"]
    about: Float[Array, " N"]


def by_slope(
    gains: Gains, z: Float[Array, " N"], P: Float[Array, "N N"], sensor: Linear, sample: Measurement
) -> tuple[Array, Array, InnovationStats]:
    """Return mean and covariance of z once a sample is known, by a sensor's slope."""
    value, total = value_of(gains, sample.value), kalman.unjudged()
    for channel in range(gains.C.shape[0]):
        r, mask, h = gains.R[channel], sample.mask[channel], sensor.H[channel]
        nu, s = value[channel] - sensor.y[channel] - h @ (z - sensor.about), h @ P @ h + r
        total = kalman.judged(total, nu, s, mask)
        K = kalman.gain(P @ h, s, mask)
        z, P = z + K * nu, kalman.covariance(P, K, h, r)
    return z, P, total


def by_points(
    gains: Gains, mean: Float[Array, " joint"], J: Float[Array, "joint joint"], sample: Measurement
) -> tuple[Array, Array, InnovationStats]:
    """Return mean [N] and covariance [N, N] of z once a sample is known, by the joint moments of z and y."""
    value, N, total = value_of(gains, sample.value), gains.P0.shape[0], kalman.unjudged()
    for channel in range(gains.C.shape[0]):
        r, mask, c = gains.R[channel], sample.mask[channel], jnp.eye(mean.shape[0])[N + channel]
        nu, s = value[channel] - mean[N + channel], J[N + channel, N + channel] + r
        total = kalman.judged(total, nu, s, mask)
        K = kalman.gain(J[:, N + channel], s, mask)
        mean, J = mean + K * nu, kalman.covariance(J, K, c, r)
    return mean[:N], J[:N, :N], total
