"""Observers that work sample by sample, in deviations from the model alone: what they share.

The model alone, xbar(k+1) = A xbar(k) + B u(k) from xbar(0) = xhat(0), takes all of the input; z = xhat - xbar then moves
without any, from z = 0, before any sample has arrived too. Samples are taken every `period` ticks, all channels together; at
the ticks between, the estimate is xbar + e^{A t} z, t the time since the last sample. What belongs to past samples is kept in
rings by sample number, zeros before the first. Where an unstable model grows past 1e16 over the horizon, the deviation loses
all its digits.
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


def _inside(pole: float) -> float:
    if not -1 < pole < 1:
        raise ValueError("a pole inside the unit circle, between -1 and 1: at 0 errors vanish, near 1 they stay")
    return pole


Pole = Annotated[float, AfterValidator(_inside)]  # of an observer's error, per step


class SampledModel(NamedTuple):
    """A model of one tick, and the sampling it is seen by; n states, m inputs, q outputs."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    period: Int[Leaf, ""]  # ticks between samples


class ModelRun(NamedTuple):
    """The model alone on its way between two samples; the same for all runs."""

    tick: Int[Array, ""]
    sample: Int[Array, ""]  # number of the last one, from 0
    xbar: Float[Array, " n"]  # the model alone, now
    carried: Float[Array, "n n"]  # e^{A t}


def model_of(setting: DesignContext) -> SampledModel:
    """Return a cell's model in NumPy."""
    Phi, Gamma = linear.one_tick(setting.model, setting.dt)
    return SampledModel(Phi, Gamma, setting.model.C, setting.model.feedthrough, np.asarray(setting.period[0]))


def start(xhat0: Float[Array, " n"]) -> ModelRun:
    """Start at the first sample, with xbar = xhat(0)."""
    return ModelRun(jnp.asarray(0), jnp.asarray(0), xhat0, jnp.eye(xhat0.shape[0]))


def flow(model: SampledModel, run: ModelRun, now: Now) -> tuple[ModelRun, Bool[Array, ""]]:
    """Advance by one tick; say whether a sample is due there."""
    tick = run.tick + 1
    due = tick % model.period == 0
    carried = jnp.where(due, jnp.eye(run.xbar.shape[0]), model.Phi @ run.carried)
    return ModelRun(tick, tick // model.period, model.Phi @ run.xbar + model.Gamma @ now.u, carried), due


def ring(room: Room, entry: Shaped[Array, "..."]) -> Shaped[Array, "rows ..."]:
    """Return a ring that holds `entry` for every sample there is room for; its last row is for what is not kept."""
    return jnp.broadcast_to(entry, (room.shape[0] + 2, *entry.shape))


def read(ring: Shaped[Array, "rows ..."], sample: Int[Array, ""]) -> Shaped[Array, "..."]:
    """Return what a ring holds for a sample; the number may be traced, and below 0."""
    return lax.dynamic_index_in_dim(ring, sample % (ring.shape[0] - 1), 0, False)


def write(
    ring: Shaped[Array, "rows ..."], sample: Int[Array, ""], entry: Shaped[Array, "..."], when: Bool[Array, ""]
) -> Shaped[Array, "rows ..."]:
    """Put an entry in a sample's place, where `when` is true; without copying the ring."""
    last = ring.shape[0] - 1
    return lax.dynamic_update_index_in_dim(ring, entry, jnp.where(when, sample % last, last), 0)
