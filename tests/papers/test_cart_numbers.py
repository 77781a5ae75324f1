"""Every number of the cart's page comes out, at its stated tolerance, from the library and from the tables."""

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES

TRAJECTORIES = {  # scenario, tick, x1, pccebo, kfbo; None: equals x1
    ("cart/nominal", 300): (12.7863665308, 12.7043993177, 8.4002266794),
    ("cart/nominal", 1000): (24.8393019978, None, 22.0972268138),
    ("cart/nominal", 5000): (27.2345425155, None, 26.5793827825),
    ("cart/nominal", 10000): (18.6113648114, None, 18.3263872039),
    ("cart/gaussian", 1000): (24.8393019978, 24.7573347846, 19.7488547221),
    ("cart/gaussian", 10000): (18.6113648114, None, 17.3411568810),
    ("cart/drift", 1000): (25.0722136002, 25.3130643063, 22.4652716251),
    ("cart/drift", 10000): (12.3145190137, 12.1338263435, 12.0922824663),
}
ERRORS = {  # scenario, observer: MAE, RMSE of position, tolerance
    ("cart/nominal", "pccebo"): (0.103207320611, 0.718289573851, 1e-9),
    ("cart/nominal", "kfbo"): (1.24159579664, 1.64144588764, 1e-9),
    ("cart/nominal", "kf"): (0.1032073206, None, 1e-9),
    ("cart/drift", "pccebo"): (0.404416848, 0.832434884, 1e-7),
    ("cart/drift", "kfbo"): (1.520568139, 1.992617586, 1e-7),
    ("cart/drift", "kf"): (0.401954, 0.831066, 1e-6),
}
SEEDS = 2048


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("cart") / "tables"
    pcbench.run("cart", seeds=SEEDS, out=out)
    return out


@pytest.fixture(scope="module")
def stats(folder):
    return (
        pd.read_parquet(folder / "stats.parquet").set_index(["scenario", "observer", "signal", "metric"]).sort_index()
    )


@pytest.fixture(scope="module")
def traces():
    names = ["pccebo", "kfbo"]
    quiet = ["axes.noise_std=0.0"]
    return {
        name: pcbench.simulate(name, names, overrides=quiet) for name in ("cart/nominal", "cart/gaussian", "cart/drift")
    }


@pytest.mark.ci
@pytest.mark.parametrize("place", TRAJECTORIES, ids=str)
def test_trajectory(traces, place):
    scenario, tick = place
    row, (x1, pccebo, kfbo) = traces[scenario].iloc[tick], TRAJECTORIES[place]
    tolerance = 1e-7 if scenario == "cart/drift" else 1e-9
    assert row["t"] == pytest.approx(tick * 1e-3, abs=1e-12)
    assert row["position"] == pytest.approx(x1, abs=tolerance)
    assert row["pccebo.position"] == pytest.approx(x1 if pccebo is None else pccebo, abs=tolerance)
    assert row["kfbo.position"] == pytest.approx(kfbo, abs=tolerance)


@pytest.mark.ci
@pytest.mark.parametrize("place", ERRORS, ids=str)
def test_errors_in_the_tables(stats, place):
    mae, rmse, tolerance = ERRORS[place]
    assert stats.loc[(*place, "position", "mae"), "mean"] == pytest.approx(mae, abs=tolerance)
    if rmse is not None:
        assert stats.loc[(*place, "position", "rmse"), "mean"] == pytest.approx(rmse, abs=tolerance)


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["pccebo", "kfbo", "kf"])
def test_velocity_is_the_same_for_every_observer(stats, observer):
    place = ("cart/nominal", observer, "velocity")
    assert stats.loc[(*place, "mae"), "mean"] == pytest.approx(0.0087068855, abs=1e-9)
    assert stats.loc[(*place, "rmse"), "mean"] == pytest.approx(0.2149110012, abs=1e-9)


@pytest.mark.ci
def test_pccebo_error_between_the_first_arrivals_and_after_two_periods(traces):
    e = traces["cart/nominal"]["position"] - traces["cart/nominal"]["pccebo.position"]
    np.testing.assert_allclose(e[200:400], 10 / 122, rtol=0, atol=1e-9)
    assert e[400:].abs().max() < 3e-12


@pytest.mark.ci
@pytest.mark.parametrize(
    ("R", "P", "K"),
    [
        (0.004, (0.00816200281186, 0.00832728623761, 1.03292075440975), (2.04050070296576, 2.08182155940188)),
        (0.3, (0.0712068679520, 0.00845069673922, 1.03299082767383), (0.237356226506586, 0.028168989130723)),
    ],
)
def test_kfbo_gains(R, P, K):
    found = pcbench.design("cart/nominal", "kfbo", overrides=[f"options.kfbo.R={R}"]).certificate.numbers
    np.testing.assert_allclose(found["P"][[0, 0, 1], [0, 1, 1]], P, rtol=1e-11)
    np.testing.assert_allclose(found["K"][:, 0], K, rtol=1e-11)


