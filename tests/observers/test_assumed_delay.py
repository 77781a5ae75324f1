"""`assumed_delay_error`: every observer that uses a sample's age is wrong by what it wrongly believes, and by nothing else."""

import numpy as np
import pytest

import pcbench
from pcbench.errors import UserError

WRONG = [-0.05, 0.0, 0.05]
LABELS = ["pccebo", "pco", "pi-pco", "kf", "kfbo-aware"]


@pytest.fixture(scope="module")
def traces():
    """Noise off, true start, a cart at about constant speed (constant input): without the error every estimate is exact."""
    study = {
        "name": "late",
        "scenarios": ["cart/nominal"],
        "observers": LABELS,
        "options": {"kfbo-aware": {"lag_aware": True, "R": 0.004}, "scenario": {"input": "step"}},
    }
    return {w: pcbench.simulate(study | {"axes": {"assumed_delay_error": [w]}}, LABELS) for w in WRONG}


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["pccebo", "pco", "pi-pco", "kf"])
@pytest.mark.parametrize("wrong", WRONG)
def test_a_sample_taken_for_older_puts_the_estimate_ahead_by_the_way_made_meanwhile(traces, observer, wrong):
    """At constant speed v the position measured at t - d is assumed to be of t - d - w: the estimate is v w ahead."""
    d = traces[wrong].iloc[-1]
    v = d["velocity"]
    assert abs(v) > 1
    e = d["position"] - d[f"{observer}.position"]
    slow = {
        "kf": 2e-2 * v,
        "pi-pco": 1e-5,
    }  # what is left of the start: a filter's gain falls, an integral has a slow mode
    assert e == pytest.approx(-v * wrong, rel=0, abs=slow.get(observer, 1e-9))


@pytest.mark.ci
def test_kfbo_follows_its_assumed_delay_too(traces):
    ends = [traces[w]["kfbo-aware.position"].iloc[-1] for w in WRONG]
    steps = np.diff(ends)
    v = traces[0.0]["velocity"].iloc[-1]
    np.testing.assert_allclose(steps, 0.05 * v, rtol=0.05)


@pytest.mark.nightly
def test_the_axis_works_for_every_observer_of_a_study():
    result = pcbench.run(
        "cart/white", observers=["pccebo", "kfbo", "pco", "pi-pco", "kf", "model-only"], seeds=8,
        axes={"assumed_delay_error": [0.0, 0.1]},
    )  # fmt: skip
    rows = result.stats.query("signal == 'position' and metric == 'steady_rmse'").pivot(
        index="observer", columns="assumed_delay_error", values="mean"
    )
    same = pytest.approx(rows.loc["model-only", 0.1], rel=1e-12)  # sums over other chunks: notes fall at other ticks
    assert rows.loc["model-only", 0.0] == same, "it uses no sample"
    assert (rows[0.0] != rows[0.1]).sum() == 5, "all others use the delay"
    assert rows.loc["kf", 0.0] < 0.5 * rows.loc["kf", 0.1]


def test_a_belief_in_samples_from_the_future_is_refused():
    with pytest.raises(UserError, match=r"expected an assumed delay of 0 or more; write at least -0.2"):
        pcbench.run("cart/white", axes={"assumed_delay_error": [-0.3]}, seeds=1)
