"""NAME: your own observer, in one file.

    pcbench check NAME.py:NAME                                check that it follows the protocol
    pcbench run cart/white --observers NAME.py:NAME,kf       compare it with another observer in the same runs

An observer is five pure functions of its numbers (`gains`) and its state (`memory`). Write them in jax.numpy for one run;
pcbench applies them to thousands. n states, m inputs, q outputs. Times are in ticks. In the order of a tick:

    snapshot  returns the data that the observer needs later, when a sample is taken; jump gets it with the sample
    jump      uses a sample that arrives: arrival.value, .mask, .age, .snapshot
    estimate  returns the present estimate xhat [n]; pcbench reads it after the jump
    flow      advances by one tick under the input now.u

This observer compares a delayed sample with its estimate at the sampling time, and corrects the present estimate by a share of
the difference.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel

import pcbench


class Gains(NamedTuple):
    """All numbers of the observer, computed by `design`: nothing else may differ between grid points."""

    Phi: Any  # [n, n] one tick of the model: x -> Phi x + Gamma u
    Gamma: Any  # [n, m]
    C: Any  # [q, n]
    L: Any  # [n, q]


class Options(BaseModel):
    """Options that a study can set: [observers.NAME] use = "NAME.py:NAME", share = 0.2.

    `pcbench tune` changes the fields that pcbench.tunable declares.
    """

    share: float = pcbench.tunable(
        0.3, between=(0, 1), gt=0, lt=1, description="part of the innovation that corrects the estimate"
    )


def design(context: pcbench.DesignContext, options: Options) -> pcbench.Design:
    """Compute the gains, in NumPy, once per grid point.

    `context` has the model (A, B, C), dt [s], period and delay [ticks, one per output], noise_std, P0 and more. For gains
    without a certificate, use pcbench.no_certificate("reason").
    """
    Phi, Gamma = pcbench.discretize_zoh(context.model.A, context.model.B, context.dt)
    C = context.model.C
    d = context.delay[0] // context.period[0]  # error of the measured output: e_i = e_(i-1) - share e_(i-1-d)
    poles = np.roots([1, -1] + [0] * (d - 1) + [options.share] if d else [1, options.share - 1])
    certificate = pcbench.Certificate("|z| < 1 of the measured error", 1 - max(abs(poles)), "roots", "solved")
    return pcbench.Design(Gains(Phi, Gamma, C, options.share * C.T), pcbench.require_certified(certificate, "NAME"))


def init(gains: Gains, xhat0: Array) -> Array:
    """Return the initial memory, from xhat(0) [n]: any pytree of arrays."""
    return xhat0


def snapshot(gains: Gains, memory: Array, now: pcbench.Now) -> Array:
    """Return the data to store with a sample: a vector; jnp.zeros(0) for nothing."""
    return gains.C @ memory


def jump(gains: Gains, memory: Array, now: pcbench.Now, arrival: pcbench.Arrival) -> Array:
    """Use a sample that arrives. Channels with mask False did not arrive: ignore their values."""
    innovation = jnp.where(arrival.mask, arrival.value - arrival.snapshot, 0.0)
    return memory + gains.L @ innovation


def flow(gains: Gains, memory: Array, now: pcbench.Now) -> Array:
    """Advance by one tick under the held input now.u [m]."""
    return gains.Phi @ memory + gains.Gamma @ now.u


def estimate(gains: Gains, memory: Array) -> Array:
    """Return the present estimate xhat [n]."""
    return memory


NAME = pcbench.Observer(init, snapshot, jump, flow, estimate)
