"""A plant in a closed loop for tests, as a study and as the reference's: three states, two inputs and outputs, no symmetry."""

import numpy as np
from reference import loop
from scipy.linalg import expm

TICK, N = 0.01, 160
A = [[0.0, 1.0, 0.2], [0.8, -0.3, 0.0], [-0.4, 0.1, -1.5]]
B = [[0.0, 0.3], [1.0, 0.0], [0.2, -2.0]]
C = [[1.0, 0.0, 0.1], [0.0, 0.2, 1.0]]
X0, XHAT0, PRIOR = [0.5, -0.2, 0.3], [0.1, 0.1, -0.2], [0.4, 0.3, 0.5]
NOISE = [0.02, 0.03]
Q1 = [[2.0, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 0.5]]
Q2 = [0.5, 0.2]


def study(controller, sensor=None, seeds=3, observers=("kf",), **lti):
    """Return a study with the loop closed; `sensor` are the keys of its sampling, in seconds."""
    measured = {"sampling_period": 0.06, "delay": 0.04, "noise_std": NOISE} | (sensor or {})
    table = {"A": A, "B": B, "C": C, "x0": X0, "xhat0": XHAT0, "prior_std": PRIOR, "tick": TICK, "duration": N * TICK}
    table |= {"states": ["angle [rad]", "rate [rad/s]", "current [A]"], "steady_start": 0.5} | measured | lti
    return {"name": "t", "seeds": seeds, "observers": list(observers), "lti": table, "controller": controller}


def plant(**changes):
    """Return the reference's plant."""
    whole = expm(TICK * np.block([[np.array(A), np.array(B)], [np.zeros((2, 5))]]))
    given = loop.Plant(
        whole[:3, :3], whole[:3, 3:], np.array(C), np.array(NOISE), np.zeros(3), np.array(X0), np.array(XHAT0),
        np.diag(np.square(PRIOR)),
    )  # fmt: skip
    return given._replace(**changes)


def resting(p, r, chosen):
    """Return x_ref and u_ref for set points r [T, len(chosen)]: the least-squares rest, by pseudo-inverse."""
    n, m = p.Gamma.shape
    M = np.hstack([p.Phi - np.eye(n), p.Gamma])
    free = [i for i in range(n + m) if i not in chosen]
    out = np.zeros((len(r), n + m))
    out[:, chosen] = r
    out[:, free] = -r @ (np.linalg.pinv(M[:, free]) @ M[:, chosen]).T
    return out[:, :n], out[:, n:]


def over(p, ticks):
    """Return Phi and Gamma of a held input over so many ticks."""
    G = sum(np.linalg.matrix_power(p.Phi, i) @ p.Gamma for i in range(ticks))
    return np.linalg.matrix_power(p.Phi, ticks), G
