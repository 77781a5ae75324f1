"""The error of a scalar Kalman filter in 80 decimal digits, which an unstable plant does not use up.

x' = a x by ticks of h, process noise of standard deviation q a tick, a measurement of noise r every `period` ticks that arrives
`delay` ticks later (both at least 1). The error after the arrivals of tick k is the prediction from the last one that arrived.
"""

from decimal import Decimal, localcontext


def steady_rms(a, h, prior, q, r, period, delay, ticks, tail):
    """Return the root mean square error over ticks tail .. ticks - 1, and its variance at the last of them."""
    with localcontext() as context:
        context.prec = 80
        F2 = (2 * Decimal(str(a)) * Decimal(str(h))).exp()
        P0, Q, R = (Decimal(str(value)) ** 2 for value in (prior, q, r))
        P, after = P0, []
        for k in range(ticks):
            if k % period == 0:
                P = P * R / (P + R)
                after.append(P)
            P = F2 * P + Q
        total = Decimal(0)
        for k in range(ticks):
            taken = (k - delay) // period
            V, steps = (P0, k) if taken < 0 else (after[taken], k - taken * period)
            for _ in range(steps):
                V = F2 * V + Q
            total += V if k >= tail else 0
        return float((total / (ticks - tail)).sqrt()), float(V)
