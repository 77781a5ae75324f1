"""CDOB: communication disturbance observer, which estimates the effect of a delay as a disturbance of the input.

A plant with a delay is y = P(s) e^(-sT) u = P(s) (u - d), with d(t) = u(t) - u(t - T). A disturbance observer estimates d,
and P d is added to the output:

    dh = Q (u - y / P),   yhat = y + P dh = P u + (1 - Q) (y - P u),   Q(0) = 1

With Q = 1 this is P u: a Smith predictor that does not need the value of the delay. Here, for samples of period T_s:

    at an arrival:  i = y - C z,   z <- z + L i,   dh <- dh - l i,   xhat <- xhat + L i       the age is not used
    over a tick:    z <- Phi z + Gamma (u - dh),   xhat <- Phi xhat + Gamma u

z is the state that belongs to the delayed output, xhat is the state of yhat, and xhat - z is the response of P to dh. The
poles of (z, dh) are at one bandwidth, exp(-omega T_s), so Q is (omega / (s + omega))^(n+1) for short periods.

Source: Natori, Ohnishi, IEEE Trans. Industrial Electronics 55(5), 2008, and Natori, Oboe, Ohnishi, IEEE Trans. Industrial
Informatics 4(3), 2008, for the structure; the texts were not obtained. The sampled form, the order of Q and the use of the
state are this project's.
Schedule: samples of any age and order, each used when it arrives.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: perfect start. With a true model and a true initial state, the error is (1 - Q) (1 - e^(-sT)) P u. It is 0
without a delay, and tends to 0 as the bandwidth grows. Because Q(0) = 1, the observer never removes a constant initial error
or a constant disturbance: it attributes both to a delay.
Refused: plants that are not a chain of integrators from one input to one output (`synthesis.bandwidth.chain_of`), and
unstable plants, on which P u grows.
"""

from math import exp
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers.parts.common import no_snapshot, xhat
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis import bandwidth
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate, one_clock

GROWTH = 1e-6  # 1/s: modes that grow more slowly count as integrators


class Gains(NamedTuple):
    """n states, one input, one output."""

    Phi: Float[Leaf, "n n"]  # of one tick
    Gamma: Float[Leaf, "n 1"]
    C: Float[Leaf, "1 n"]
    L: Float[Leaf, "n 1"]  # of z
    l: Float[Leaf, "1 1"]  # of -dh


class Memory(NamedTuple):
    """State of the delayed output, disturbance, and estimate."""

    z: Float[Array, " n"]
    dh: Float[Array, "1"]
    xhat: Float[Array, " n"]


class Options(StrictOptions):
    """The bandwidth of Q."""

    pole: float = tunable(0.5, (0.0, 0.999), ge=0, le=0.999, description="pole of Q per sample; 0: deadbeat")
    omega: float | None = Field(None, gt=0, description="bandwidth of Q [1/s], instead of `pole`: pole = exp(-omega T)")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), without a disturbance."""
    return Memory(xhat0, jnp.zeros(1), xhat0)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Correct z and dh by the arriving sample as if it had been taken now, and xhat by the same amount as z."""
    innovation = jnp.where(arrival.mask, arrival.value - gains.C @ memory.z, 0.0)
    correction = gains.L @ innovation
    return Memory(memory.z + correction, memory.dh - gains.l @ innovation, memory.xhat + correction)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick under the held input."""
    z = gains.Phi @ memory.z + gains.Gamma @ (now.u - memory.dh)
    return Memory(z, memory.dh, gains.Phi @ memory.xhat + gains.Gamma @ now.u)


OBSERVER = Observer(init, no_snapshot, jump, flow, xhat)


def design(context: DesignContext, options: Options) -> Design:
    """Place the poles at the mean period.

    Raises UserError if the plant is not a chain of integrators from its input to its output, or is unstable.
    """
    period, where = one_clock(context, "cdob"), f"cdob in {context.scenario}"
    model = context.model._replace(E=None)
    bandwidth.chain_of(model, where)
    fastest = float(np.max(np.linalg.eigvals(model.A).real))
    if fastest > GROWTH:
        raise UserError(
            f"{where}: got a plant with a mode that grows by {fastest:.3g} 1/s, expected a stable plant or a chain of "
            "integrators, as an error of the start would grow too; use kf."
        )
    seconds = period * context.dt
    Phi, Gamma_sample = linear.discretize_zoh(model.A, model.B, seconds)
    pole = options.pole if options.omega is None else exp(-options.omega * seconds)
    n = len(Phi)
    joint_map, C = np.block([[Phi, Gamma_sample], [np.zeros((1, n)), np.eye(1)]]), np.hstack([model.C, [[0.0]]])
    L = bandwidth.current_gain(joint_map, C, pole, pole, where)
    Phi, Gamma = linear.one_tick(model, context.dt)
    return Design(Gains(Phi, Gamma, model.C, L[:n], L[n:]), no_certificate("it ignores delays"))
