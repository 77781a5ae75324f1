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


def posterior_variances(F, c, P0, r, ticks):
    """Return the variances [ticks, n] after a sample y = c x + v, v ~ N(0, r), at every tick of x+ = F x, in 80 digits."""
    with localcontext() as context:
        context.prec = 80
        F, c, P = ([[Decimal(str(value)) for value in row] for row in M] for M in (F, [c], P0))
        n, (c,), out = len(F), c, []
        for _ in range(ticks):
            Pc = [sum(P[i][j] * c[j] for j in range(n)) for i in range(n)]
            s = sum(c[i] * Pc[i] for i in range(n)) + Decimal(str(r))
            P = [[P[i][j] - Pc[i] * Pc[j] / s for j in range(n)] for i in range(n)]
            out.append([float(P[i][i]) for i in range(n)])
            FP = [[sum(F[i][k] * P[k][j] for k in range(n)) for j in range(n)] for i in range(n)]
            P = [[sum(FP[i][k] * F[j][k] for k in range(n)) for j in range(n)] for i in range(n)]
        return out
