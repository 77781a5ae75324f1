"""Pretending that all channels have one delay: what the chain is compared with first (Method 2 of the paper).

`theorem1`, a single link of the chain fed with whatever arrives, as if all of it were d samples old:

    xhat(k) = A^d xhat(k-d) + response to the input + K e(k),   e(k) = r(k) - C xhat(k-d) - D u(k-d),   A^d - K C = F       (6)

`held` (default), a slow observer of the same belief: xhat(k+1) = A xhat(k) + B u(k) + K e(k), K = kappa A pinv(C),
kappa = d^d / (d+1)^(d+1) (4/27 for d = 2), the largest for which e(k+1) = e(k) - kappa e(k-d) does not oscillate: in place of
the design that the paper cites and does not print. Both are stable and biased wherever a delay is not d.
The delay d believed is the shortest of the channels', one sample at least, or the option `delay`.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorem 1 and section 5. It does not know the schedule: no perfect start is
claimed unless every delay is d.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import assumed_age
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.sample_rate import Pole
from pcbench.synthesis import chain
from pcbench.synthesis.certificate import Certificate, Design, DesignContext, require_certified
from pcbench.synthesis.error_bounds import rate_of
from pcbench.synthesis.pole_placement import by_poles
from pcbench.synthesis.sampled_model import ROWS, delayed_radius, power, sample_plant

OBSERVER = assumed_age.OBSERVER


class Options(StrictOptions):
    """Which of the two, and the delay it believes in."""

    variant: Literal["held", "theorem1"] = Field(
        "held", description="held: a slow observer without oscillation; theorem1: a single link of `chain`"
    )
    delay: int | None = Field(None, ge=1, le=200, description="assumed delay [samples]; default: the shortest delay")
    pole: Pole = tunable(1e-4, (-1, 1), description="theorem1: pole of the error over the delay")


def design(setting: DesignContext, options: Options) -> Design:
    """Design for the believed delay and certify that alone; the delays as they are enter as a disturbance."""
    where, plant = f"equal-delay in {setting.scenario}", sample_plant(setting, "equal-delay")
    d, A = options.delay or max(min(plant.tau), 1), plant.A
    if options.variant == "theorem1":
        K, Ad = by_poles(plant, d, options.pole, where), power(A, d)
        rate = chain.radius(Ad - K @ plant.C) ** (1 / d)
        gains = assumed_age.gains_of(setting, Ad, K, (d,) * len(plant.tau), back=d)
    else:
        K = d**d / (d + 1) ** (d + 1) * A @ np.linalg.pinv(plant.C)
        rate = delayed_radius(A, K, plant.C, (d,) * len(plant.tau))
        if np.isnan(rate):
            raise UserError(
                f"{where}: got an assumed delay of {d} samples for {len(A)} states, expected at most "
                f"{ROWS // len(A) - 1}: stability is not computed beyond; give option delay or variant = 'theorem1'."
            )
        gains = assumed_age.gains_of(setting, A, K, (d,) * len(plant.tau))
    what = f"radius of the errors' map < 1, if every delay were {d} samples"
    certificate = Certificate(what, 1 - rate, options.variant, "computed", {"K": K, "radius": rate, "believed": d})
    if set(plant.tau) == {d}:  # otherwise the delays as they are disturb it, and no rate is promised
        certificate = certificate._replace(rate=rate_of(rate, plant.period * setting.dt))
    return Design(gains, require_certified(certificate, where))
