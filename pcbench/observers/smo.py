"""SMO: sliding-mode observer with reconstruction of the unknown input.

    v = rho P2 s / (||P2 s|| + eps),   s = Tp (y - C xhat)                                   (21), smoothed as in section 5

v is injected as in `parts/unknown_input`, and tends to [0; E222 f] (on the arm E222 = 1). So rho bounds |E222 f|, and an
error of s of about eps |E222 f| / rho remains. With the gains of LMI (23), (24), the unmeasured part of the error decays for
every f:

    ebar1 = e1 - L1 s1,   ebar1' = (A11 - L1 A211) ebar1

Source: Peng, Appl. Sci. 2017, 7(1), 67, sections 3 and 5; minus signs restored. The printed gains are for the arm.
Not claimed: an error of zero. The certificate proves a decay rate without the unknown input and without sampling.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.observers.parts import unknown_input
from pcbench.observers.parts.options import tunable
from pcbench.protocols import Leaf
from pcbench.scenarios import arm
from pcbench.synthesis import sliding_mode
from pcbench.synthesis.certificate import Design, DesignContext, require_certified
from pcbench.synthesis.unknown_input import injection, split

PRINTED = sliding_mode.SlidingModeGains(
    L1=np.array([[0.8148], [2.4893]]),
    P1=np.array([[13.5959, -4.2094], [-4.2094, 2.4078]]),
    P2=np.array([[1.0070, 0.0021], [0.0021, 1.0024]]),
    A22s=np.array([[-2.5881, 0.0141], [0.0141, -2.6187]]),
    r=float("nan"),
    status="printed",
    solver="none",
)


class SlidingLaw(NamedTuple):
    """p outputs."""

    P2: Float[Leaf, "p p"]
    rho: Float[Leaf, ""]  # the largest |E222 f| that can be reconstructed
    eps: Float[Leaf, ""]  # width of the boundary layer


class Options(unknown_input.Options):
    """Design of the gains, and the injection."""

    alpha: float = tunable(1.0, gt=0, description="design: decay rate of the error [1/s]")
    rho: float = tunable(1.0, gt=0, description="bound of the unknown input, scaled by E222")
    eps: float = tunable(0.005, gt=0, description="width of the boundary layer in which the injection is smooth")


def inject(
    law: SlidingLaw, s: Float[Array, " p"], w: Float[Array, " p"]
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Return v (21), and no integral."""
    direction = law.P2 @ s
    return law.rho * direction / (jnp.sqrt(direction @ direction) + law.eps), jnp.zeros_like(w)


OBSERVER = unknown_input.observer(inject)


def design(context: DesignContext, options: Options) -> Design:
    """Return the printed gains or those by LMI (23), (24), with a certified decay rate."""
    where = f"smo in {context.scenario}"
    parts = split(context.model, where)
    unknown_input.require_one_delay(context, where)
    if options.gains == "paper":
        unknown_input.require_plant(arm.LINEAR, context, where)
        sliding_gains = PRINTED
        certificate = require_certified(sliding_mode.certify(sliding_gains, parts), where)
    else:
        sliding_gains, certificate = sliding_mode.design(parts, options.alpha, where)
    gain = options.rho * float(np.linalg.norm(sliding_gains.P2, 2)) / options.eps
    unknown_input.require_short_tick(context, gain, "rho |P2| / eps", where)
    law = SlidingLaw(np.asarray(sliding_gains.P2), np.asarray(options.rho), np.asarray(options.eps))
    gains = unknown_input.gains_of(context, parts, injection(parts, sliding_gains.L1, sliding_gains.A22s), law, options)
    return Design(gains, certificate, unknown_input.carries(context, options))
