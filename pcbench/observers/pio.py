"""PIO: nonlinear integral-type observer, with an integral and a sign function instead of the sliding mode.

    v = KP s + w,   w' = KI s + xi sgn(s) elementwise,   w(0) = 0,   s = Tp (y - C xhat)     (35), (37)

v is injected as in `parts/unknown_input`, with A22s = 0 and sgn(0) = 0. Every Runge-Kutta stage evaluates sgn, so s chatters
with an amplitude that decreases with the tick. The unmeasured part of the error decays as that of `smo`, with the same L1.

Source: Peng, Appl. Sci. 2017, 7(1), 67, sections 4 and 5; minus signs restored. The printed gains are for the arm.
Not claimed: an error of zero if the unknown input changes faster than xi, or after a perfect start. The sign of a rounding
error changes w by xi per tick. So the error of the input is about that, and the error of the states about its square. The
certificate proves a decay rate without the unknown input, the sign function and sampling.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from pydantic import Field

from pcbench.dynamics.linear import Matrix
from pcbench.observers import smo
from pcbench.observers.parts import unknown_input
from pcbench.observers.parts.options import tunable
from pcbench.protocols import Leaf
from pcbench.scenarios import arm
from pcbench.synthesis import pi_lmi, sliding_mode
from pcbench.synthesis.certificate import Design, DesignContext, require_certified
from pcbench.synthesis.unknown_input import injection, split


def _published_gains() -> pi_lmi.PIGains:
    ones = np.ones(2)
    P = pi_lmi.form(np.array([[0.9163, -0.2602], [-0.2602, 0.1860]]), 0.8261 * ones, 0.3339 * ones, 0.3328 * ones)
    KP = np.array([[21.7396, 0.0278], [0.0283, 21.8043]])
    KI = np.array([[22.2876, 0.0272], [0.0288, 22.3538]])
    return pi_lmi.PIGains(KP, KI, P, float("nan"), "printed", "none")


PRINTED = _published_gains()


class IntegralLaw(NamedTuple):
    """p outputs."""

    KP: Float[Leaf, "p p"]
    KI: Float[Leaf, "p p"]
    xi: Float[Leaf, ""]


class Options(unknown_input.Options):
    """Design of the gains, and the injection."""

    alpha: float = Field(1.0, gt=0, description="design: decay rate of the unmeasured part of the error [1/s]")
    beta: float = tunable(1.0, gt=0, description="design: decay rate of the error [1/s]")
    xi: float = tunable(2.0, gt=0, description="bound of the slope of the unknown input, scaled by E222 [per second]")


def inject(
    law: IntegralLaw, s: Float[Array, " p"], w: Float[Array, " p"]
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Return v and w' (37)."""
    return law.KP @ s + w, law.KI @ s + law.xi * jnp.sign(s)


OBSERVER = unknown_input.observer(inject)


def design(context: DesignContext, options: Options) -> Design:
    """Return the printed gains or those by LMI (38), (52), with a certified decay rate."""
    where = f"pio in {context.scenario}"
    parts = split(context.model, where)
    unknown_input.require_one_delay(context, where)
    if options.gains == "paper":
        unknown_input.require_plant(arm.LINEAR, context, where)
        L1: Matrix = smo.PRINTED.L1
        pi_gains = PRINTED
        certificate = require_certified(pi_lmi.certify(pi_gains, parts, L1), where)
    else:
        L1 = sliding_mode.design(parts, options.alpha, where)[0].L1
        pi_gains, certificate = pi_lmi.design(parts, L1, options.beta, where)
    unknown_input.require_short_tick(context, float(np.linalg.norm(pi_gains.KP, 2)), "|KP|", where)
    law = IntegralLaw(np.asarray(pi_gains.KP), np.asarray(pi_gains.KI), np.asarray(options.xi))
    p = len(context.model.C)
    gains = unknown_input.gains_of(context, parts, injection(parts, L1, np.zeros((p, p))), law, options)
    return Design(gains, certificate, unknown_input.carries(context, options))
