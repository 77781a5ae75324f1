"""Longest interval between transmissions of a network that carries the outputs of a loop one at a time.

A plant x' = A x + B u, y = C x has the controller xc' = Ac xc + Bc yh, u = Cc xc + Dc yh. It uses the last received outputs
yh, which are held. Each transmission updates one output of yh. With X = (x, xc) and the network's error e = yh - y:

    X' = A11 X + A12 e,    e' = A21 X + A22 e

Let L be the norm of A22 and gamma the L2 gain from e to A21 X. A protocol reduces e by a factor lambda per transmission, in a
norm of its own; lambda = sqrt(1/2) with two outputs. Every interval below a bound is then stable, also if it varies.

    round robin         outputs in turn; gamma grows by the factor sqrt(2) with two outputs, L stays if A22 is diagonal
    try-once-discard    the output with the largest |e|

Sources: the bound of Carnevale, Teel, Nesic, 2007, used by Heemels, Teel, van de Wouw, Nesic 2010; the older one of Nesic,
Teel 2004. The papers were not obtained. The limit of round robin and the rates of try-once-discard are this project's.
"""

from math import atan, log, sqrt
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.errors import DesignError
from pcbench.synthesis.constant_periods import largest_stable


class NetworkLoop(NamedTuple):
    """The matrices of X' = A11 X + A12 e, e' = A21 X + A22 e; N states of plant and controller, q outputs."""

    A11: Matrix  # [N, N]
    A12: Matrix  # [N, q]
    A21: Matrix  # [q, N]
    A22: Matrix  # [q, q]

    @property
    def flow(self) -> Matrix:
        """Return the matrix of (X, e) between transmissions, [N + q, N + q]."""
        return np.block([[self.A11, self.A12], [self.A21, self.A22]])


def network_loop(
    plant: tuple[Matrix, Matrix, Matrix], controller: tuple[Matrix, Matrix, Matrix, Matrix]
) -> NetworkLoop:
    """Return the loop of a plant (A, B, C) with a controller (Ac, Bc, Cc, Dc), which acts on the last received outputs."""
    (A, B, C), (Ac, Bc, Cc, Dc) = plant, controller
    A11 = np.block([[A + B @ Dc @ C, B @ Cc], [Bc @ C, Ac]])
    A12 = np.vstack([B @ Dc, Bc])
    output = np.hstack([C, np.zeros((len(C), len(Ac)))])
    return NetworkLoop(A11, A12, -output @ A11, -output @ A12)


def l2_gain(A: Matrix, B: Matrix, C: Matrix) -> float:
    """Return the H-infinity norm of C (sI - A)^-1 B to 12 digits, by bisection over the Hamiltonian's imaginary eigenvalues.

    Raises DesignError if A is not stable. Source: Boyd, Balakrishnan, Kabamba 1989.
    """
    if not np.linalg.eigvals(A).real.max() < 0:
        raise DesignError(
            "the gain of a loop: got a loop that is not stable, expected a stable one; change the controller."
        )
    low, high = 1e-9, 1e9
    while high / low > 1 + 1e-12:
        gamma = sqrt(low * high)
        modes = np.linalg.eigvals(np.block([[A, B @ B.T / gamma], [-C.T @ C / gamma, -A.T]]))
        if np.abs(modes.real).min() < 1e-9 * np.abs(modes).max():
            low = gamma
        else:
            high = gamma
    return high


def interval_bound(L: float, gamma: float, factor: float) -> float:
    """Return the bound [s] of Carnevale, Teel, Nesic for gamma > L; `factor` is lambda."""
    r = sqrt((gamma / L) ** 2 - 1)
    return atan(r * (1 - factor) / (2 * factor / (1 + factor) * (gamma / L - 1) + 1 + factor)) / (L * r)


def older_interval_bound(L: float, gamma: float, factor: float) -> float:
    """Return the bound [s] of Nesic and Teel, ln((L + gamma) / (lambda L + gamma)) / L; `factor` is lambda."""
    return log((L + gamma) / (factor * L + gamma)) / L


def round_robin_radius(loop: NetworkLoop, interval: float) -> float:
    """Return the spectral radius of the map over one transmission of each output in turn, one every `interval` seconds."""
    flow_map, N, q = expm(loop.flow * interval), len(loop.A11), len(loop.A22)
    cycle = np.eye(N + q)
    for node in range(q):
        cycle = flow_map @ cycle
        cycle[N + node] = 0.0  # received: yh = y of this output
    return spectral_radius(cycle)


def round_robin_limit(loop: NetworkLoop, upper: float) -> float:
    """Return the largest constant interval [s] of round robin below which the loop is stable, searched up to `upper`."""
    return largest_stable(lambda interval: round_robin_radius(loop, interval), upper)


def try_once_discard_rate(loop: NetworkLoop, interval: float, seed: int, transmissions: int = 4000) -> float:
    """Return the mean growth of log |(X, e)| per transmission from a random start; below 0: this run converges.

    At each transmission the output with the largest |e| is sent. A simulation, not a proof.
    """
    flow_map, N = expm(loop.flow * interval), len(loop.A11)
    state = np.random.default_rng(seed).standard_normal(len(flow_map))
    total = 0.0
    for _ in range(transmissions):
        state = flow_map @ state
        state[N + int(np.abs(state[N:]).argmax())] = 0.0
        size = float(np.linalg.norm(state))
        total, state = total + log(size), state / size
    return total / transmissions
