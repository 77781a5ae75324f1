"""What a linear model expects of each sample: all samples are a joint normal, conditioned. No recursion of a filter is here.

x' = A x + B u + w, x(0) ~ N(xhat0, P0), y_j = C[j] x + v_j: all samples that ever arrive are one vector, whose mean is the
run without noise and whose covariance is written out for every pair. What is expected of a sample when it arrives is its mean
given those that have arrived before it.
"""

import numpy as np

from .late import Plant
from .linear import by_arrival


def joint(plant, samples, xhat0, P0, R):
    """Mean [K] and covariance [K, K] of all samples."""
    mean = np.array([plant.C[s.channel] @ plant.state(np.asarray(xhat0, float), 0, s.taken) for s in samples])
    spread = [
        plant.powers[k] @ P0 @ plant.powers[k].T + plant.noise(k) for k in range(max(s.taken for s in samples) + 1)
    ]
    S = np.zeros((len(samples), len(samples)))
    for a, s in enumerate(samples):
        for b, t in enumerate(samples):
            first, last = (s, t) if s.taken <= t.taken else (t, s)
            across = spread[first.taken] @ plant.powers[last.taken - first.taken].T
            S[a, b] = plant.C[first.channel] @ across @ plant.C[last.channel] + R[s.channel] * (a == b)
    return mean, S


def surprises(model, u, samples, xhat0, P0, R, W, every=False):
    """Return nu' S^-1 nu and how many numbers that is of, summed over what arrives at each tick: [N+1, 2].

    Counted is what was taken no sooner than all that has arrived; with `every`, all. What arrives at one tick and was taken
    at one is expected together.
    """
    plant, out, seen, newest = Plant(model, u, W), np.zeros((len(u), 2)), [], 0
    mean, S = joint(plant, samples, xhat0, P0, R)
    place = {(s.taken, s.channel): i for i, s in enumerate(samples)}
    for k, arriving in by_arrival(samples).items():
        for taken in sorted({s.taken for s in arriving}):
            mine = [place[s.taken, s.channel] for s in arriving if s.taken == taken]
            values = np.array([s.value for s in samples])
            K = np.linalg.solve(S[np.ix_(seen, seen)], S[np.ix_(seen, mine)]).T if seen else np.zeros((len(mine), 0))
            nu = values[mine] - mean[mine] - K @ (values[seen] - mean[seen])
            believed = S[np.ix_(mine, mine)] - K @ S[np.ix_(seen, mine)]
            if every or taken >= newest:
                out[k] += nu @ np.linalg.solve(believed, nu), len(mine)
            newest, seen = max(newest, taken), seen + mine
    return out


def posterior(plant, samples, P0, R, k):
    """Return the covariance [n, n] of x(k) given all samples that have arrived by then."""
    here = [s for s in samples if s.arrival <= k]
    _, S = joint(plant, here, np.zeros(plant.n), P0, R)
    across = []
    for s in here:
        spread = plant.powers[s.taken] @ P0 @ plant.powers[s.taken].T + plant.noise(s.taken)
        across.append(plant.powers[k - s.taken] @ spread @ plant.C[s.channel])
    K = np.linalg.solve(S, np.array(across)).T
    return plant.powers[k] @ P0 @ plant.powers[k].T + plant.noise(k) - K @ np.array(across)
