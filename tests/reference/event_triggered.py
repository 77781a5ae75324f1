"""Sensors that send only some of their samples, and the Kalman filter that uses that they do not; written out the long way.

Send on delta: a channel sends its sample where it is at least d from the last value that it sent. Try-once-discard: of the
channels that would send at one time only the one that has changed most, in units of its d if that is above 0, the first of
equals. A channel that has sent nothing yet has changed without limit.
"""

import numpy as np

from reference.linear import Array, Model, Sample, by_arrival, discretise, joseph_update


def sent(samples: list[Sample], d: Array, one: bool) -> set[tuple[int, int]]:
    """Return (tick taken, channel) of what is sent."""
    last: dict[int, float] = {}
    out = set()
    for tick in sorted({s.taken for s in samples}):
        wishes = []
        for s in sorted((s for s in samples if s.taken == tick), key=lambda s: s.channel):
            change = abs(s.value - last[s.channel]) if s.channel in last else np.inf
            if change >= d[s.channel]:
                wishes.append((change / (d[s.channel] or 1.0), s))
        if one and wishes:
            wishes = [max(wishes, key=lambda wish: wish[0])]
        for _, s in wishes:
            last[s.channel] = s.value
            out.add((tick, s.channel))
    return out


def kf_event(
    model: Model, u: Array, samples: list[Sample], xhat0: Array, P0: Array, R: Array, d: Array, one: bool, silence: bool
) -> Array:
    """Return the estimates [N+1, n] of the Kalman filter on what is sent; without process noise, samples in order.

    With `silence` a sample that is not sent is the last value received with variance R + d^2 / 3.
    """
    Phi, Gamma = discretise(model.A, model.B, model.h)
    N, messages = len(u) - 1, sent(samples, d, one)
    arriving = by_arrival(samples)
    x, P, at, received = xhat0, P0, 0, np.full(len(d), np.nan)
    out = []
    for k in range(N + 1):
        for s in sorted(arriving.get(k, []), key=lambda s: (s.taken, s.channel)):
            while at < s.taken:
                x, P, at = Phi @ x + Gamma @ u[at], Phi @ P @ Phi.T, at + 1
            value, r = s.value, R[s.channel]
            if (s.taken, s.channel) in messages:
                received[s.channel] = value
            elif silence and not one and d[s.channel] > 0 and not np.isnan(received[s.channel]):
                value, r = received[s.channel], r + d[s.channel] ** 2 / 3
            else:
                continue
            x, P = joseph_update(x, P, model.C[s.channel], value, r)
        now = x
        for j in range(at, k):
            now = Phi @ now + Gamma @ u[j]
        out.append(now)
    return np.array(out)
