"""What the PI-PCO's paper leaves out or misprints: gains, intervals, the index of L, the error of (21).

Source: Li, Wang, Tian, PI Piecewise Continuous Observer, (10) to (26). In (12) and (15) L_{t-1} stands for L_{i-1}: with it
the theta form (15) to (17) is algebraically the form (12) to (14); t counts nothing there. (21) says that the measured part of
the error of xhat_i is 0: it is so for [y; w] of the sample's own time; what arrives is carried on by (18), and so is its noise.
"""

from itertools import pairwise
from math import exp, expm1

import numpy as np

from pcbench import api
from pcbench.papers.claim import FALSE, MISPRINT, OPEN, Claim
from pcbench.scenarios import SCENARIOS

LAM, B, KP, KI = 122.0, 355.0, -61.0, 12.2


def claims() -> list[Claim]:
    """Return what cannot be computed from the paper, and where its equations do not mean what they say."""
    first = [f"{b - a}" for a, b in pairwise([0, *arrivals(4)])]
    same, late = theta_form(0), theta_form(1)
    text = f"L_(i-1): (15) and (12) agree to {_size(same)}; L_(i-2): they part by {late:.2g} m/s"
    return [
        Claim("Kp, Ki", "not printed", "both signs of F are tried above", OPEN),
        Claim("T_i, Figure 3", "not printed", f"ours begins with {', '.join(first)} ms", OPEN),
        Claim("L_(t-1) in (12), (15)", "t - 1", text, MISPRINT if same < 1e-9 < late else FALSE),
        _measured_part(),
    ]


def arrivals(many: int) -> list[int]:
    """Return the first ticks at which cart/variable hands over a sample: T_i = round(200 + 100 sin 0.6 i) ms."""
    return [int(t) for t in np.cumsum([round(200 + 100 * np.sin(0.6 * i)) for i in range(1, many + 1)])]


def theta_form(late: int, many: int = 40) -> float:
    """Return how far (15) to (17) is from (12) to (14) where (15) takes the integral `late` samples older."""
    rng, w, L = np.random.default_rng(2), 0.0, [0.0] * (late + 1)
    y, held, worst = [5.0], 0.0, 0.0
    times = [0, *arrivals(many)]
    theta = w - KP * y[0]
    for a, b in pairwise(times):
        T = (b - a) * 1e-3
        A12, A22 = -expm1(-LAM * T) / LAM, exp(-LAM * T)
        M = B * np.array([(T - A12) / LAM, A12]) * np.sin(4e-3 * a)
        y.append(y[-1] + rng.standard_normal())
        nu = y[-1] - y[-2] - M[0] - A12 * w
        F = A22 - KP * A12
        theta = F * theta + (F * KP - KP) * y[-2] + M[1] - KP * M[0] + L[-1 - late]
        w = A22 * w + M[1] + KP * nu + held
        held += KI * nu
        L.append(held)
        worst = max(worst, abs(theta + KP * y[-1] - w))
    return worst


def _measured_part() -> Claim:
    """The measured part of x - xhat at the arrivals, under the paper's noise."""
    trace = api.simulate("cart/variable", "pi-pco")
    late = [k for k in arrivals(40) if 3000 <= k < len(trace)]
    e = (trace["position"] - trace["pi-pco.position"]).to_numpy()[late]
    std = SCENARIOS["cart/variable"].sampling.noise_std[0]
    text = (
        f"rms {np.sqrt(np.mean(e**2)):.3f} m at the arrivals after 3 s: the noise (sd {std:.3f} m), carried on by (18)"
    )
    return Claim("(21) measured part of x_i - xhat_i", "0", text, MISPRINT if np.abs(e).max() > 1e-3 else FALSE)


def _size(value: float) -> str:
    return "rounding" if value < 1e-9 else f"{value:.1g} m/s"
