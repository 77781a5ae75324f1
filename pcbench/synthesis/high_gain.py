"""The linear limit of a high-gain observer's sampling period: a chain of three integrators, S at rest, samples without delay.

Between samples g(t) = e^{-3 s} g(t_k), s = Th (t - t_k), as S^-1 C' = (3, 3, 1) at rest; scaled errors e (time in 1/Th) obey

    e' = N e - (3, 3, 1) g,    N the shift,    g(t_k) = e_1(t_k)

so over an interval e becomes M(Th Ts) e. Its spectral radius passes 1 at Th Ts = 2.90.
"""

import numpy as np
from scipy.linalg import expm

from pcbench.synthesis.certificate import Certificate

AT_REST = np.array([3.0, 3.0, 1.0])  # S^-1 C'


def radius(interval: float) -> float:
    """Return the spectral radius of M for an interval Th Ts."""
    whole = np.zeros((4, 4))
    whole[:3, :3] = np.eye(3, k=1)
    whole[:3, 3] = -AT_REST
    whole[3, 3] = -AT_REST[0]
    over = expm(whole * interval)
    M = over[:3, :3].copy()
    M[:, 0] += over[:3, 3]
    return float(np.abs(np.linalg.eigvals(M)).max())


def limit() -> float:
    """Return the largest Th Ts below which errors of the linear chain decay."""
    from scipy.optimize import brentq  # takes a tenth of a second to import

    return float(brentq(lambda s: radius(s) - 1, 2.0, 4.0))


def certificate(theta: float, period: float) -> Certificate:
    """Say what is known of a tuning [1/s] at a sampling period [s]; there is no proof, as the plant is nonlinear."""
    numbers = {"theta_Ts": theta * period, "linear_limit": limit(), "radius": radius(theta * period)}
    return Certificate("none: nonlinear; linear limit of theta Ts shown", float("inf"), "none", "not needed", numbers)
