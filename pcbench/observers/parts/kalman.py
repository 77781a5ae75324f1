"""Kalman update by one channel after the other, for Kalman filters and for filters of nonlinear models, and its certificate.

For y = c'x + v with v ~ N(0, r), the update of P is in Joseph form, which keeps P >= 0:

    K = P c (c'P c + r)^-1,   x <- x + K (y - c'x),   P <- (I - K c') P (I - K c')' + K r K'

If the noise of the channels is independent, this equals the joint update, and the sum of nu^2 / s over the channels is nu'
S^-1 nu.

Update of z ~ N(m, P) by a nonlinear sensor:

- `update_linearized`: y ~ yhat + H (z - z_lin), in Joseph form also if R is far smaller than H P H'.
- `update_by_moments`: J is the joint covariance of z and y from weighted points, and c selects y_j: K = J c (c'J c + r)^-1,
  m <- m + K (y_j - c'm), and J as P above.

If y = H z, both are the Kalman update.

The certificate of a Kalman filter is its covariance recursion over the horizon, at the (mean) periods.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int, PyTree

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix
from pcbench.observers.parts.common import for_each_channel
from pcbench.observers.parts.nonlinear_model import Gains, linearize_output, value_near
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import InnovationStats, Now
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import Certificate, DesignContext

MeanAndCovariance = tuple[Array, Array]


class Posterior(NamedTuple):
    """Mean and covariance at the time of a sample, after its use."""

    mean: Float[Array, " joint"]  # states and estimated unknowns, and possibly a copy of both
    P: Float[Array, "joint joint"]
    tick: Int[Array, ""]


def gain(Pc: Float[Array, " n"], variance: Float[Array, ""], mask: Bool[Array, ""]) -> Float[Array, " n"]:
    """Return K of a channel whose innovation has this variance; 0 if the channel did not arrive."""
    return jnp.where(mask, Pc / variance, 0.0)


def covariance(
    P: Float[Array, "n n"], K: Float[Array, " n"], c: Float[Array, " n"], r: Float[Array, ""]
) -> Float[Array, "n n"]:
    """Return P after the use of a channel with the gain K."""
    I_KC = jnp.eye(c.shape[0]) - jnp.outer(K, c)
    return I_KC @ P @ I_KC.T + r * jnp.outer(K, K)


def with_copy(P: Float[Array, "m m"], n: int) -> Float[Array, "joint joint"]:
    """Return the joint covariance of the first n entries and a copy of them."""
    return jnp.tile(P[:n, :n], (2, 2))


def pad_columns(C: Float[Array, "q n"], size: int) -> Float[Array, "q size"]:
    """Return C with columns of zeros, for a state of `size` entries, the last of which are copies."""
    return C if C.shape[1] == size else jnp.pad(C, ((0, 0), (0, size - C.shape[1])))


def innovation_stats(nu: Float[Array, " q"], s: Float[Array, " q"], mask: Bool[Array, " q"]) -> InnovationStats:
    """Return the statistics of innovations nu of variance s, one channel after the other; `mask`: channels that arrived."""
    sigma = jnp.sqrt(s)
    z = nu / sigma
    return InnovationStats(
        nis_sum=jnp.where(mask, nu * nu / s, 0.0).sum(),
        dof=jnp.where(mask, 1.0, 0.0).sum(),
        log_det=jnp.where(mask, jnp.log(s), 0.0).sum(),
        normalized_sum=jnp.where(mask, z, 0.0).sum(),
        normalized=jnp.where(mask, z, jnp.nan),
        sigma=jnp.where(mask, sigma, jnp.nan),
    )


def update_linearized(
    gains: Gains,
    now: Now,
    z: Float[Array, " N"],
    P: Float[Array, "N N"],
    sample: Measurement,
    z_lin: Float[Array, " N"],
) -> tuple[Array, Array, InnovationStats]:
    """Return mean, covariance and innovation statistics of z after a sample, by the output linearised at z_lin."""
    y, H = linearize_output(gains, now, z_lin)

    def use_channel(posterior: MeanAndCovariance, channel: PyTree) -> tuple[MeanAndCovariance, PyTree]:
        (z, P), (h, value, y, r, mask) = posterior, channel
        nu, s = value - y - h @ (z - z_lin), h @ P @ h + r
        K = gain(P @ h, s, mask)
        return (z + K * nu, covariance(P, K, h, r)), (nu, s)

    channels = H, value_near(gains, sample.value, y), y, sample.variances(gains.R), sample.mask
    (z, P), (nu, s) = for_each_channel(use_channel, (z, P), channels)
    return z, P, innovation_stats(nu, s, sample.mask)


def update_by_moments(
    gains: Gains, mean: Float[Array, " joint"], J: Float[Array, "joint joint"], sample: Measurement
) -> tuple[Array, Array, InnovationStats]:
    """Return mean [N], covariance [N, N] and innovation statistics of z after a sample, by the joint moments of z and y."""
    N, rows, innovations = gains.P0.shape[0], jnp.eye(mean.shape[0]), []
    value, R = value_near(gains, sample.value, mean[N:]), sample.variances(gains.R)
    for channel in range(gains.C.shape[0]):  # written out, so that the zeros of each row are known
        r, mask, c = R[channel], sample.mask[channel], rows[N + channel]
        nu, s = value[channel] - mean[N + channel], J[N + channel, N + channel] + r
        innovations.append(jnp.stack([nu, s]))
        K = gain(J[:, N + channel], s, mask)
        mean, J = mean + K * nu, covariance(J, K, c, r)
    nu, s = jnp.stack(innovations, 1)
    return mean[:N], J[:N, :N], innovation_stats(nu, s, sample.mask)


def certificate(gains: PyTree, model: linear.Model, Q: Matrix, context: DesignContext) -> Certificate:
    """Return the certificate; its margin is the least innovation variance over the horizon relative to R, NaN unless P >= 0."""
    bits = linear.bits_for(context.ticks)
    binary_maps = linear.doublings(model, context.dt, bits)
    noise = linear.noise_doublings(model, Q, context.dt, bits)
    run = riccati.multirate(binary_maps, noise, gains.C, gains.R, gains.P0, context.period, context.ticks)
    numbers = {"P_end": run.P, "K_end": run.K, "R": gains.R, "innovation_over_R": run.innovation}
    margin = run.innovation if run.least > -1e-9 else float("nan")
    return Certificate("c P c' + r > 0 and P >= 0 at every sample", margin, "recursion", "run", numbers)
