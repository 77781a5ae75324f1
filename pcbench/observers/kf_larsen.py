"""kf-larsen: Kalman filter that extrapolates a delayed measurement to the present, with the optimal gain for this innovation.

    xhat <- xhat + K (y - C xhat(t_m)),   K = M P_m C' (C P_m C' + r)^-1,   P <- P - K C P_m M'

xhat(t_m) and P_m are estimate and covariance at the sampling time, and M P_m is the covariance between the error then and
now. M is the product of all propagations and updates of the error since. Here M P_m is the covariance with a copy that only
its own sample corrects (`parts/stochastic_cloning`). This is exact for any number of samples in transit; the source treats
one at a time.

Source: Larsen, Andersen, Ravn, Poulsen 1998. Memory: as `kf-cloning`, a copy per sample in transit; in the source, n x n
numbers per sample.
The gain is optimal for this innovation, so P is consistent. If no sample arrives between the sampling and the arrival of
another, the filter equals `kf`. Otherwise the innovation misses the information of the samples in between: from two samples
in transit on, the error is larger than that of `kf` (`test_late_samples`).
Time index: xhat is the estimate of the present, after the jump.
"""

import jax.numpy as jnp
from jax import Array

from pcbench.observers.parts import linear_filter, stochastic_cloning
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def local(h: Array, s: Array, pair_mask: Array) -> Array:
    """Return the gain of the present state and of the sample's own copy; channels sampled together are one measurement."""
    return jnp.where(pair_mask, h / s, 0.0)


OBSERVER = stochastic_cloning.observer(local)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, with room for the copies; there is no certificate."""
    room = stochastic_cloning.room(context, "kf-larsen")
    reason = "its innovation ignores measurements that arrive in between"
    return linear_filter.design(context, options, "kf-larsen", extra=room, reason=reason)
