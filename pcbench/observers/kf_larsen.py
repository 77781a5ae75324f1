"""kf-larsen: the late measurement extrapolated to now, with the gain that is right for it.

    xhat <- xhat + K (y - C xhat(t_m)),   K = M P_m C' (C P_m C' + r)^-1,   P <- P - K C P_m M'

xhat(t_m) and P_m are what was estimated when the sample was taken, and M P_m the covariance of the error then and now; M
is the product of all that has happened to the error between. Here M P_m is carried as the covariance with a copy that its
own sample alone corrects (`parts/stochastic_cloning`), which is exact for any number of samples on their way; printed is one at
a time.

Source: Larsen, Andersen, Ravn, Poulsen 1998. Keeps a copy for each sample on its way; costs `kf-cloning`'s memory here,
of print n x n each.
Found: the gain is the best there is for this innovation, so P is true. It is `kf` where nothing arrives between a
sample's taking and its arrival. What does arrive there tells of the past too, and the innovation does not know it: it
lies above `kf` from two samples on their way on, by how much says `test_late_samples`.
Time index: the estimate is of now, after the jump.
"""

import jax.numpy as jnp
from jax import Array

from pcbench.observers.parts import linear_filter, stochastic_cloning
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def local(h: Array, s: Array, near: Array) -> Array:
    """Return the gain of the present and of the sample's own copy: channels taken together are one measurement."""
    return jnp.where(near, h / s, 0.0)


OBSERVER = stochastic_cloning.observer(local)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, with room for the copies."""
    own, why = (
        stochastic_cloning.room(setting, "kf-larsen"),
        "its innovation ignores measurements that arrive in between",
    )
    return linear_filter.design(setting, options, "kf-larsen", own=own, unproven=why)
