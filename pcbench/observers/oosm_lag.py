"""oosm-lag: an out-of-sequence sample of several steps' lag by one retrodiction.

All updates after the sample's time are taken for one equivalent update now. With x*, P* what the last posterior before
the sample predicts for t_k without any of them,

    u = P*^-1 (x - x*),   U = P*^-1 (P* - P) P*^-1

and then as `oosm-a1`. A sample older than the posteriors kept is lost.

Source: Bar-Shalom, Chen, Mallick 2004, the first of its two algorithms. Keeps `keep` past means and covariances; costs
what `oosm-a1` does, and a solution of n equations. Found: with one step it is `oosm-a1`; with more it lies above `kf`,
for the noise between two of the updates is not seen by the earlier ones, by 0.1 % in rms on the tests' plant
(`test_late_excess`). Past posteriors are not mended when a late sample comes. P* must be regular (`test_late_samples`).
Time index: the estimate is of now, after the jump.
"""

import jax.numpy as jnp
from jax import Array
from pydantic import Field

from pcbench.observers.parts import linear_filter, retrodiction
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.linear_filter import Gains
from pcbench.observers.parts.retrodiction import Last, Memory
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """How far it can go back."""

    keep: int = Field(4, ge=1, le=64, description="number of past estimates that are stored with their covariance")


def equivalent(gains: Gains, memory: Memory, taken: Array) -> Last:
    """Return the update that all after `taken` amount to."""
    known = memory.past.taken <= taken
    newest = known & (jnp.cumsum(known[::-1])[::-1] == 1)  # the last that holds: several may be of one tick
    before = Posterior(*(jnp.tensordot(newest.astype(a.dtype), a, 1) for a in memory.past))
    there = linear_filter.predict_posterior(gains, before, memory.posterior.taken)
    x, P, _ = memory.posterior
    inverse = jnp.linalg.inv(there.P)
    return Last(there.P, inverse @ (x - there.mean), inverse @ (there.P - P) @ inverse)


OBSERVER = retrodiction.observer(equivalent, zero=False)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, and the maps back in time."""
    return retrodiction.design(setting, options, "oosm-lag", options.keep, "several updates are taken for one")
