"""Rows of several cells that are made together are those of each by itself, to the bit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pcbench import statistics

SIZES = (1.0, 5.0)
CONSISTENT = {"nees": 1, "nees_dof": 1, "nis": 1, "nis_dof": 1, "signal_nees": 2}


def runs(rng, n, metrics):
    """What one observer's runs leave: some of the metrics of two signals, NaN in one of them, a signed one."""
    out = {m: rng.gamma(2.0, size=(many, n)) for m, many in metrics.items()}
    out["final_error"] = rng.standard_normal((2, n))
    out["settling_time"][1] = np.nan
    return out | {"diverged": np.zeros(n, bool), "unsettled": rng.random((2, n)) < 0.3}


def cells(seed, many, n, is_consistent):
    rng = np.random.default_rng(seed)
    metrics = dict.fromkeys(("mae", "rmse", "mse", "max_abs_error", "settling_time", "steady_mae", "steady_mse"), 2)
    each = {"a": metrics | (CONSISTENT if is_consistent else {}), "b": metrics, "c": metrics}
    return [{o: runs(rng, n, mine) for o, mine in each.items()} for _ in range(many)]


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from([1, 2, 3, 64, 65, 1024]), st.booleans())
def test_cells_together_have_the_bits_of_each_alone(seed, many, n, is_consistent):
    each, rng = cells(seed, many, n, is_consistent), np.random.default_rng(seed)
    bounds = {"a": rng.random((many, 2)), "b": np.where(rng.random((many, 2)) < 0.5, np.nan, 1.0), "c": None}
    described, judged = statistics.summary_of_cells(each, bounds, SIZES)
    assert set(judged) == {("a", "b"), ("a", "c"), ("b", "c")}
    for i, alone in enumerate(each):
        mine = {o: None if b is None else b[i] for o, b in bounds.items()}
        want, pairs = statistics.summary(lambda alone=alone: [alone], mine, SIZES)
        for o, d in described.items():
            assert d.names == want[o].names
            np.testing.assert_array_equal(d.n, want[o].n)
            np.testing.assert_array_equal(d.exists[i], want[o].exists[0])
            assert d.values[i].tobytes() == want[o].values[0].tobytes()
        for pair, j in judged.items():
            assert (j.names, j.n) == (pairs[pair].names, pairs[pair].n)
            assert j.values[i].tobytes() == pairs[pair].values[0].tobytes()
