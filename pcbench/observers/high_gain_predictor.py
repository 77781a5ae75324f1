"""high-gain-predictor: high-gain observer for plants with one output, with an output predictor between samples.

    xhat' = f(xhat, u) + L (w - C xhat),    w' = C f(xhat, u),    w(t_k) = y_k

L places all n eigenvalues of A - L C at -theta. In the coordinates (y, y', ...) of the linear model, the gains are binomial,
C(n, i) theta^i, as for a chain of integrators. As the period goes to 0, this is the continuous high-gain observer.
On a linear plant with a constant period, the error converges if the spectral radius of its map from sample to sample is below
1. For a chain of integrators, this requires theta T < 4.99991, 2.89627, 1.28317 for n = 2, 3, 4
(`synthesis/sampled_high_gain`).
`parts/held_innovation` computes w - C xhat as c - al, so that a delayed sample is predicted to its arrival.
Source: Karafyllis, Kravaris, IEEE TAC 54(9), 2009, which was not obtained. `high-gain` has a matrix S instead of constant
gains, for a plant of positions, rates and parameters.
The observer slows a stable mode faster than theta down to theta. This needs a large gain, which may diverge at long periods.
So the default of theta is the decay rate of the fastest mode, but at least 4 1/s.
Not claimed: convergence on a nonlinear plant, at varying intervals or with delay.
"""

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.dynamics.observability import require_observable
from pcbench.errors import UserError
from pcbench.observers.parts import held_innovation
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.synthesis.certificate import Certificate, Design, DesignContext, no_certificate
from pcbench.synthesis.constant_periods import predictor_map
from pcbench.synthesis.error_bounds import rate_of

OBSERVER = held_innovation.OBSERVER
SLOWEST = 4.0  # 1/s, least default of theta


class Options(StrictOptions):
    """Tuning parameter."""

    theta: float | None = tunable(
        None,
        gt=0,
        description="gain parameter [1/s]; larger is faster; default: decay rate of the fastest mode, 4 or more",
    )


def design(context: DesignContext, options: Options) -> Design:
    """Place the eigenvalues; the certificate is the spectral radius over a constant period."""
    model, where = context.model, f"high-gain-predictor in {context.scenario}"
    held_innovation.require_continuous(context, where)
    if len(model.C) > 1:
        raise UserError(f"{where}: got {len(model.C)} outputs, expected one; use lmi-sampled or kf.")
    require_observable(model, where)
    theta = options.theta or max(SLOWEST, float(-np.linalg.eigvals(model.A).real.min()))
    L = binomial_gain(model.A, model.C, theta)
    gains = held_innovation.gains_of(context, L, model.C @ L)
    intervals = context.intervals or context.period
    period = max(intervals) * context.dt
    radius = spectral_radius(predictor_map(model.A, L, model.C, period))
    numbers = {"L": L, "theta": theta, "theta_Ts": theta * period, "radius": radius}
    reason = ""
    if context.field is not None:
        reason = "the plant is nonlinear; the radius is of its linear model"
    elif any(context.delay):
        reason = "the measurements are delayed; the radius is without delay"
    elif len(set(intervals)) > 1:
        reason = "the intervals vary; the radius is of the longest"
    elif not radius < 1:
        reason = "the spectral radius is not below 1"
    if reason:
        return Design(gains, no_certificate(reason)._replace(numbers=numbers))
    inequality = "the spectral radius of the error's map over a constant period is below 1"
    return Design(gains, Certificate(inequality, 1 - radius, "poles", "computed", numbers, rate_of(radius, period)))


def binomial_gain(A: Matrix, C: Matrix, theta: float) -> Matrix:
    """Return L [n, 1] with all eigenvalues of A - L C at -theta, by Ackermann's formula in units of theta."""
    n, M = len(A), A / theta
    observability = np.vstack([C @ np.linalg.matrix_power(M, i) for i in range(n)])
    polynomial = np.linalg.matrix_power(M + np.eye(n), n)
    return np.asarray(theta * polynomial @ np.linalg.solve(observability, np.eye(n)[:, -1:]))
