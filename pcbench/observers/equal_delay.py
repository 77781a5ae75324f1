"""equal-delay: observer that assumes the same delay d for all channels (Method 2 of the paper).

`variant = "theorem1"` is a single link of the chain. It treats whatever has arrived as d samples old:

    xhat(k) = A^d xhat(k-d) + response to the input + K e(k),   e(k) = r(k) - C xhat(k-d) - D u(k-d),   A^d - K C = F       (6)

`variant = "held"` (default) is a slow observer with the same assumption, xhat(k+1) = A xhat(k) + B u(k) + K e(k) with K =
kappa A pinv(C). kappa = d^d / (d+1)^(d+1) (4/27 for d = 2) is the largest gain for which e(k+1) = e(k) - kappa e(k-d) does
not oscillate. It replaces the design that the paper cites and does not print.
Both variants are stable, and biased if a delay differs from d. d is the option `delay`; by default it is the shortest delay
of the channels, at least one sample.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorem 1 and section 5.
Not claimed: perfect start, unless every delay is d, because the observer does not use the schedule.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from pcbench.dynamics.linear import spectral_radius
from pcbench.errors import UserError
from pcbench.observers.parts import assumed_age
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.sample_rate import Pole
from pcbench.synthesis.certificate import Certificate, Design, DesignContext, require_certified
from pcbench.synthesis.error_bounds import rate_of
from pcbench.synthesis.pole_placement import by_poles
from pcbench.synthesis.sampled_model import MAX_ROWS, delayed_radius, power, sample_plant

OBSERVER = assumed_age.OBSERVER


class Options(StrictOptions):
    """The variant, and the assumed delay."""

    variant: Literal["held", "theorem1"] = Field(
        "held", description="held: a slow observer without oscillation; theorem1: a single link of `chain`"
    )
    delay: int | None = Field(None, ge=1, le=200, description="assumed delay [samples]; default: the shortest delay")
    pole: Pole = tunable(1e-4, (-1, 1), description="theorem1: pole of the error over the delay")


def design(context: DesignContext, options: Options) -> Design:
    """Design for the assumed delay, and certify the gain for that delay only; delays other than d act as a disturbance."""
    where, plant = f"equal-delay in {context.scenario}", sample_plant(context, "equal-delay")
    d, A = options.delay or max(min(plant.tau), 1), plant.A
    if options.variant == "theorem1":
        K, Ad = by_poles(plant, d, options.pole, where), power(A, d)
        rate = spectral_radius(Ad - K @ plant.C) ** (1 / d)
        gains = assumed_age.gains_of(context, Ad, K, (d,) * len(plant.tau), stride=d)
    else:
        K = d**d / (d + 1) ** (d + 1) * A @ np.linalg.pinv(plant.C)
        rate = delayed_radius(A, K, plant.C, (d,) * len(plant.tau))
        if np.isnan(rate):
            raise UserError(
                f"{where}: got an assumed delay of {d} samples for {len(A)} states, expected at most "
                f"{MAX_ROWS // len(A) - 1}: stability is not computed beyond; give option delay or variant = 'theorem1'."
            )
        gains = assumed_age.gains_of(context, A, K, (d,) * len(plant.tau))
    inequality = f"radius of the errors' map < 1, if every delay were {d} sample{'s' * (d > 1)}"
    certificate = Certificate(
        inequality, 1 - rate, options.variant, "computed", {"K": K, "radius": rate, "assumed_delay": d}
    )
    if set(plant.tau) == {d}:  # otherwise the true delays act as a disturbance, and the rate is not certified
        certificate = certificate._replace(rate=rate_of(rate, plant.period * context.dt))
    return Design(gains, require_certified(certificate, where))
