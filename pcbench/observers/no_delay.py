"""no-delay: classical observer, designed as if measurements had no delay (Method 3 of the paper).

    xhat(k+1) = A xhat(k) + B u(k) + K e(k),   A - K C = pole I (or by pole placement)

- `plain`: e_j(k) = r_j(k) - C_j xhat(k), as if r_j had been taken at k. It cannot diverge on a bounded plant.
- `aligned` (default): e_j(k) = r_j(k) - C_j xhat(k - tau_j), where tau_j is the age of r_j. The present estimate is
  corrected. The design ignores the effect of the delays on stability: the feedback of channel j has a delay of tau_j + 1
  samples. With the gain above, the observer diverges on the tank.

The certificate's numbers contain the spectral radius with the true delays, which need not be below 1.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5, which does not state the variant that it uses. From a perfect
start, `aligned` has no error except for rounding errors, which grow with its spectral radius.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from pcbench.dynamics.linear import spectral_radius
from pcbench.observers.parts import assumed_age
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.sample_rate import Pole
from pcbench.synthesis.certificate import Certificate, Design, DesignContext, no_certificate, require_certified
from pcbench.synthesis.error_bounds import rate_of
from pcbench.synthesis.pole_placement import by_poles
from pcbench.synthesis.sampled_model import delayed_radius, sample_plant

OBSERVER = assumed_age.OBSERVER


class Options(StrictOptions):
    """The variant, and its pole."""

    variant: Literal["aligned", "plain"] = Field(
        "aligned", description="compare a sample with the estimate of its own time, or with the present estimate"
    )
    pole: Pole = tunable(1e-4, (-1, 1), description="pole of A - K C")


def design(context: DesignContext, options: Options) -> Design:
    """Design without delays; the gain is certified if the spectral radius with the delays is below 1 too."""
    where, plant = f"no-delay in {context.scenario}", sample_plant(context, "no-delay")
    K = by_poles(plant, 1, options.pole, where)
    ages = plant.tau if options.variant == "aligned" else (0,) * len(plant.tau)
    radius, radius_with_delays = spectral_radius(plant.A - K @ plant.C), delayed_radius(plant.A, K, plant.C, ages)
    numbers = {"K": K, "radius_without_delays": radius}
    if np.isfinite(radius_with_delays):  # not computed for a delay that is too long
        numbers["radius_with_these"] = radius_with_delays
    inequality = "radius of A - K C < 1, delays ignored"
    certificate = require_certified(Certificate(inequality, 1 - radius, "poles", "computed", numbers), where)
    if radius_with_delays < 1:
        certificate = certificate._replace(rate=rate_of(radius_with_delays, plant.period * context.dt))
    else:
        text = f"{radius_with_delays:.4g}, not below 1" if np.isfinite(radius_with_delays) else "not computed"
        certificate = no_certificate(f"designed without delays; the radius with these is {text}")._replace(
            numbers=numbers
        )
    return Design(assumed_age.gains_of(context, plant.A, K, ages), certificate)
