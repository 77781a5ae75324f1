"""The unstable batch reactor on a network: its modes, its loop, the growth of the network's error, and an outage.

The outputs are received values yh, held between transmissions, with error e = yh - y. With x of plant and controller

    x' = A11 x + A12 e,   e' = A21 x + A22 e,   e_i = 0 when node i transmits

L is the norm of A22, gamma the L2 gain from e to A21 x. Both enter the bounds on the transmission interval in the literature.
"""

import numpy as np
from scipy.linalg import expm

from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import Claim, all_digits, report_finding, statement
from pcbench.plants import ncs_reactor
from pcbench.scenarios.ncs_reactor import PI
from pcbench.synthesis import network_bounds
from pcbench.synthesis.network_bounds import NetworkLoop

COMPUTED = "Walsh, Ye 2001; Heemels et al. 2010 [V]"
KP, KI = -np.array(PI["Kp"]), -np.array(PI["Ki"])  # of the output: u = KP y + KI times its integral
PERIOD = 0.1  # s between samples, of the critical arrival rate
OUTAGE = 1.0  # s
SHARE = np.sqrt(0.5)  # lambda of the bounds, of two outputs
LONGEST = 0.2  # s, of the search
STARTS = 6


def rows() -> list[Claim]:
    """Return every claim on the batch reactor."""
    model, loop = ncs_reactor.nominal(ncs_reactor.Numbers()), network()
    modes = sorted(np.linalg.eigvals(model.A).real, reverse=True)
    loop_modes = np.sort_complex(np.linalg.eigvals(loop.A11))
    ranks = [np.linalg.matrix_rank(_observability(model.A, C)) for C in (model.C, model.C[:1], model.C[1:])]
    growth = float(np.linalg.norm(loop.A22, 2))
    gain = network_bounds.l2_gain(loop.A11, loop.A12, loop.A21)
    largest = network_bounds.round_robin_limit(loop, LONGEST)
    bounds = {
        prefix: (bound(growth, gain, SHARE), bound(growth, np.sqrt(2) * gain, SHARE))
        for prefix, bound in (("", network_bounds.interval_bound), ("older ", network_bounds.older_interval_bound))
    }
    printed = "-17.659, -15.036, -2.2086 +1.7306i, -0.8221 +0.3812i"
    return [
        all_digits("eigenvalues of A [1/s]", "1.99096, 0.06351, -5.05657, -8.66589", modes, COMPUTED),
        all_digits(
            "eigenvalues of the loop without a network [1/s]", printed, loop_modes[loop_modes.imag >= 0], COMPUTED
        ),
        all_digits("observable states from y, from y1, from y2", "4, 4, 4", ranks, COMPUTED),
        all_digits("diagonal of A22, e' = A21 x + A22 e [1/s]", "15.73, 11.358", np.diag(loop.A22), COMPUTED),
        all_digits("L, the norm of A22 [1/s]", "15.73", growth, COMPUTED),
        all_digits("gamma, the gain from e to A21 x", "15.9152", gain, COMPUTED),
        all_digits(
            "bounds on the interval, try-once-discard and round robin [s]", "0.010843, 0.008959", bounds[""], COMPUTED
        ),
        all_digits("older bounds, in the same order [s]", "0.01000, 0.00816", bounds["older "], COMPUTED),
        try_once_discard(loop),
        all_digits("outage of 1 s: growth of the error", "9.40", np.linalg.norm(expm(model.A * OUTAGE), 2), COMPUTED),
        all_digits("outage: time in which the error doubles [s]", "0.348", np.log(2) / modes[0], COMPUTED),
        all_digits("critical arrival rate at h = 0.1 s", "0.328", 1 - np.exp(-2 * modes[0] * PERIOD), COMPUTED),
        report_finding(
            "batch reactor: largest constant interval, round robin, last values held",
            f"{largest:.5f} s, from the map over two transmissions",
        ),
    ]


def try_once_discard(loop: NetworkLoop) -> Claim:
    """Return the claim on the largest interval of try-once-discard, by runs from random starts."""
    stable, unstable = (
        [network_bounds.try_once_discard_rate(loop, interval, seed) for seed in range(STARTS)]
        for interval in (0.088, 0.09)
    )
    text = (
        f"growth per transmission up to {max(stable):.4f} at 0.088 s and {max(unstable):.4f} at 0.09 s, {STARTS} starts"
    )
    claim = "largest constant interval, try-once-discard [s]"
    return statement(claim, "between 0.088 and 0.09", text, max(stable) < 0 < max(unstable))._replace(source=COMPUTED)


def network() -> NetworkLoop:
    """Return the loop of the batch reactor and its PI controller, with both outputs on a network."""
    model = ncs_reactor.nominal(ncs_reactor.Numbers())
    return network_bounds.network_loop((model.A, model.B, model.C), (np.zeros((2, 2)), np.eye(2), KI, KP))


def _observability(A: Matrix, C: Matrix) -> Matrix:
    return np.vstack([C @ np.linalg.matrix_power(A, i) for i in range(len(A))])
