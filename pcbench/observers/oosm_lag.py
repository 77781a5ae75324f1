"""oosm-lag: Kalman filter with an update by an out-of-sequence sample over several steps, by one retrodiction.

All updates after the sampling time are replaced by one equivalent update at t_k. Let x*, P* be the prediction for t_k from
the last posterior before the sample:

    u = P*^-1 (x - x*),   U = P*^-1 (P* - P) P*^-1

Then the update is that of `oosm-a1`. A sample older than the stored posteriors is lost.

Source: Bar-Shalom, Chen, Mallick 2004, the first of its two algorithms. Memory: `keep` past means and covariances. Cost: as
`oosm-a1`, and the inverse of an n x n matrix.
With one step it equals `oosm-a1`. With more, it neglects that the process noise between two updates does not affect the
earlier one, and its error is larger than that of `kf`, by 0.1 % in rms on the plant of the tests (`test_late_excess`). An
out-of-sequence sample does not change the stored posteriors. P* must be regular (`test_late_samples`).
Time index: xhat is the estimate of the present, after the jump.
"""

import jax.numpy as jnp
from jax import Array
from pydantic import Field

from pcbench.observers.parts import linear_filter, retrodiction
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.linear_filter import Gains
from pcbench.observers.parts.retrodiction import LastUpdate, Memory
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """Number of stored posteriors."""

    keep: int = Field(4, ge=1, le=64, description="number of past estimates that are stored with their covariance")


def equivalent(gains: Gains, memory: Memory, tick: Array) -> LastUpdate:
    """Return one update that is equivalent to all updates after `tick`."""
    is_earlier = memory.past.ticks <= tick
    newest = is_earlier & (jnp.cumsum(is_earlier[::-1])[::-1] == 1)  # the last one: several may have the same tick
    before = Posterior(*(jnp.tensordot(newest.astype(a.dtype), a, 1) for a in memory.past))
    prior = linear_filter.predict_posterior(gains, before, memory.posterior.tick)
    x, P, _ = memory.posterior
    inverse = jnp.linalg.inv(prior.P)
    return LastUpdate(prior.P, inverse @ (x - prior.mean), inverse @ (prior.P - P) @ inverse)


OBSERVER = retrodiction.observer(equivalent, neglect_noise=False)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, and the maps back in time."""
    return retrodiction.design(context, options, "oosm-lag", options.keep, "it replaces several updates by one")
