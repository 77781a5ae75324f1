"""Prediction in a loop around an unstable plant: the response to the input starts again, and no digits are lost."""

import re
from contextlib import suppress

import numpy as np
import pytest
from documents import PAGES

import pcbench
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.observers.parts import prediction
from pcbench.planning import all_observers, design_context

PENDULUM = {
    "A": [[0.0, 1.0], [9.0, 0.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "states": ["angle [rad]", "rate [rad/s]"],
    "tick": 0.01, "sampling_period": 0.05, "delay": 0.03, "noise_std": 0.01, "process_std": [0.0, 0.01], "x0": [0.2, 0.0],
    "xhat0": [0.0, 0.0], "prior_std": [0.3, 0.3],
}  # fmt: skip
LATE = {"delay": 0.06, "delay_jitter": 0.04, "loss": 0.2}  # samples arrive out of sequence
IN_TURN = {"delay_sequence": [0.02, 0.14, 0.04, 0.03]}  # the same samples are out of sequence in every run
FEEDBACK = {"use": "lqr", "Q1": [10.0, 1.0], "Q2": 1.0}
GATE = {"observers": {"kf-gate": {"use": "kf", "gate": 3.0}}}
pytestmark = pytest.mark.usefixtures("in_a_hurry")


def loop(observer, duration, **changes):
    """Return a study of the pendulum, which a controller keeps upright."""
    lti = PENDULUM | {"duration": duration, "divergence_threshold": 1e3} | changes
    named = GATE if observer == "kf-gate" else {}
    return {"name": "loop", "lti": lti, "controller": FEEDBACK, "observers": [observer], "seeds": 4} | named


def estimates(observer, duration, seed=0, **changes):
    """Return angle and rate, estimated over a run."""
    run = pcbench.simulate(loop(observer, duration, **changes), [observer], seed=seed)
    return run[[f"{observer}.angle", f"{observer}.rate"]].to_numpy()


def both(monkeypatch, observer, **changes):
    """Return the estimates with a response that starts at t = 0 and with one that starts again, over 2 s."""
    monkeypatch.setattr(prediction, "LARGEST_GROWTH", np.inf)
    kept = estimates(observer, 2.0, **changes)
    monkeypatch.setattr(prediction, "LARGEST_GROWTH", 1.0)
    return kept, estimates(observer, 2.0, **changes)


@pytest.mark.parametrize(
    ("observer", "changes"),
    [("kf", LATE), ("kf", IN_TURN)]
    + [pytest.param(o, LATE, marks=pytest.mark.ci) for o in ("kf-gate", "kf-ignore-delay", "kf-alexander", "kf-larsen")]
    + [pytest.param(o, {}, marks=pytest.mark.ci) for o in ("pccebo", "pco", "eso", "interval", "finite-time")]
    + [pytest.param(o, IN_TURN, marks=pytest.mark.ci) for o in ("kf-gate", "pccebo", "pco", "interval", "finite-time")],
)
def test_estimates_do_not_depend_on_where_the_response_starts(monkeypatch, observer, changes):
    """Over 2 s the plant grows by e^6, so that both ways have enough digits."""
    kept, restarted = both(monkeypatch, observer, **changes)
    np.testing.assert_allclose(restarted, kept, rtol=0, atol=1e-10)
    if observer not in ("kf-alexander", "kf-larsen"):  # they keep no response
        assert (restarted != kept).any(), "both were computed in the same way"


@pytest.mark.ci
@pytest.mark.parametrize("changes", [{}, LATE, IN_TURN])
def test_kf_equals_ekf_where_the_plant_grows_by_e_60(changes):
    """`ekf` moves tick by tick, so that it keeps its digits in a loop of any length."""
    np.testing.assert_allclose(estimates("kf", 20.0, **changes), estimates("ekf", 20.0, **changes), rtol=0, atol=1e-9)


@pytest.mark.nightly
def test_consistency_is_that_of_ekf_where_the_plant_grows_by_e_60():
    """NIS and NEES use the innovations and the covariance, which need the response too."""
    got = {}
    for observer in ("kf", "ekf"):
        study = loop(observer, 20.0, **LATE) | {
            "options": {"scenario": {"consistency": True, "random_initial_state": True}}
        }
        stats = pcbench.run(study).stats.set_index(["metric", "signal"])["mean"]
        got[observer] = stats.loc[["nis", "nees", "steady_rmse"]].to_numpy()
    assert np.isfinite(got["kf"]).all()
    np.testing.assert_allclose(got["kf"], got["ekf"], rtol=1e-7)


def test_the_limitations_name_each_observer_whose_response_starts_at_zero():
    (cell,) = all_observers.grid_of(loop("kf", 20.0), {}, []).cells
    context, kept = design_context.context_of(cell), []
    for name, entry in OBSERVERS.items():
        with suppress(UserError):  # it does not support this plant
            motion = getattr(entry.design(context, entry.options()).gains, "motion", None)
            kept += [name] * (isinstance(motion, prediction.Motion) and motion.restarts is None)
    (sentence,) = re.findall(r"only short runs are accurate with ([^.]*)", PAGES["limitations.md"])
    assert sorted(re.findall("`(.*?)`", sentence)) == sorted(kept)


@pytest.mark.slow
def test_exact_moments_have_an_answer_where_the_plant_grows_by_e_30():
    stats = pcbench.exact_moments(loop("kf", 10.0)).stats.set_index(["metric", "signal"])
    runs = pcbench.run(loop("kf", 10.0) | {"seeds": 1024}).stats.set_index(["metric", "signal"])
    for signal in ("angle", "rate"):
        exact, mean = stats.loc[("steady_pooled_rmse", signal)], runs.loc[("steady_pooled_rmse", signal)]
        assert abs(mean["mean"] - exact["mean"]) < 4 * mean["se"]
