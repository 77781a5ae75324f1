"""A Kalman filter that leaves out or weighs less what is far from what it expects, from tick 0 anew at every arrival.

As `irregular.kf`, channel by channel in the order taken, of one tick in the order of arrival: here that matters. z is an
innovation over its standard deviation. Beyond `gate` a channel is left out, unless so many of it were in a row; beyond `huber`
its correction is that of an innovation of `huber` deviations, and its noise as large as makes that gain the best.
"""

import numpy as np

from .irregular import advance, flow_of, noise_sums, run
from .linear import discretise, process_noise


def filtered(model, u, samples, xhat0, P0, R, W, gate=np.inf, opens=5, huber=np.inf):
    """Return xhat [N+1, n], and which samples are left out in the end, by (taken, channel)."""
    flow, gone = flow_of(model, u), set()
    added = noise_sums(discretise(model.A, model.B, model.h)[0], process_noise(model.A, W, model.h), len(u))

    def newest(at_hand):
        at, x, P, row = 0, np.asarray(xhat0, float), np.asarray(P0, float), dict.fromkeys(range(len(R)), 0)
        gone.clear()
        for s in sorted(at_hand, key=lambda s: (s.taken, s.arrival, s.channel)):
            c, Phi = model.C[s.channel], flow.Phi[s.taken - at]
            x, P, at = advance(flow, x, at, s.taken), Phi @ P @ Phi.T + added[s.taken - at], s.taken
            nu, variance = s.value - c @ x, c @ P @ c + R[s.channel]
            z = abs(nu) / np.sqrt(variance)
            if z > gate and row[s.channel] < opens:
                row[s.channel] += 1
                gone.add((s.taken, s.channel))
                continue
            row[s.channel] = 0
            r = R[s.channel] + (variance * (z / huber - 1) if z > huber else 0.0)
            K = np.linalg.solve(np.atleast_2d(c @ P @ c + r), np.atleast_2d(P @ c)).ravel()
            x, keep = x + K * nu, np.eye(len(x)) - np.outer(K, c)
            P = keep @ P @ keep.T + r * np.outer(K, K)
        return at, x

    return run(flow, samples, xhat0, newest), set(gone)
