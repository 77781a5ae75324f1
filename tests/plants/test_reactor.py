"""The batch reactor against an integrator of its own, and what estimators make of a poor start."""

import re

import numpy as np
import pytest
from documents import PAGES
from scipy.integrate import solve_ivp

import pcbench

FAILED = 0.3  # atm in the tail, as much as there is left of A


def rate(t, x):
    r = 0.16 * x[0] ** 2 - 0.0064 * x[1]
    return [-2 * r, r]


@pytest.mark.ci
def test_its_run_is_scipys():
    """One Runge-Kutta step a tick of 0.1 s: to 2e-6 atm over 30 s; what reacts is kept, pA + 2 pB."""
    frame = pcbench.simulate(
        {"name": "still", "scenario": {"base": "reactor/batch", "process_std": [0.0, 0.0]}}, ["ekf"]
    )
    got = frame[["pressure_a", "pressure_b"]].to_numpy()
    want = solve_ivp(rate, (0, 30), [3.0, 1.0], t_eval=frame["t"], rtol=1e-10, atol=1e-12).y.T
    np.testing.assert_allclose(got, want, rtol=0, atol=2e-6)
    np.testing.assert_allclose(got @ [1.0, 2.0], 5.0, rtol=0, atol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize(
    "name",
    ["ekf", pytest.param("ekf-iterated", marks=pytest.mark.nightly), pytest.param("mhe", marks=pytest.mark.nightly)],
)
def test_from_a_perfect_start_there_is_no_error_though_samples_are_late_lost_and_out_of_sequence(name):
    """Without noise and from the true pressures; a point of `ukf` is off them, so it has one."""
    still = {"process_std": [0.0, 0.0], "noise_std": [0.0], "assumed_process_std": [1e-3, 1e-3], "xhat0": [3.0, 1.0]}
    late = {"delay": [0.3], "delay_jitter": 0.5, "loss": 0.2, "duration": 8.0, "steady_start": 4.0}
    study = {"name": "perfect", "scenario": {"base": "reactor/batch"} | still | late, "options": {name: {"R": 0.01}}}
    frame = pcbench.simulate(study, [name])
    pairs = [(frame[of], frame[f"{name}.{of}"]) for of in ("pressure_a", "pressure_b")]
    assert max(np.abs(true - said).max() for true, said in pairs) < 1e-11


def test_it_has_equilibria_below_zero_that_no_total_pressure_tells_apart():
    """At rest pB = 25 pA^2, so that pA solves 25 pA^2 + pA = y: one root is a pressure, the other is negative."""
    for total in (1.0, 2.6):
        for pA in np.roots([25.0, 1.0, -total]):
            assert np.abs(rate(0, [pA, total - pA])).max() < 1e-12
    assert sorted(np.sign(np.roots([25.0, 1.0, -2.6]))) == [-1, 1]


@pytest.mark.nightly
def test_from_a_poor_start_the_extended_filter_fails_unless_it_doubts_its_model_and_bounds_help():
    runs = pcbench.run("reactor", seeds=64).runs
    rows = runs[runs.signal == "pressure_a"].set_index("observer")
    failed = {name: (rows.loc[name, "steady_rmse"] > FAILED).mean() for name in rows.index.unique()}
    below = rows.loc["ekf"][rows.loc["ekf", "steady_rmse"] > FAILED]["final_error"]
    assert min(failed["ekf"], failed["ukf"], failed["mhe"]) > 0.8
    assert (below > 0.5).all(), (
        "x - xhat: it has found a pressure below the true one, which is 0.31 atm, by more than that"
    )
    assert failed["ekf-inflated-q"] == failed["mhe-bounded"] == 0.0
    assert rows.loc["mhe-bounded", "steady_rmse"].mean() < 0.2 * rows.loc["ekf-inflated-q", "steady_rmse"].mean()


@pytest.mark.nightly
def test_a_filter_that_is_tuned_does_not_fail_and_bounds_need_no_tuning():
    """Study `equal-tuning-reactor`, as the guide has it: minutes."""
    result = pcbench.run("equal-tuning-reactor")
    tail = result.runs[result.runs.signal == "pressure_a"].set_index("observer")["steady_rmse"]
    rows = re.findall(
        r"^\| `([\w-]+)` \| ([\d.]+) \| (\d+) % \| ([\d.]+) \| (\d+) % \|$", PAGES["reactor_findings.md"], re.M
    )
    assert (
        [name for name, *_ in rows] == result.fair.observer.drop_duplicates().tolist() == ["ekf", "ukf", "mhe-bounded"]
    )
    for name, *said in rows:
        for version, error, failed in (("published", *said[:2]), ("tuned", *said[2:])):
            found = tail[f"{name}-{version}"]
            assert found.mean() == pytest.approx(float(error), rel=0.02)
            assert 100 * (found > FAILED).mean() == pytest.approx(float(failed), abs=1)
    assert (tail["ekf-published"] > FAILED).mean() > 0.8 > 0 == (tail["ekf-tuned"] > FAILED).sum()
    bounds, tuned = tail["mhe-bounded-published"].mean(), tail["ekf-tuned"].mean()
    assert tail["mhe-bounded-tuned"].mean() == pytest.approx(bounds, rel=0.02)
    assert 8 < tuned / bounds < 10


@pytest.mark.nightly
def test_the_guides_table_is_what_comes_out():
    rows = re.findall(r"^\| `([\w-]+)` \| ([\d.]+) \| (\d+) % \| (\d+) \|$", PAGES["reactor_findings.md"], re.M)
    runs = pcbench.run("reactor").runs
    tail = runs[runs.signal == "pressure_a"].set_index("observer")["steady_rmse"]
    costs = pcbench.operation_counts("reactor").set_index("observer")["sample"]
    assert len(rows) == 6
    for name, error, failed, products in rows:
        assert tail[name].mean() == pytest.approx(float(error), rel=0.01)
        assert 100 * (tail[name] > FAILED).mean() == pytest.approx(float(failed), abs=1)
        assert costs[name] == int(products)


@pytest.mark.nightly
def test_tuning_finds_an_extended_filter_that_does_not_fail():
    """Forty looks at 64 runs, judged on others."""
    found = pcbench.tune(
        "reactor/batch",
        "ekf",
        budget=40,
        objective="steady_rmse",
        only=["Q"],
        training_seeds=(0, 64),
        validation_seeds=(100, 164),
    )
    study = {
        "name": "tuned",
        "scenarios": ["reactor/batch"],
        "observers": ["ekf"],
        "options": {"ekf": found.best},
        "seeds": 64,
    }
    runs = pcbench.run(study, first_seed=200).runs
    assert (runs[runs.signal == "pressure_a"].steady_rmse < FAILED).all()
