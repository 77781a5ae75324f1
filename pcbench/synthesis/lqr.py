"""Linear-quadratic regulation of a sampled plant, and the eigenvalues of a loop with a delayed command.

    u = -K x minimises sum x'Q1 x + u'Q2 u:   S = Phi'S Phi + Q1 - Phi'S Gamma K,  K = (Q2 + Gamma'S Gamma)^-1 Gamma'S Phi

Phi, Gamma are over one period of the controller with held input. Source: Astrom, Wittenmark, Computer-Controlled Systems,
11.2.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError, first_sentence


class Law(NamedTuple):
    """A linear law of the state x, computed once per period: s+ = A s + B x, command C s + D x; k entries of s, m inputs."""

    A: Matrix  # [k, k]
    B: Matrix  # [k, n]
    C: Matrix  # [m, k]
    D: Matrix  # [m, n]


def gain(Phi: Matrix, Gamma: Matrix, Q1: Matrix, Q2: Matrix, where: str) -> Matrix:
    """Return K [m, n]; raise DesignError without a stabilising one."""
    try:
        S = solve_discrete_are(Phi, Gamma, Q1, Q2)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"{where}: the Riccati equation of lqr was not solved (SciPy reported '{first_sentence(error)}'), expected a plant "
            "that its inputs can stabilise and a Q1 that weights every mode that does not decay; weight another state or add "
            "an input."
        ) from error
    return np.asarray(np.linalg.solve(Q2 + Gamma.T @ S @ Gamma, Gamma.T @ S @ Phi), float)


def over_period(tick: tuple[Matrix, Matrix], ticks: int) -> tuple[Matrix, Matrix]:
    """Return Phi and Gamma over `ticks` ticks of a held input, from those of one tick."""
    (Phi, Gamma), F, G = tick, np.eye(len(tick[0])), np.zeros_like(tick[1])
    for _ in range(ticks):
        F, G = Phi @ F, Phi @ G + Gamma
    return F, G


def monodromy_matrix(tick: tuple[Matrix, Matrix], law: Law, period: int, late: int) -> Matrix:
    """Return the map over one period of the plant, the law and its commands in transit, which act `late` ticks later.

    The loop is stable, with a known state, if its eigenvalues are within the unit circle. A decision is made every `period`
    ticks.
    """
    Phi, Gamma = tick
    n, m, k = *Gamma.shape, len(law.A)
    n_transit = -(-late // period)  # commands of earlier periods that have not acted yet
    identity = np.eye(n + k + m * n_transit)
    x, s = identity[:n], identity[n : n + k]
    in_transit = [identity[n + k + m * j :][:m] for j in range(n_transit)]  # newest first
    commands = [law.C @ s + law.D @ x, *in_transit]
    s = law.A @ s + law.B @ x
    for i in range(period):
        x = Phi @ x + Gamma @ commands[-((i - late) // period)]
    return np.vstack([x, s, *commands[:n_transit]])
