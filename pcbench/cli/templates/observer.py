"""NAME: an observer of your own, in one file.

    pcbench check NAME.py:NAME                                does it keep to the protocol?
    pcbench run cart/white --observers NAME.py:NAME,kf       beside others, on the same draws

It is five pure functions of its numbers (`gains`) and its state (`memory`), written in jax.numpy for one run; pcbench carries
them over thousands. n states, m inputs, q outputs. Time is counted in ticks. In the order of a tick:

    snapshot  what the observer will need of the tick at which a sample is taken; it comes back with the sample
    jump      what it does when a sample arrives: arrival.value, .mask, .age, .snapshot
    estimate  what it says of the present, xhat [n], read after the jump
    flow      what it does over one tick, under the input now.u

This one compares a late sample with what it believed when that was taken, and corrects the present by a share of it.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel

import pcbench


class Gains(NamedTuple):
    """Every number it uses, found by `design`: nothing else may change from cell to cell."""

    Phi: Any  # [n, n] one tick of the model: x -> Phi x + Gamma u
    Gamma: Any  # [n, m]
    C: Any  # [q, n]
    L: Any  # [n, q]


class Options(BaseModel):
    """What a study may set: [observers.NAME] use = "NAME.py:NAME", share = 0.2.

    What `pcbench tune` may change is made by pcbench.tunable.
    """

    share: float = pcbench.tunable(
        0.3, between=(0, 1), gt=0, lt=1, description="part of the innovation that corrects the estimate"
    )


def design(setting: pcbench.DesignContext, options: Options) -> pcbench.Design:
    """Find the gains, in NumPy, once for each cell.

    `setting` has the model (A, B, C), dt [s], period and delay [ticks, one for each output], noise_std, P0 and more. Where
    nothing proves the gains, say so: pcbench.no_certificate("why").
    """
    Phi, Gamma = pcbench.discretize_zoh(setting.model.A, setting.model.B, setting.dt)
    C = setting.model.C
    late = setting.delay[0] // setting.period[0]  # the error of what is measured: e_i = e_(i-1) - share e_(i-1-late)
    poles = np.roots([1, -1] + [0] * (late - 1) + [options.share] if late else [1, options.share - 1])
    proof = pcbench.Certificate("|z| < 1 of the measured error", 1 - max(abs(poles)), "roots", "solved")
    return pcbench.Design(Gains(Phi, Gamma, C, options.share * C.T), pcbench.require_certified(proof, "NAME"))


def init(gains: Gains, xhat0: Array) -> Array:
    """Return the memory at the start, from xhat(0) [n]: any pytree of arrays."""
    return xhat0


def snapshot(gains: Gains, memory: Array, now: pcbench.Now) -> Array:
    """Return what is kept with a sample when it is taken: a vector; jnp.zeros(0) for nothing."""
    return gains.C @ memory


def jump(gains: Gains, memory: Array, now: pcbench.Now, arrival: pcbench.Arrival) -> Array:
    """Use what arrives. Channels that did not arrive are not fresh: their values mean nothing."""
    innovation = jnp.where(arrival.mask, arrival.value - arrival.snapshot, 0.0)
    return memory + gains.L @ innovation


def flow(gains: Gains, memory: Array, now: pcbench.Now) -> Array:
    """Advance by one tick under the held input now.u [m]."""
    return gains.Phi @ memory + gains.Gamma @ now.u


def estimate(gains: Gains, memory: Array) -> Array:
    """Return xhat of now, [n]."""
    return memory


NAME = pcbench.Observer(init, snapshot, jump, flow, estimate)
