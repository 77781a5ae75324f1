"""Directions are compressed without a change of any covariance, whatever the units, and what does not fit is said."""

import jax
import numpy as np

from pcbench.machine import process
from pcbench.moments.compress import compressed


def test_covariances_stay_and_the_rank_is_found():
    """Rank 5 and 7 in twelve numbers whose units differ by 1e12; to 1e-14 of each number's size."""
    rng = np.random.default_rng(3)
    units = np.logspace(-6, 6, 12)[rng.permutation(12)]
    cells = [rng.normal(size=(12, rank)) @ rng.normal(size=(rank, 20)) * units[:, None] for rank in (5, 7)]
    B = np.stack(cells, -1)
    with process.float64():
        new, used, lost = jax.jit(compressed, static_argnums=1)(B, 15)
    np.testing.assert_array_equal(used, [5, 7])
    np.testing.assert_array_equal(lost, 0)
    before, after = (np.einsum("ijc,kjc->ikc", each, each) / np.outer(units, units)[..., None] for each in (B, new))
    np.testing.assert_allclose(after, before, atol=1e-12)
    assert not np.asarray(new)[:, 7:].any()


def test_too_little_room_is_said():
    with process.float64():
        _, _, lost = jax.jit(compressed, static_argnums=1)(np.random.default_rng(4).normal(size=(8, 8, 1)), 6)
    assert lost[0] > 1e-3
