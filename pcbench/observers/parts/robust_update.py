"""What a filter does with a sample that is far from what it expects: leave it out, or weigh it less.

With nu the innovation of a channel and s the variance that it is believed to have, z = |nu| / sqrt(s):

    gate:   z > gate: the channel is not used, unless `opens` of it were left out in a row: then it is, and counting begins anew
    huber:  z > k: s <- s z / k, so that the correction grows no more; its variance follows

A gate that never opens locks up: a filter that is wrong leaves out all that could mend it. The second is one step of Huber's
M-estimator. Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4; Huber 1964, 'Robust estimation of a location parameter'.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, PyTree
from pydantic import Field

from pcbench.observers.parts.kalman import Posterior
from pcbench.protocols import Leaf

GATE: Any = Field(
    None,
    gt=0,
    description="number of standard deviations of the innovation beyond which a sample is rejected; default: no gate",
)
OPENS: Any = Field(5, ge=1, le=10_000, description="number of rejected samples in a row after which the next is used")
HUBER: Any = Field(
    None,
    gt=0,
    description="number of standard deviations beyond which the weight of an innovation decreases; default: no limit",
)


class Guard(NamedTuple):
    """In standard deviations of an innovation; inf: nothing is far."""

    gate: Float[Leaf, ""]
    opens: Int[Leaf, ""]
    huber: Float[Leaf, ""]


class GuardedPosterior(NamedTuple):
    """A filter's posterior, and how many samples of each channel were left out in a row."""

    mean: Float[Array, " joint"]
    P: Float[Array, "joint joint"]
    taken: Int[Array, ""]
    left_out: Int[Array, " q"]


Known = Posterior | GuardedPosterior  # what a filter knows after a sample


def of(gate: float | None, opens: int, huber: float | None) -> PyTree:
    """Return what a filter is to do; (): nothing is far."""
    if gate is None and huber is None:
        return ()
    return Guard(*(np.asarray(np.inf if each is None else each) for each in (gate, opens, huber)))


def initial_posterior(first: Posterior, guard: PyTree, outputs: int) -> Known:
    """Return the state before the first sample."""
    return GuardedPosterior(*first, jnp.zeros(outputs, int)) if isinstance(guard, Guard) else first


def after(before: Known, mean: Array, P: Array, taken: Array, left_out: list[Array]) -> Known:
    """Return the state after a sample, of the kind of the one before."""
    return (
        GuardedPosterior(mean, P, taken, jnp.stack(left_out))
        if isinstance(before, GuardedPosterior)
        else Posterior(mean, P, taken)
    )


def weigh(
    guard: PyTree, before: Known, channel: int, nu: Array, s: Array, r: Array, mask: Array
) -> tuple[Array, Array, Array]:
    """Return whether a channel is used, the variance of its noise that it is used with, how many were left out in a row."""
    if not isinstance(before, GuardedPosterior):
        return mask, r, jnp.asarray(0)
    count, z = before.left_out[channel], jnp.abs(nu) / jnp.sqrt(s)
    out = mask & (z > guard.gate) & (count < guard.opens)
    after = jnp.where(out, count + 1, jnp.where(mask, 0, count))
    return mask & ~out, r + s * (jnp.maximum(z / guard.huber, 1.0) - 1.0), after
