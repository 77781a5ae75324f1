"""The cart's exact numbers: those of independent superposition, and those that need no program at all."""

import numpy as np
import pytest

import pcbench

pytestmark = pytest.mark.usefixtures("in_a_hurry")

# expectations over noise, each recomputed from the impulse response of every sample; position [m^2]
MSE = {("pccebo", 0): 2.4892643, ("kfbo", 0): 13.166354, ("kf", 0): 1.7504582,
       ("pccebo", 1): 1.0166366, ("kfbo", 1): 10.265283, ("kf", 1): 0.78716268}  # fmt: skip
TAIL = {("pccebo", 0): 1.0, ("kfbo", 0): 8.0352698, ("kf", 0): 0.109429,
        ("pccebo", 1): 0.25, ("kfbo", 1): 6.0875244, ("kf", 1): 0.004524541}  # fmt: skip
PLACE = {0: (0.6, 0.6, 1.0), 1: (0.1, 0.3, 0.5)}


@pytest.fixture(scope="module")
def stats(in_a_hurry):
    axes = {"sampling_period": [0.1, 0.6], "delay": [0.3, 0.6], "noise_std": [0.5, 1.0]}
    found = pcbench.exact_moments("cart/gaussian", observers=["pccebo", "kfbo", "kf"], axes=axes).stats
    return found.set_index(["observer", "sampling_period", "delay", "noise_std", "signal", "metric"]).sort_index()


@pytest.mark.ci
@pytest.mark.parametrize(("observer", "place"), list(MSE))
def test_expected_squares_are_the_printed_ones(stats, observer, place):
    """To all printed digits."""
    for metric, known in (("mse", MSE), ("steady_mse", TAIL)):
        row = stats.loc[(observer, *PLACE[place], "position", metric)]
        assert row["method"] == "exact"
        assert row["se"] == 0
        assert row["mean"] == pytest.approx(known[observer, place], rel=6e-8 if known[observer, place] > 0.1 else 6e-7)


@pytest.mark.ci
def test_efficiency_is_the_bound_over_what_is_reached(stats):
    """pccebo takes every position as it comes: its rms is the noise, whatever else."""
    rows = stats.xs(("position", "rms_efficiency"), level=("signal", "metric"))["mean"]
    tail = stats.xs(("position", "steady_pooled_rmse"), level=("signal", "metric"))["mean"]
    bounds = (rows * tail).unstack("observer")
    np.testing.assert_allclose(bounds["kf"], bounds["pccebo"], rtol=1e-12)
    assert (rows <= 1 + 1e-9).all()


@pytest.mark.ci
def test_what_only_runs_know_is_missing_and_says_why(stats):
    rows = stats.xs(("position", "rmse"), level=("signal", "metric"))
    assert rows["mean"].isna().all()
    assert (rows["method"] == "none").all()
    assert rows["reason"].str.contains("pooled_rmse").all()
