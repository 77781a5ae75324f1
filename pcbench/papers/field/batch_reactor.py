"""The unstable batch reactor on a network: its modes, its loop, the growth of the network's error, and an outage.

The outputs are received values yh, held between transmissions, with error e = yh - y. With x of plant and controller

    x' = A11 x + A12 e,   e' = A21 x + A22 e,   e_i = 0 when node i transmits

L is the norm of A22, gamma the L2 gain from e to A21 x. Both enter the bounds on the transmission interval in the literature.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import Claim, all_digits, report_finding
from pcbench.plants import ncs_reactor
from pcbench.scenarios.ncs_reactor import PI

COMPUTED = "Walsh, Ye 2001; Heemels et al. 2010 [V]"
KP, KI = -np.array(PI["Kp"]), -np.array(PI["Ki"])  # of the output: u = KP y + KI times its integral
PERIOD = 0.1  # s between samples, of the critical arrival rate
OUTAGE = 1.0  # s


class Network(NamedTuple):
    """The matrices of the module's equations."""

    A11: Matrix
    A12: Matrix
    A21: Matrix
    A22: Matrix


def rows() -> list[Claim]:
    """Return every claim on the batch reactor."""
    model, loop = ncs_reactor.nominal(ncs_reactor.Numbers()), network()
    modes = sorted(np.linalg.eigvals(model.A).real, reverse=True)
    closed = np.sort_complex(np.linalg.eigvals(loop.A11))
    ranks = [np.linalg.matrix_rank(_observability(model.A, C)) for C in (model.C, model.C[:1], model.C[1:])]
    growth = np.linalg.norm(loop.A22, 2)
    gain = l2_gain(loop.A11, loop.A12, loop.A21)
    largest = largest_round_robin_interval()
    printed = "-17.659, -15.036, -2.2086 +1.7306i, -0.8221 +0.3812i"
    return [
        all_digits("eigenvalues of A [1/s]", "1.99096, 0.06351, -5.05657, -8.66589", modes, COMPUTED),
        all_digits("eigenvalues of the loop without a network [1/s]", printed, closed[closed.imag >= 0], COMPUTED),
        all_digits("observable states from y, from y1, from y2", "4, 4, 4", ranks, COMPUTED),
        all_digits("diagonal of A22, e' = A21 x + A22 e [1/s]", "15.73, 11.358", np.diag(loop.A22), COMPUTED),
        all_digits("L, the norm of A22 [1/s]", "15.73", growth, COMPUTED),
        all_digits("gamma, the gain from e to A21 x", "15.9152", gain, COMPUTED),
        all_digits("outage of 1 s: growth of the error", "9.40", np.linalg.norm(expm(model.A * OUTAGE), 2), COMPUTED),
        all_digits("outage: time in which the error doubles [s]", "0.348", np.log(2) / modes[0], COMPUTED),
        all_digits("critical arrival rate at h = 0.1 s", "0.328", 1 - np.exp(-2 * modes[0] * PERIOD), COMPUTED),
        report_finding(
            "batch reactor: largest constant interval, round robin, last values held",
            f"{largest:.5f} s, from the map over two transmissions",
        ),
    ]


def network() -> Network:
    """Return the loop of the batch reactor and its PI controller, with both outputs on a network."""
    model = ncs_reactor.nominal(ncs_reactor.Numbers())
    A11 = np.block([[model.A + model.B @ KP @ model.C, model.B @ KI], [model.C, np.zeros((2, 2))]])
    A12 = np.vstack([model.B @ KP, np.eye(2)])
    seen = np.hstack([model.C, np.zeros((2, 2))])
    return Network(A11, A12, -seen @ A11, -seen @ A12)


def l2_gain(A: Matrix, B: Matrix, C: Matrix) -> float:
    """Return the L2 gain of a stable C (sI - A)^-1 B: bisection until the Hamiltonian matrix has no imaginary eigenvalue."""

    def exceeds(gamma: float) -> bool:
        modes = np.linalg.eigvals(np.block([[A, B @ B.T / gamma**2], [-C.T @ C, -A.T]]))
        return bool(np.any(np.abs(modes.real) < 1e-8 * np.abs(modes).max()))

    low, high = float(np.linalg.norm(C @ np.linalg.solve(A, B), 2)), 1.0
    while exceeds(high):
        high *= 2
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if exceeds(middle) else (low, middle)
    return float(high)


def largest_round_robin_interval() -> float:
    """Return the shortest interval between transmissions [s] at which the loop with held outputs is not stable."""
    grid = np.arange(1e-3, 1.0, 1e-3)
    first = next(h for h in grid if _radius(h) >= 1)
    return float(brentq(lambda h: _radius(h) - 1, first - 1e-3, first))


def _radius(interval: float) -> float:
    """The spectral radius of the map over two transmissions, one of each node."""
    flow = expm(np.block([[*network()[:2]], [*network()[2:]]]) * interval)
    first, second = (np.diag([1.0] * 6 + received) for received in ([0.0, 1.0], [1.0, 0.0]))
    return float(np.abs(np.linalg.eigvals(second @ flow @ first @ flow)).max())


def _observability(A: Matrix, C: Matrix) -> Matrix:
    return np.vstack([C @ np.linalg.matrix_power(A, i) for i in range(len(A))])
