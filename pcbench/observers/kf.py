"""kf: the delay-compensated discrete Kalman filter, the fair baseline.

At the arrival of sample m, taken at t_m: carry mean and covariance from the newest sample used to t_m, update there (Joseph
form, one channel after the other), then predict to now exactly as PCCEBO does:

    P-_m = E P_(m-1) E' + Q,   K = P- c (c'P- c + r)^-1,   P_m = (I - K c') P- (I - K c')' + K r K'
    xhat(t) = e^{A (t - t_m)} xhat_m + I(t_m, t)

The gain K is computed at every sample (`parts/linear_filter.update`). R is the variance of one sample (outputs whose noise is
correlated are made independent first), the prior is N(xhat(0), P0).
With what is true of R and Q, and x(0) drawn from the prior, P is the Bayesian bound of every causal estimator, and this filter
attains it. Where a scenario has no measurement noise, R = 1e-12.
With `bias_variance` a constant input bias b ~ N(0, that variance) is estimated beside the state: x' = A x + B (u + b).
With `gate` or `huber` a sample that is far from what is expected is left out, or weighed less (`parts/robust_update`).
Where a plant has an unknown input, x' = A x + B u + E f, f is estimated too, as a random walk from N(0, size^2) on: the
estimate of the present carries it, and the signal is f less its part that is a known function of the state.
Not claimed: that every unknown input can be found; its variance then grows.
Time index: the estimate is of now, after the jump. Channels may have clocks and delays of their own; a sample that comes after
a newer one is put in its place (`parts/reorder_buffer`), so the estimate uses all that has arrived, as if it had come in order.
Source: Kalman 1960; a late sample is filtered at its own time, and what has come since is filtered again.
"""

from pcbench.observers.parts import linear_filter, robust_update
from pcbench.synthesis.certificate import Design, DesignContext

OBSERVER = linear_filter.FILTER


class Options(linear_filter.Options):
    """What the filter assumes, and what it does with a sample that is far from what it expects."""

    gate: float | None = robust_update.GATE
    gate_opens: int = robust_update.OPENS
    huber: float | None = robust_update.HUBER


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, and check its covariance recursion over the horizon at the (mean) periods."""
    guarded = robust_update.of(options.gate, options.gate_opens, options.huber)
    why = "it rejects outliers or decreases their weight" if guarded else ""
    return linear_filter.design(setting, options, "kf", unproven=why, guarded=guarded)
