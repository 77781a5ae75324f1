"""PIO: the nonlinear integral type observer, an integral and a sign in place of the sliding mode.

    v = KP s + w,   w' = KI s + xi sgn(s) elementwise,   w(0) = 0,   s = Tp (y - C xhat)     (35), (37)

injected as in `unknown_input` with A22s = 0; sgn(0) = 0, sgn is evaluated at every Runge-Kutta stage, so s chatters at a size
that shrinks with the tick. The unmeasured part of the error decays as that of `smo` does, with the same L1.

Source: Peng, Appl. Sci. 2017, 7(1), 67, sections 4 and 5; minus signs restored. The printed gains are for the arm.
Not claimed: that errors vanish where the unknown input changes faster than xi, or that nothing moves from a perfect start: the
sign of a rounding error moves w by xi a tick, so the input errs by about that, the states by its square. The certificate
proves a decay rate without the unknown input, the sign and sampling.
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
    one = np.ones(2)
    P = pi_lmi.form(np.array([[0.9163, -0.2602], [-0.2602, 0.1860]]), 0.8261 * one, 0.3339 * one, 0.3328 * one)
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
    """How the gains are found, and the injection."""

    alpha: float = Field(1.0, gt=0, description="design: decay rate of the unmeasured part of the error [1/s]")
    beta: float = tunable(1.0, gt=0, description="design: decay rate of the error [1/s]")
    xi: float = tunable(2.0, gt=0, description="bound of the slope of the unknown input, scaled by E222 [per second]")


def inject(
    law: IntegralLaw, s: Float[Array, " p"], w: Float[Array, " p"]
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Return v and w' (37)."""
    return law.KP @ s + w, law.KI @ s + law.xi * jnp.sign(s)


OBSERVER = unknown_input.observer(inject)


def design(setting: DesignContext, options: Options) -> Design:
    """Take the printed gains or find them by LMI (38), (52), and certify their decay rate."""
    where = f"pio in {setting.scenario}"
    parts = split(setting.model, where)
    unknown_input.one_delay(setting, where)
    if options.gains == "paper":
        unknown_input.printed_for(arm.LINEAR, setting, where)
        L1: Matrix = smo.PRINTED.L1
        found = PRINTED
        certificate = require_certified(pi_lmi.certify(found, parts, L1), where)
    else:
        L1 = sliding_mode.design(parts, options.alpha, where)[0].L1
        found, certificate = pi_lmi.design(parts, L1, options.beta, where)
    unknown_input.short_tick(setting, float(np.linalg.norm(found.KP, 2)), "|KP|", where)
    law = IntegralLaw(np.asarray(found.KP), np.asarray(found.KI), np.asarray(options.xi))
    p = len(setting.model.C)
    gains = unknown_input.gains_of(setting, parts, injection(parts, L1, np.zeros((p, p))), law, options)
    return Design(gains, certificate, unknown_input.carries(setting, options))