@pytest.mark.ci
def test_pccebo_gain():
    L = pcbench.design("cart/nominal", "pccebo").gains.L[:, 0]
    np.testing.assert_allclose(L, [1.0, 2.07408e-13], rtol=3e-6, atol=1e-15)


@pytest.mark.ci
def test_lag_aware_kfbo_loses_most_of_its_bias():
    result = pcbench.run("cart/nominal", observers=["kfbo"], seeds=1, options={"kfbo": {"lag_aware": True}})
    position = result.stats.query("signal == 'position'").set_index("metric")["mean"]
    assert position["mae"] == pytest.approx(0.4553, abs=5e-5)
    assert position["steady_rmse"] == pytest.approx(0.0933, abs=5e-5)


@pytest.mark.ci
def test_sampled_innovation_is_unstable_at_one_second():
    options = {"kfbo": {"sampled-innovation": True, "R": 0.004}}
    result = pcbench.run("cart/slow", observers=["kfbo"], seeds=1, options=options)
    position = result.stats.query("signal == 'position'").set_index("metric")["mean"]
    assert position["steady_max_abs_error"] > 1.5 * 5.08  # the error grows where the model alone keeps 5.08 m


EXPECTED = {  # exact expectations over noise: E[MAE], sqrt E[MSE]; by hand, and below those of `reference.moments`
    ("cart/gaussian", "pccebo"): (1.05501888, 1.57774025),
    ("cart/gaussian", "kfbo"): (3.41228, 3.62855),
    ("cart/gaussian", "kf"): (0.619924, 1.323049),
    ("cart/white", "pccebo"): (0.56425262, 0.92679011),
    ("cart/gaussian-fast", "pccebo"): (1.054911729, 1.577655077),
    ("cart/gaussian-fast", "kfbo"): (3.171883272, 3.372097124),
    ("cart/gaussian-fast", "kf"): (0.501520405, 1.279696129),
    ("cart/white", "kfbo"): (1.256132623, 1.659649409),
    ("cart/white", "kf"): (0.221039210, 0.739991825),
}


@pytest.mark.ci
@pytest.mark.parametrize("place", EXPECTED, ids=str)
def test_expectations_over_noise_within_four_standard_errors(stats, place):
    for metric, value in zip(("mae", "pooled_rmse"), EXPECTED[place], strict=True):
        row = stats.loc[(*place, "position", metric)]
        assert abs(row["mean"] - value) < 4 * row["se"], metric


@pytest.mark.ci
def test_tail_rms_under_gaussian_noise(stats):
    for observer, value in (("pccebo", 1.0000), ("kf", 0.330801)):
        row = stats.loc[("cart/gaussian", observer, "position", "steady_pooled_rmse")]
        assert abs(row["mean"] - value) < 4 * row["se"]


@pytest.mark.nightly
def test_efficiency_against_the_bound():
    """3.03, 5.12 and 5.34 times worse for pccebo; kf attains the bound. Averaged over the prior of x(0).

    For kfbo errors from the fixed start over this bound are 8.6 to 13.4; averaged it is 7.62 to 12.75.
    """
    raw = {"name": "bound", "scenarios": ["cart/gaussian", "cart/gaussian-fast", "cart/white"], "seeds": 2048}
    result = pcbench.run(raw | {"options": {"scenario": {"random_initial_state": True}}})
    rows = result.stats.query("metric == 'rms_efficiency' and signal == 'position'").set_index(["scenario", "observer"])
    worse = {"pccebo": (3.0293, 5.1245, 5.3389), "kfbo": (7.622, 12.746, 9.677), "kf": (1.0, 1.0, 1.0)}
    for observer, values in worse.items():
        for scenario, value in zip(raw["scenarios"], values, strict=True):
            row = rows.loc[(scenario, observer)]
            assert abs(row["mean"] - 1 / value) < 4 * row["se"] + 1e-4 / value, (scenario, observer)


@pytest.mark.ci
def test_pccebo_beats_kfbo_in_position_in_every_scenario_on_every_seed(folder):
    pairs = pd.read_parquet(folder / "pairs.parquet")
    rows = pairs.query(
        "observer_a == 'pccebo' and observer_b == 'kfbo' and signal == 'position' and metric in ('mae', 'rmse')"
    )
    assert len(rows) == 2 * len(STUDIES["cart"].scenarios)
    assert (rows.prob_a_better == 1).all()


@pytest.mark.ci
def test_every_observer_beats_the_model_alone_in_position(stats):
    for scenario in ("cart/nominal", "cart/gaussian", "cart/white", "cart/slow"):
        floor = stats.loc[(scenario, "model-only", "position", "mae"), "mean"]
        for observer in set(SCENARIOS[scenario].observers) - {"model-only"}:
            assert stats.loc[(scenario, observer, "position", "mae"), "mean"] < floor


@pytest.mark.ci
def test_velocity_says_nothing(stats):
    """Finding 4: a pole at -122 makes velocity an open-loop quantity."""
    mae = stats.xs(("velocity", "mae"), level=("signal", "metric"))["mean"].unstack()
    assert (mae.sub(mae["model-only"], axis=0).abs().max(axis=1) < 1e-3 * mae.max(axis=1) + 1e-9).loc["cart/nominal"]
