"""kf: discrete Kalman filter that updates at the sampling time of a delayed measurement. It is the baseline of comparisons.

When sample m arrives, which was taken at t_m, mean and covariance are predicted from the newest sample used to t_m and
updated there (Joseph form, one channel after the other). Then the mean is predicted to the present, as in PCCEBO:

    P-_m = E P_(m-1) E' + Q,   K = P- c (c'P- c + r)^-1,   P_m = (I - K c') P- (I - K c')' + K r K'
    xhat(t) = e^{A (t - t_m)} xhat_m + I(t_m, t)

- The gain K is computed at every sample (`parts/linear_filter.update`). R is the variance of one sample, and the prior is
  N(xhat(0), P0). Without measurement noise, R = 1e-12. Outputs with correlated noise are decorrelated first
  (`parts/assumed_noise`).
- If R and Q are true and x(0) is drawn from the prior, P is the Bayesian bound of every causal estimator. This filter attains
  it.
- `bias_variance` adds a constant input bias b ~ N(0, bias_variance) to the state: x' = A x + B (u + b).
- `gate` rejects outliers, and `huber` reduces their weight (`parts/robust_update`).
- If the plant has an unknown input, x' = A x + B u + E f, the filter also estimates f, as a random walk from N(0,
  unknown_std^2). The prediction to the present includes f. The estimated signal is f minus its part that is a known function
  of the state.
- Channels may have their own clocks and delays. An out-of-sequence sample is inserted at its sampling time, and newer samples
  are filtered again (`parts/reorder_buffer`). So the order of arrival does not change the estimate.

Time index: xhat is the estimate of the present, after the jump.
Not claimed: that every unknown input is observable. The variance of an unobservable one grows.
Source: Kalman 1960, with each delayed sample filtered at its sampling time.
"""

from pcbench.observers.parts import linear_filter, robust_update
from pcbench.synthesis.certificate import Design, DesignContext

OBSERVER = linear_filter.FILTER


class Options(linear_filter.Options):
    """Assumptions of the filter, and its treatment of outliers."""

    gate: float | None = robust_update.GATE
    gate_opens: int = robust_update.OPENS
    huber: float | None = robust_update.HUBER


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, certified by the covariance recursion over the horizon at the (mean) periods."""
    guard = robust_update.make_guard(options.gate, options.gate_opens, options.huber)
    reason = "it rejects outliers or decreases their weight" if guard else ""
    return linear_filter.design(context, options, "kf", reason=reason, guard=guard)
