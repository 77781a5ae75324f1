"""The bounds on the interval between transmissions of the batch reactor's loop, and their limits by the loop itself."""

import math

import numpy as np
import pytest
from reference import linear

from pcbench.errors import DesignError
from pcbench.plants import ncs_reactor
from pcbench.synthesis import network_bounds

FACTOR = math.sqrt(0.5)  # of two outputs
PLANT = tuple(np.array(each) for each in (ncs_reactor.A, ncs_reactor.B, ncs_reactor.C))
CONTROLLER = (
    np.zeros((2, 2)),
    np.array([[0.0, 1.0], [1.0, 0.0]]),
    np.diag([-2.0, 8.0]),
    np.array([[0.0, -2.0], [5.0, 0.0]]),
)
LOOP = network_bounds.network_loop(PLANT, CONTROLLER)


def gain():
    return network_bounds.l2_gain(LOOP.A11, LOOP.A12, LOOP.A21)


def test_batch_reactor_has_the_matrices_of_its_network_error():
    np.testing.assert_allclose(LOOP.A22, np.diag([15.73, 11.358]), atol=1e-12)
    slow = np.sort_complex(np.linalg.eigvals(LOOP.A11))[-2:]
    np.testing.assert_allclose(slow, [-0.8221 - 0.3812j, -0.8221 + 0.3812j], atol=5e-5)


def test_gain_of_the_loop_is_the_peak_of_its_frequency_response():
    frequencies = np.concatenate([np.logspace(-3, 4, 4001), np.linspace(10.0, 40.0, 3001)])
    peak = max(
        np.linalg.norm(LOOP.A21 @ np.linalg.solve(1j * w * np.eye(6) - LOOP.A11, LOOP.A12), 2) for w in frequencies
    )
    assert gain() == pytest.approx(15.9152, abs=5e-5)
    assert gain() == pytest.approx(peak, rel=1e-4)
    assert gain() >= peak * (1 - 1e-10)


def test_gain_of_a_first_order_lag_is_known():
    assert network_bounds.l2_gain(np.array([[-2.0]]), np.array([[3.0]]), np.array([[5.0]])) == pytest.approx(
        7.5, rel=1e-9
    )


def test_gain_of_an_unstable_loop_is_refused():
    with pytest.raises(DesignError, match="not stable"):
        network_bounds.l2_gain(np.array([[0.1]]), np.array([[1.0]]), np.array([[1.0]]))


@pytest.mark.parametrize(
    ("formula", "discard", "robin"),
    [("interval_bound", 0.010843, 0.008959), ("older_interval_bound", 0.01000, 0.00816)],
)
def test_batch_reactor_has_its_bounds_on_the_interval(formula, discard, robin):
    bound = getattr(network_bounds, formula)
    assert bound(15.73, gain(), FACTOR) == pytest.approx(discard, abs=5e-6)
    assert bound(15.73, math.sqrt(2) * gain(), FACTOR) == pytest.approx(robin, abs=5e-6)


def held_round_robin(interval):
    """The map of (x, xc, yh) over one transmission of y1 and one of y2, in the states of the loop itself."""
    (A, B, C), (Ac, Bc, Cc, Dc) = PLANT, CONTROLLER
    flow = np.block([[A, B @ Cc], [np.zeros((2, 4)), Ac]])
    Phi, Gamma = linear.discretise(flow, np.vstack([B @ Dc, Bc]), interval)
    over = np.block([[Phi, Gamma], [np.zeros((2, 6)), np.eye(2)]])
    whole = np.eye(8)
    for node in range(2):
        received = np.eye(8)
        received[6 + node] = np.concatenate([C[node], np.zeros(4)])
        whole = received @ over @ whole
    return np.abs(np.linalg.eigvals(whole)).max()


@pytest.mark.parametrize("interval", [0.005, 0.03, 0.06, 0.07, 0.1])
def test_radius_of_round_robin_agrees_with_the_loop_that_holds_outputs(interval):
    assert network_bounds.round_robin_radius(LOOP, interval) == pytest.approx(held_round_robin(interval), rel=1e-9)


def test_round_robin_is_stable_up_to_six_times_its_bound():
    limit = network_bounds.round_robin_limit(LOOP, 0.2)
    assert limit == pytest.approx(0.065793, abs=1e-6)
    assert held_round_robin(0.999 * limit) < 1 < held_round_robin(1.001 * limit)


def test_try_once_discard_loses_stability_between_88_and_90_ms():
    rates = {T: [network_bounds.try_once_discard_rate(LOOP, T, seed) for seed in range(6)] for T in (0.08, 0.088, 0.09)}
    assert max(rates[0.08] + rates[0.088]) < 0 < max(rates[0.09])
