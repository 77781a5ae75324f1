"""high-gain: high-gain observer of positions, rates and parameters, with delayed samples.

    z = [positions, rates, parameters], d of each:   z1' = z2,   z2' = a z3 + phi,   z3' = 0            (50)

a and phi are functions of the estimate and the delayed input, `parts` of the plant. With the gain parameter Th and D^-1 =
diag(1, Th, Th^2):

    z'  = A(z) z + phi(u_tau, z) - Th D^-1 S^-1 C' g,        al' = -Th C S^-1 C' g                       (6)
    S'  = Th (-S - A(z)' S - S A(z) + C' C),                 S(0) = 1e-3 I
    g(t) = al(t) + c_k on [t_k, t_k+1),   c_k = C z(t_s) - al(t_s) - y_k   of the newest sample, taken at t_s

- al is never reset. The snapshot of a sample is C z - al at its sampling time. Because (C z - al)' = z2, al predicts the
  output between samples.
- S consists of one 3 x 3 block per position, stored as the rows 11 12 13 22 23 33. S^-1 C' is the first column of each
  inverse.
- The gain of the parameters is Th^3 / a, which is singular at an estimated rate of 0.
- `robust` clips rates in a and phi to +-5. It clips parameters to the plant's range in the product and after each tick, and
  adds Th rho to S33'. The printed observer diverges from many initial states.

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, (6), (50). Different from print: signs restored. A tick is one
Runge-Kutta step of (z, al, S) with c_k and u held.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: convergence. The certificate reports how far Th Ts is from the limit of the linear case.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics.integrate import rk4
from pcbench.errors import UserError
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis import sampled_high_gain
from pcbench.synthesis.certificate import Design, DesignContext

S0 = 1e-3
FASTEST = 5.0  # rad/s, of the robust observer


class Gains(NamedTuple):
    """d positions."""

    parts: Any  # (u, x[2d]) -> a[d], phi[d]
    theta: Float[Leaf, ""]  # [1/s] Th
    rho: Float[Leaf, ""]  # 0: as printed
    fastest: Float[Leaf, ""]  # the largest rate in a and phi; inf: as printed
    low: Float[Leaf, " d"]  # range of the parameters; -inf, inf: as printed
    high: Float[Leaf, " d"]
    start: Float[Leaf, " d"]  # parameters at t = 0


class Memory(NamedTuple):
    """Memory between ticks."""

    z: Float[Array, " 3*d"]
    al: Float[Array, " d"]
    S: Float[Array, "6 d"]  # rows 11 12 13 22 23 33
    c: Float[Array, " d"]
    newest: Int[Array, " d"]  # index of the sample of c; -1: none


class Options(StrictOptions):
    """Tuning parameters."""

    theta: float = tunable(4.0, gt=0, description="gain parameter [1/s]; larger is faster")
    robust: bool = Field(False, description="limit rates and parameters to their range, and add a leak to S")
    rho: float = Field(0.1, gt=0, description="robust: size of the leak")


def init(gains: Gains, xhat0: Float[Array, " 2*d"]) -> Memory:
    """Return the memory at xhat(0) and the initial parameters, with al = 0 and S(0)."""
    d = gains.start.shape[0]
    S = S0 * jnp.outer(jnp.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]), jnp.ones(d))
    return Memory(jnp.concatenate([xhat0, gains.start]), jnp.zeros(d), S, jnp.zeros(d), jnp.full(d, -1, int))


def snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, " d"]:
    """Return C z - al."""
    return memory.z[: memory.al.shape[0]] - memory.al


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Compute c from the arriving sample, unless a newer sample is in use."""
    newer = arrival.mask & (arrival.index > memory.newest)
    c = jnp.where(newer, arrival.snapshot - arrival.value, memory.c)
    return memory._replace(c=c, newest=jnp.where(newer, arrival.index, memory.newest))


def column(S: Float[Array, "6 d"]) -> Float[Array, "3 d"]:
    """Return the first column of the inverse of every block."""
    s11, s12, s13, s22, s23, s33 = S
    c1, c2, c3 = s22 * s33 - s23**2, s13 * s23 - s12 * s33, s12 * s23 - s13 * s22
    det = s11 * c1 + s12 * c2 + s13 * c3
    return jnp.stack([c1 / det, c2 / det, c3 / det])


def rates(gains: Gains, memory: Memory, now: Now, g: Float[Array, " d"]) -> Memory:
    """Return d memory/dt for an innovation g; c is constant."""
    d, th = memory.al.shape[0], gains.theta
    z1, z2, z3 = memory.z[:d], memory.z[d : 2 * d], memory.z[2 * d :]
    a, phi = gains.parts(now.u, jnp.concatenate([z1, jnp.clip(z2, -gains.fastest, gains.fastest)]))
    k1, k2, k3 = (th * column_entry * g for column_entry in column(memory.S))
    z = jnp.concatenate([z2 - k1, a * jnp.clip(z3, gains.low, gains.high) + phi - th * k2, -(th**2) * k3])
    s11, s12, s13, s22, s23, s33 = memory.S
    S = th * jnp.stack(
        [1 - s11, -s12 - s11, -s13 - a * s12, -s22 - 2 * s12, -s23 - s13 - a * s22, -s33 - 2 * a * s23 + gains.rho]
    )
    return Memory(z, -k1, S, jnp.zeros(d), jnp.zeros_like(memory.newest))


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick, with c and u held."""
    state = rk4(lambda t, m: rates(gains, memory._replace(z=m[0], al=m[1], S=m[2]), now, m[1] + memory.c)[:3],
                now.t, tuple(memory[:3]), now.dt)  # fmt: skip
    z, d = state[0], memory.al.shape[0]
    z = jnp.concatenate([z[: 2 * d], jnp.clip(z[2 * d :], gains.low, gains.high)])
    return memory._replace(z=z, al=state[1], S=state[2])


def estimate(gains: Gains, memory: Memory) -> Float[Array, " 3*d"]:
    """Return z: present positions, rates and parameters."""
    return memory.z


OBSERVER = Observer(init, snapshot, jump, flow, estimate)


def design(context: DesignContext, options: Options) -> Design:
    """Return the parameters; the certificate reports the distance from the linear limit of the sampling period."""
    if context.parts is None:
        raise UserError(
            f"high-gain in {context.scenario}: got a plant that is not a chain of positions, rates and parameters, expected "
            "the helicopter; use ekf, or an observer for linear plants."
        )
    low, high = np.array(context.unknown_range).T
    unbounded = np.full_like(low, np.inf)
    robust = options.robust
    gains = Gains(
        parts=context.parts,
        theta=np.asarray(options.theta),
        rho=np.asarray(options.rho if robust else 0.0),
        fastest=np.asarray(FASTEST if robust else np.inf),
        low=low if robust else -unbounded,
        high=high if robust else unbounded,
        start=np.array(context.unknown0),
    )
    return Design(gains, sampled_high_gain.certificate(options.theta, max(context.period) * context.dt))
