"""Send on delta: mean interval d^2 and mean variance d^2/6, by exit times and by simulation."""

import numpy as np
import pytest

from pcbench.synthesis import send_on_delta


@pytest.mark.parametrize("d", [0.3, 1.0, 2.5])
def test_exit_times_give_interval_d_squared_and_variance_d_squared_over_6(d):
    got = send_on_delta.expected(d, points=200)
    assert got.interval == pytest.approx(d**2, rel=1e-9)
    assert got.variance == pytest.approx(d**2 / 6 * (1 - 1 / 200**2), rel=1e-9)


def test_exit_times_of_a_random_walk_agree_with_its_transition_matrix():
    points, d = 7, 1.4
    inner = 2 * points - 1
    walk = (np.eye(inner, k=1) + np.eye(inner, k=-1)) / 2  # one step of size d/points, of (d/points)^2 seconds
    visits = np.linalg.inv(np.eye(inner) - walk)[points - 1] * (d / points) ** 2
    x = np.linspace(-d, d, 2 * points + 1)[1:-1]
    got = send_on_delta.expected(d, points)
    assert got.interval == pytest.approx(visits.sum(), rel=1e-12)
    assert got.variance == pytest.approx(visits @ x**2 / visits.sum(), rel=1e-12)


def test_simulation_with_a_shifted_threshold_agrees_with_exit_times():
    got = send_on_delta.simulate(1.0, 0.01, 400_000, seed=3)
    intervals = 400_000 * 0.01 / got.interval
    error = np.sqrt(2 / 3 / intervals)  # the variance of an exit time is 2/3 d^4
    assert got.interval == pytest.approx(1.0, abs=4 * error)
    assert got.variance == pytest.approx(1 / 6, abs=4 * error / 6 * 2)


def test_simulation_without_the_shift_sends_too_late():
    late = send_on_delta.simulate(1.0, 0.01, 400_000, seed=3, shift=False)
    assert late.interval == pytest.approx((1 + send_on_delta.SHIFT * 0.1) ** 2, abs=0.05)
    assert late.interval > 1.08
    assert late.variance > 0.175


def test_periodic_samples_at_the_same_mean_interval_leave_three_times_the_variance():
    periodic = 1.7**2 / 2  # half the period
    assert periodic / send_on_delta.expected(1.7).variance == pytest.approx(3, rel=1e-6)
