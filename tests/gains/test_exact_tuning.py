"""Tuning without seeds: value and gradient are those of moments computed another way, and what has none says so."""

from pathlib import Path

import follower
import numpy as np
import pytest
from harness import ODD
from reference import linear, moments

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.gains import objective_eval, tune
from pcbench.gains.objective import objective_of
from pcbench.planning import padding
from pcbench.runtime import config
from pcbench.study import parse
from pcbench.study.labels import label_of

pytestmark = pytest.mark.usefixtures("in_a_hurry")

N, TICK, TE, LATE, TAIL = 48, 0.02, 9, 5, 20
NOISE, X0, XHAT0 = [0.3, 0.2], [0.5, -0.2, 0.3], [0.1, 0.1, -0.2]
L = [[0.3, -0.1], [0.2, 0.25], [-0.1, 0.15]]
STUDY = {
    "name": "odd",
    "lti": {
        "A": ODD.A.tolist(), "B": ODD.B.tolist(), "C": ODD.C.tolist(), "x0": X0, "xhat0": XHAT0,
        "prior_std": [0.4, 0.3, 0.5], "tick": TICK, "duration": N * TICK, "steady_start": TAIL * TICK, "noise_std": NOISE,
        "sampling_period": TE * TICK, "delay": LATE * TICK, "states": ["a", "b", "c"], "input": "sine,sawtooth",
    },
    "options": {"pccebo": {"L": L}},
}  # fmt: skip
LOOP = {
    "name": "loop",
    "lti": {
        "A": [[0.3]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.8], "prior_std": [0.5], "tick": 0.1, "duration": 4.0,
        "steady_start": 1.0, "noise_std": 0.3, "process_std": 0.1, "sampling_period": 0.3, "delay": 0.2, "states": ["a"],
    },
    "controller": {"use": "state-feedback", "K": [[1.0]]},
    "options": {"kf": {"R": 0.05}},
}  # fmt: skip

OWN = {"name": "own", "lti": LOOP["lti"] | {"input": "sine"}}


def evaluator_and_start(study, observer, objective, signal=None, only=None):
    """What evaluates an exact objective, and where it starts."""
    study, cell = parse.one_cell(study, [observer], [])
    observer = label_of(observer)
    context = planning.context_of(cell)
    design = planning.run_design(observer, cell.entry(observer), context, cell.options[observer])
    free, start = tune.free_parameters(observer, cell, context, design, only, "test")
    (p,) = padding.fit(list(planning.drafts([cell])))
    aim = objective_of(objective, cell.scenario, signal, "test")
    gains = tune.gains_at(observer, cell, context, free)
    return objective_eval.exact_evaluator(p, aim, len(start), gains, "test"), start


def by_impulses(gain):
    """Mean and variance [N+1, 3] of pccebo's error, a sample's noise at a time."""
    model = linear.Model(ODD.A, ODD.B, ODD.C, TICK)
    driven = pcbench.simulate(STUDY, "model-only")[["u1", "u2"]].to_numpy()

    def error_of(u, start, xhat0, noise):
        x, samples = linear.simulate(model, u, start, [TE, TE], [LATE, LATE], noise)
        return x - linear.pccebo(model, u, samples, xhat0, gain)

    counts = moments.sample_counts(N, [TE, TE], [LATE, LATE])
    found = moments.error_map(error_of, driven, np.array(X0), np.array(XHAT0), counts)
    return found.base, np.diagonal(moments.covariance(found, np.repeat(NOISE, counts)), axis1=1, axis2=2)


KNOWN = {
    "steady_pooled_rmse": lambda m, p: moments.root_expected_mse(m, p, TAIL, N)[1],
    "mae": lambda m, p: moments.expected_mae(m, p, 0, N)[1],
}


@pytest.mark.ci
@pytest.mark.parametrize("metric", ["steady_pooled_rmse", pytest.param("mae", marks=pytest.mark.nightly)])
def test_value_and_gradient_are_those_of_impulses_sent_one_by_one(metric):
    """The value to 1e-10; the gradient to what central differences of the other give: 1e-7."""
    of = KNOWN[metric]
    step, there, way = 1e-5, np.array(L), np.array([[0.4, -0.3], [1.0, 0.2], [-0.6, 0.7]])
    up, down = by_impulses(there + step * way), by_impulses(there - step * way)
    with config.float64():
        evaluate, start = evaluator_and_start(STUDY, "pccebo", metric, "b")
        value, slope = evaluate(start)
    assert value == pytest.approx(of(*by_impulses(there)), rel=1e-10)
    apart = (of(*up) - of(*down)) / (2 * step)
    assert slope @ way.ravel() / np.abs(there).max() == pytest.approx(apart, rel=1e-7)


