"""Shared parts of observers that compute once per sample, in deviations from the model without measurements.

xbar(k+1) = A xbar(k) + B u(k) from xbar(0) = xhat(0) contains the response to the input. So z = xhat - xbar propagates
without input, from z = 0. Samples are taken every `period` ticks, all channels together. Between them the estimate is xbar +
e^{A t} z, with the time t since the last sample. Data of past samples are in ring buffers by sample number, with zeros before
the first sample.
If an unstable model grows beyond 1e16 over the horizon, the deviation has no correct digits.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int, Shaped
from pydantic import AfterValidator

from pcbench.dynamics import linear
from pcbench.protocols import Leaf, Now, Room
from pcbench.synthesis.certificate import DesignContext


def _require_stable(pole: float) -> float:
    if not -1 < pole < 1:
        raise ValueError("a pole inside the unit circle, between -1 and 1: at 0 errors vanish, near 1 they stay")
    return pole


Pole = Annotated[float, AfterValidator(_require_stable)]  # of an observer's error, per step


class SampledModel(NamedTuple):
    """A model of one tick, and its sampling; n states, m inputs, q outputs."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    period: Int[Leaf, ""]  # ticks between samples


class ModelRun(NamedTuple):
    """The model without measurements, between two samples; the same for all runs."""

    tick: Int[Array, ""]
    sample: Int[Array, ""]  # number of the last sample, from 0
    xbar: Float[Array, " n"]  # at the present tick
    transition: Float[Array, "n n"]  # e^{A t}


def model_of(context: DesignContext) -> SampledModel:
    """Return the model of a grid point in NumPy."""
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    return SampledModel(Phi, Gamma, context.model.C, context.model.feedthrough, np.asarray(context.period[0]))


def start(xhat0: Float[Array, " n"]) -> ModelRun:
    """Return the model at the first sample, with xbar = xhat(0)."""
    return ModelRun(jnp.asarray(0), jnp.asarray(0), xhat0, jnp.eye(xhat0.shape[0]))


def flow(model: SampledModel, run: ModelRun, now: Now) -> tuple[ModelRun, Bool[Array, ""]]:
    """Return the model one tick later, and whether that is a sampling tick."""
    tick = run.tick + 1
    is_sample = tick % model.period == 0
    transition = jnp.where(is_sample, jnp.eye(run.xbar.shape[0]), model.Phi @ run.transition)
    return ModelRun(tick, tick // model.period, model.Phi @ run.xbar + model.Gamma @ now.u, transition), is_sample


def ring(room: Room, entry: Shaped[Array, "..."]) -> Shaped[Array, "rows ..."]:
    """Return a ring buffer with `entry` for every sample that has room; its last row is for entries that are not stored."""
    return jnp.broadcast_to(entry, (room.shape[0] + 2, *entry.shape))


def at_sample(ring: Shaped[Array, "rows ..."], sample: Int[Array, ""]) -> Shaped[Array, "..."]:
    """Return a ring buffer's entry of a sample; the number may be traced, and negative."""
    return lax.dynamic_index_in_dim(ring, sample % (ring.shape[0] - 1), 0, False)


def write(
    ring: Shaped[Array, "rows ..."], sample: Int[Array, ""], entry: Shaped[Array, "..."], when: Bool[Array, ""]
) -> Shaped[Array, "rows ..."]:
    """Return the ring buffer with an entry of a sample, if `when` is True; without a copy of the buffer."""
    last = ring.shape[0] - 1
    return lax.dynamic_update_index_in_dim(ring, entry, jnp.where(when, sample % last, last), 0)
