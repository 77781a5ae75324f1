"""The interval observer of the double integrator: its final widths, and that it contains the state in every run."""

import numpy as np
import pytest

from pcbench.synthesis import interval_observer

CASES = {(0.2, 0.3): (3.179, 4.776), (0.4, 0.5): (3.767, 4.167), (0.6, 0.7): (5.533, 3.947)}


def make(poles):
    return interval_observer.double_integrator(0.5, poles, wmax=0.2, vmax=0.05)


@pytest.mark.parametrize("poles", CASES)
def test_final_widths_have_the_digits_of_the_source(poles):
    np.testing.assert_allclose(interval_observer.final_width(make(poles)), CASES[poles], atol=5e-4)


@pytest.mark.parametrize("poles", CASES)
def test_final_width_is_where_the_recursion_of_the_radius_ends(poles):
    o = make(poles)
    M = o.A - np.outer(o.K, o.C)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(M)), poles, atol=1e-12)
    # the mode of the eigenvalue l is (1, (l - M11) / M12), as M12 is not 0
    V = np.array([[1.0, 1.0], [(l - M[0, 0]) / M[0, 1] for l in poles]])
    r, back = np.zeros(2), np.linalg.inv(V)
    for _ in range(400):
        r = np.array(poles) * r + np.abs(back @ o.b) * o.wmax + np.abs(back @ o.K) * o.vmax
    np.testing.assert_allclose(interval_observer.final_width(o), 2 * np.abs(V) @ r, rtol=1e-10)


@pytest.mark.parametrize("poles", CASES)
def test_every_run_within_the_bounds_stays_in_its_interval(poles):
    assert interval_observer.coverage(make(poles), 1.0, runs=2000, steps=200, seed=4) == 1.0


def test_noise_beyond_its_bound_leaves_the_interval():
    o = make((0.2, 0.3))
    wide = interval_observer.Noise(o.wmax * 30, o.vmax * 30)
    assert interval_observer.coverage(o, 0.1, runs=200, steps=100, seed=4, noise=wide) < 1.0
