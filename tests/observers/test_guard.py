"""Gates and Huber's update in `kf` and `ekf`: an independent filter, and what they are worth where some samples are outliers.

Plant and schedules are those of `test_late_samples`; every fifth sample has ten standard deviations more.
"""

import driven
import jax
import numpy as np
import pytest
from harness import inputs, starts
from honest import STUDY
from reference import guarded
from test_late_samples import CASE, KNOWN, MODEL, TICKS, TIMES, R, W, plant

import pcbench
from pcbench.observers import OBSERVERS

pytestmark = pytest.mark.usefixtures("in_a_hurry")
CHOICES = [{"gate": 3.0}, {"gate": 1.0, "gate_opens": 2}, {"huber": 1.3}, {"gate": 2.0, "huber": 1.0, "gate_opens": 3}]


def spoilt(schedule):
    return [s._replace(value=s.value + 2.0 * (i % 5 == 0)) for i, s in enumerate(plant(schedule)[1])]


def run_observer(name, schedule, **options):
    there = driven.traffic(TIMES[schedule], spoilt(schedule), TICKS, 2)
    return driven.run(name, KNOWN, options, there, inputs(CASE), starts(CASE)[1])[0]


def want(schedule, gate=np.inf, gate_opens=5, huber=np.inf):
    return guarded.filtered(
        MODEL, inputs(CASE), spoilt(schedule), starts(CASE)[1], KNOWN.P0, R, W, gate, gate_opens, huber
    )


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["late", "wild"])
@pytest.mark.parametrize("options", CHOICES, ids=str)
@pytest.mark.parametrize("name", ["kf", "ekf"])
def test_it_is_the_reference_whatever_is_late_lost_or_out_of_sequence(name, options, schedule):
    expected, gone = want(schedule, **options)
    np.testing.assert_allclose(
        run_observer(name, schedule, **options), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )
    assert bool(gone) == ("gate" in options)
    plain = run_observer(name, schedule)
    assert np.abs(plain - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["now", "wild"])
@pytest.mark.parametrize("options", [CHOICES[0], CHOICES[2]], ids=str)
def test_a_sensor_that_is_taken_by_its_slope_is_guarded_alike(options, schedule):
    """Of "now" two channels come together, of "wild" each by itself."""
    sensor = jax.tree_util.Partial(lambda C, now, x, p: C @ x, MODEL.C)
    there = driven.traffic(TIMES[schedule], spoilt(schedule), TICKS, 2)
    xhat = driven.run("ekf", KNOWN._replace(sensor=sensor), options, there, inputs(CASE), starts(CASE)[1])[0]
    expected = want(schedule, **options)[0]
    np.testing.assert_allclose(xhat, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.ci
def test_what_nothing_exceeds_changes_nothing():
    np.testing.assert_allclose(run_observer("kf", "wild", gate=1e9, huber=1e9), run_observer("kf", "wild"), rtol=1e-12)


@pytest.mark.ci
def test_a_gate_that_leaves_out_everything_opens_after_so_many():
    """A start far off its prior: all samples are far from what is expected, until the gate opens."""
    opens = STUDY["options"] | {
        "kf-shut": {"gate": 3.0, "gate_opens": 10_000},
        "kf-opens": {"gate": 3.0, "gate_opens": 2},
    }
    lti = STUDY["lti"] | {"x0": [40.0, 0.0], "A": [[0.0, 1.0], [0.0, -0.4]]}
    study = {"name": "far", "observers": list(opens)[2:], "lti": lti, "options": {k: opens[k] for k in list(opens)[2:]}}
    stats = pcbench.run(study, seeds=8).stats.set_index(["observer", "metric", "signal"])["mean"]
    assert stats["kf-shut", "steady_rmse", "a"] > 20
    assert stats["kf-opens", "steady_rmse", "a"] < 5


@pytest.mark.nightly
def test_where_samples_are_outliers_both_are_better_and_without_hardly_worse():
    options = {"kf-gate": {"gate": 3.0}, "kf-huber": {"huber": 1.5}}
    study = STUDY | {"observers": ["kf", *options], "options": options}
    stats = pcbench.run(study, seeds=512, axes={"outlier_probability": [0.0, 0.1]}).stats
    rows = stats[(stats.metric == "steady_rmse") & (stats.signal == "a")]
    mean = rows.set_index(["observer", "outlier_probability"])["mean"]
    for name in options:
        assert mean[name, 0.1] < 0.8 * mean["kf", 0.1]
        assert mean[name, 0.0] < 1.05 * mean["kf", 0.0]


@pytest.mark.parametrize("name", ["kf", "ekf"])
@pytest.mark.parametrize("given", [{"gate": 0.0}, {"gate": float("nan")}, {"gate_opens": 0}, {"huber": -1.0}], ids=str)
def test_bounds_that_are_none_are_refused(name, given):
    with pytest.raises(ValueError, match=next(iter(given))):
        OBSERVERS[name].options(**given)


def test_what_it_leaves_out_nothing_proves():
    entry = OBSERVERS["kf"]
    assert entry.design(KNOWN, entry.options(gate=3.0)).certificate.margin == float("inf")
    assert entry.design(KNOWN, entry.options()).certificate.margin < float("inf")
