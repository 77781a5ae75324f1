"""Certificates for every real interval of a range, of held innovations and of jumps."""

import contextlib

import numpy as np
import pytest
from reference import linear

from pcbench.errors import DesignError
from pcbench.plants import ncs_two_state
from pcbench.synthesis import interval_ranges

TWO_STATE = ncs_two_state.nominal(ncs_two_state.Numbers())
FEEDBACK = np.array([[3.75, 11.5]])
# the public example of an aperiodic observer, its gain read as a held one and as a jump
A = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [-2, 1, -1, 0], [2, -2, 0, -2]])
C = np.eye(4)[:1]
L = np.array([[1.0], [-0.9433], [-0.6773], [1.6274]])
HELD, JUMP = interval_ranges.held_error(A, L, C), interval_ranges.jump_error(A, L, C)
LOOP = interval_ranges.held_error(TWO_STATE.A, TWO_STATE.B, FEEDBACK)

CERTIFIED = {
    "two-state plant, close to its constant limit of 1.7294 s": (LOOP, 0.1, 1.72),
    "held, below its constant limit of pi/2": (HELD, 0.2, 1.5),
    "jump": (JUMP, 1.8, 2.8),
}


@pytest.mark.parametrize("name", CERTIFIED)
def test_range_is_certified_between_the_grid_points_too(name):
    error, low, high = CERTIFIED[name]
    proof = interval_ranges.certify(error, low, high, "test")
    assert proof.margin > 0
    U = np.linalg.cholesky(proof.numbers["P"]).T
    norms = []
    for s in np.random.default_rng(3).uniform(low, high, 300):
        G = error.E @ linear.discretise(error.F, error.J, s)[0] @ error.J
        norms.append(np.linalg.norm(U @ G @ np.linalg.inv(U), 2))
    assert max(norms) <= proof.numbers["largest_norm"]
    assert proof.numbers["largest_norm"] - max(norms) < 0.01, "the bound is sharp enough to be of use"


@pytest.mark.parametrize(("error", "low", "high"), [(LOOP, 0.1, 1.75), (HELD, 0.2, 1.6), (JUMP, 1.0, 2.0)])
def test_range_with_an_unstable_constant_period_is_not_certified(error, low, high):
    with contextlib.suppress(DesignError):  # if the solver has no P
        assert not interval_ranges.certify(error, low, high, "test").margin > 0


def test_held_error_is_the_map_of_two_holds():
    Phi, Gamma = linear.discretise(A, -L, 0.7)
    np.testing.assert_allclose(interval_ranges.maps_over(HELD, np.array([0.7]))[0], Phi + Gamma @ C, rtol=0, atol=1e-12)


def test_bound_needs_cells_that_are_small_enough():
    error, low, high = CERTIFIED["jump"]
    P = interval_ranges.certify(error, low, high, "test").numbers["P"]
    coarse, fine, finer = (interval_ranges.norm_bound(error, P, low, high, cells) for cells in (4, 400, 4000))
    assert coarse > 1 > fine >= finer
    assert fine - finer < 0.01


@pytest.mark.parametrize("high", [1.0, 2.5])
def test_jump_gain_is_found_and_certified_for_a_range(high):
    K = interval_ranges.jump_gain(A, C, 0.2, high, "test")
    proof = interval_ranges.certify(interval_ranges.jump_error(A, K, C), 0.2, high, "test")
    assert proof.margin > 0.01
    rng = np.random.default_rng(2)
    e = rng.normal(size=4)
    for s in rng.uniform(0.2, high, 200):
        e = (np.eye(4) - K @ C) @ linear.discretise(A, L, s)[0] @ e
    assert np.abs(e).max() < 1e-6


def test_range_in_which_the_oscillation_is_not_seen_has_no_gain():
    """At intervals of pi the output shows one of the two states of the oscillation only."""
    K = interval_ranges.jump_gain(A, C, 0.2, 3.5, "test")
    assert not interval_ranges.certify(interval_ranges.jump_error(A, K, C), 0.2, 3.5, "test").margin > 0


def test_indefinite_matrix_bounds_nothing():
    assert np.isnan(interval_ranges.norm_bound(JUMP, -np.eye(4), 2.0, 2.5))