@pytest.mark.nightly
def test_a_loops_gradient_is_that_of_its_values():
    """Where tuning by runs has none."""
    with config.float64():
        evaluate, start = evaluator_and_start(LOOP, "kf", "pooled_rmse")
        _, slope = evaluate(start)
        step = 1e-4
        apart = [
            (evaluate(start + step * e)[0] - evaluate(start - step * e)[0]) / (2 * step) for e in np.eye(len(start))
        ]
    np.testing.assert_allclose(slope, apart, rtol=1e-5)
    assert np.abs(slope).min() > 1e-3


@pytest.mark.ci
def test_a_gain_of_zero_has_its_slope_though_a_tick_is_the_same_without_it():
    with config.float64():
        evaluate, start = evaluator_and_start(OWN, f"{Path(follower.__file__)}:follow", "mse")
        slope, step = evaluate(start)[1], 1e-6
        apart = (evaluate(start + step)[0] - evaluate(start - step)[0]) / (2 * step)
    assert start == 0
    assert slope[0] == pytest.approx(apart, rel=1e-7)
    assert abs(apart) > 1e-3


def refusal(*words, **changes):
    with pytest.raises(UserError) as caught:
        pcbench.tune(*words, exact_objective=True, **changes)
    said = str(caught.value)
    assert "\n" not in said
    return said


def test_what_has_no_exact_value_says_so_and_what_to_do():
    assert "rmse, which has no exact value (the mean of a root" in refusal("cart/slow", "pccebo", objective="rmse")
    assert "steady_max_abs_error, which has no exact value" in refusal(
        "cart/slow", "pccebo", objective="steady_max_abs_error"
    )
    assert "kf has samples of which 10 % are outliers, whose noise is not normal; tune on runs instead" in refusal(
        "cart/gaussian", "kf", overrides=["axes.outlier_probability=0.1"]
    )
    assert "particle keeps 1,802 numbers, where exact moments follow the covariance of at most 1,024" in refusal(
        "cart/gaussian", "particle"
    )
    assert "an expected value needs no runs" in refusal("cart/slow", "pccebo", training_seeds=(0, 8))
    random = refusal("cart/slow", "pccebo", overrides=["axes.delay_jitter=0.1"])
    assert random.endswith("expected the same for all runs, as a gradient is for one schedule; "
                           "tune on runs instead (exact_objective = false).")  # fmt: skip


def test_a_mean_size_has_an_exact_value_of_normal_errors_alone():
    with config.float64():
        _, cell = parse.one_cell(OWN, ["model-only"], [])
        (p,) = padding.fit(list(planning.drafts([cell])))
    scatter = np.full(len(p.problem.x0), 0.1)
    boxed = p._replace(layout=p.layout._replace(scattered=True), problem=p.problem._replace(scatter=scatter))
    objective_eval.exact_cell(objective_of("mse", cell.scenario, None, "test"), boxed, "test")
    with pytest.raises(UserError, match="got steady_mae of an error that is not normal"):
        objective_eval.exact_cell(objective_of("steady_mae", cell.scenario, None, "test"), boxed, "test")


@pytest.mark.ci
def test_an_observer_that_is_not_affine_is_tuned_on_runs():
    steps = {"options": {"follow_by_steps": {"L": 0.1}}}
    said = refusal(OWN | steps, f"{Path(follower.__file__)}:follow_by_steps")
    assert "follow_by_steps is not affine in the noise: a is off by" in said
    assert said.endswith("tune on runs instead (exact_objective = false).")


@pytest.mark.nightly
def test_going_down_needs_no_seeds_and_what_is_found_runs_as_a_study(tmp_path):
    how = {"objective": "steady_pooled_rmse", "signal": "b", "exact_objective": True}
    found = pcbench.tune(STUDY, "pccebo", budget=8, out=tmp_path / "out", **how)
    (judged,) = found.judgements
    assert (judged.what, judged.seeds.many, judged.tuned_se) == ("exact", 0, 0)
    assert judged.tuned < 0.99 * judged.start
    stats = pcbench.exact_moments(tmp_path / "out" / "tuned.toml").stats
    row = stats.query("signal == 'b' and metric == 'steady_mse'")
    assert row["mean"].item() == pytest.approx(judged.tuned, rel=1e-12)
    again = pcbench.tune(STUDY, "pccebo", budget=8, out=tmp_path / "out", **how)
    assert again.best == found.best
    assert again.exact
    with pytest.raises(UserError, match="contains another tuning"):
        pcbench.tune(STUDY, "pccebo", budget=3, out=tmp_path / "out", **how | {"exact_objective": False})
