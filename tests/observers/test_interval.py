"""The interval observer: its ends and both metrics against the reference, the widths of the source, and coverage."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, noise, problem, starts, trace
from reference import field_observers
from reference import linear as reference

import pcbench
from pcbench.errors import DesignError, UserError
from pcbench.observers import OBSERVERS, interval
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.simulation import innovation_stats, metrics, simulate_runs

PRINTED = {(0.2, 0.3): (3.179, 4.776), (0.4, 0.5): (3.767, 4.167), (0.6, 0.7): (5.533, 3.947)}
PUSHED, SEEN = 0.2, 0.05  # bounds of w and v
INTEGRATORS = {
    "A": [[1.0, 0.5], [0.0, 1.0]],
    "B": [[0.125], [0.5]],
    "C": [[1.0, 0.0]],
    "G": [[0.125], [0.5]],
    "QN": [(PUSHED / 6) ** 2],
    "noise_std": SEEN / 6,
    "dt": 0.5,
    "sampling_period": 0.5,
    "delay": 0.5,  # of a period: the predictor of the source
    "duration": 100.0,
    "input": "zero",
}
OSCILLATOR = {
    "A": [[0.0, 1.0], [-2.0, -0.6]],
    "B": [[0.0], [1.5]],
    "C": [[1.0, 0.0]],
    "sampling_period": 0.1,
    "delay": 0.03,
    "noise_std": 0.0,
    "quantization_step": 0.2,  # with dither: uniform noise of at most 0.1, in every run
    "dither": 1,
    "tick": 0.01,
    "duration": 4.0,
    "x0": [0.4, -0.4],
    "xhat0": [0.0, 0.0],
}
BOUNDED = {"noise_bound": [0.1], "initial_bound": [0.5, 0.5]}
ODD_CASE = Case(ODD, 20, 70, ticks=400, h=0.01, noise_std=0.2, seed=5, x0=[2.0, -4.0, 5.0], xhat0=[0.5, -1.0, 2.0])
CART_CASE = Case(CART, 60, 180, noise_std=0.7, x0=[2.0, 3.0], seed=3)
CART_NOW = Case(CART, 150, 0, noise_std=0.7, x0=[2.0, 3.0], seed=3)
pytestmark = pytest.mark.usefixtures("in_a_hurry")


def study(lti, options, **more):
    options = {"interval": options, "scenario": {"random_initial_state": "x0" not in lti}}
    return {"name": "bounds", "lti": lti, "observers": ["interval"], "options": options} | more


def numbers(result, metric):
    return result.stats[result.stats.metric == metric]["mean"].to_numpy()


def reference_ends(case, options):
    """The ends of the reference, with the gain and the coordinates of the design under test."""
    model = reference.Model(case.model.A, case.model.B, case.model.C, case.h)
    q, n = case.model.C.shape
    x, samples = reference.simulate(model, inputs(case), starts(case)[0], [case.te] * q, [case.d] * q, noise(case))
    g = OBSERVERS["interval"].design(context_of(case), interval.Options(**options)).gains
    sigmas = options["sigmas"]
    box = sigmas * np.arange(1.0, n + 1)  # the square root of the prior's variances
    known = field_observers.Bounds(
        g.V, np.abs(np.linalg.inv(g.V)) @ box, np.array(options["process_bound"]), np.full(q, sigmas * case.noise_std)
    )
    return x, *field_observers.interval(model, inputs(case), samples, starts(case)[1], g.L, known)


@pytest.mark.parametrize(
    ("case", "sigmas", "spare"),
    [(CART_CASE, 0.3, 2), (CART_NOW, 3.0, 0), (ODD_CASE, 0.3, 0)],
    ids=["cart, late", "cart", "three states"],
)
def test_both_metrics_equal_the_reference(case, sigmas, spare):
    """With bounds that noise exceeds, the state is in part of the intervals; room for newer samples changes nothing."""
    options = {"sigmas": sigmas, "process_bound": [0.01] * len(case.model.A)}
    x, low, high = reference_ends(case, options)
    layout, p = problem(case, {"interval": options})
    roomy = OBSERVERS["interval"].design(context_of(case)._replace(spare=spare), interval.Options(**options)).gains
    p = p._replace(gains={"interval": roomy})
    out = jax.jit(simulate_runs.simulate_run, static_argnums=0)(layout, p, jnp.asarray(0), jnp.asarray(case.seed))
    found = metrics.finalize(
        out.streams["interval"], out.watches["interval"], out.final["interval"], case.ticks, case.ticks // 2, case.h
    )
    size, N = np.abs(x).max(), case.ticks
    np.testing.assert_allclose(found["interval_width"], (high - low)[:N].mean(0), rtol=0, atol=1e-10 * size)
    inside = ((low <= x) & (x <= high))[:N].mean(0)
    np.testing.assert_allclose(found["interval_coverage"], inside, rtol=0, atol=1e-12)
    assert (inside < 1).any() == (sigmas < 1)


def test_recorded_ends_equal_the_reference():
    options = {"sigmas": 3.0, "process_bound": [0.01] * 3}
    x, low, high = reference_ends(ODD_CASE, options)
    found = np.asarray(trace(ODD_CASE, {"interval": options}).bounds["interval"])
    np.testing.assert_allclose(found, np.stack([low, high], 1), rtol=0, atol=1e-10 * np.abs(x).max())


def test_simulate_has_the_ends_of_each_signal():
    run = pcbench.simulate(study(OSCILLATOR, BOUNDED), "interval")
    for name in ("x1", "x2"):
        low, high = run[f"interval.{name}.low"], run[f"interval.{name}.high"]
        assert ((low <= run[name]) & (run[name] <= high)).all()
        np.testing.assert_allclose((low + high) / 2, run[f"interval.{name}"], atol=1e-9)
        assert high.iloc[-1] - low.iloc[-1] < high.iloc[0] - low.iloc[0]
    assert not any(column.endswith(".low") for column in pcbench.simulate(study(OSCILLATOR, BOUNDED), "kf").columns)


def widths_from(first, options):
    """The mean width from `first` s to twice that time, of the means from 0 to either."""
    each = [
        numbers(pcbench.run(study(INTEGRATORS | {"duration": end}, options, seeds=2)), "interval_width")
        for end in (first, 2 * first)
    ]
    return 2 * each[1] - each[0]


@pytest.mark.parametrize("poles", PRINTED)
def test_widths_of_a_study_end_at_the_printed_ones(poles):
    found = widths_from(50.0, {"poles": [*poles]})
    np.testing.assert_allclose(found, PRINTED[poles], atol=5e-4)
    assert np.all(widths_from(50.0, {"poles": [*poles], "noise_bound": [0.0]}) < found - 0.05), "K v has a part in it"


def test_smallest_bound_of_the_same_error_is_much_narrower():
    """The sum of what each noise leaves of itself at its worst, as the guide says it."""
    b, K = np.array([0.125, 0.5]), np.array([2 - 0.5, (1 - 0.5 + 0.06) / 0.5])
    M = np.array([[1.0, 0.5], [0.0, 1.0]]) - np.outer(K, [1.0, 0.0])
    each = (
        2 * np.abs(np.linalg.matrix_power(M, i) @ v) * size for i in range(99) for v, size in ((b, PUSHED), (K, SEEN))
    )
    smallest = sum(each)
    np.testing.assert_allclose(smallest, [0.38, 0.66], atol=5e-3)
    assert (smallest < PRINTED[0.2, 0.3]).all()


@pytest.mark.parametrize("poles", PRINTED)
def test_design_says_what_the_width_before_a_sample_will_be(poles):
    made = pcbench.design(study(INTEGRATORS, {"poles": [*poles]}), "interval")
    np.testing.assert_allclose(made.certificate.numbers["width_before_sample"], PRINTED[poles], atol=5e-4)
    assert made.certificate.margin == pytest.approx(1 - max(poles), abs=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("poles", PRINTED)
def test_coverage_is_1_in_2000_runs(poles):
    result = pcbench.run(study(INTEGRATORS, {"poles": [*poles]}, seeds=2000))
    rows = result.runs_of("lti", ["interval_coverage", "interval_width"], 0)
    assert len(rows) == 2 * 2000
    assert (rows.interval_coverage == 1).all()
    assert (np.ptp(rows.interval_width.to_numpy().reshape(-1, 2), axis=0) < 1e-9).all(), "up to 2e-12 |xhat| < 500"


def test_coverage_is_1_with_noise_that_cannot_leave_its_bounds():
    """Rounding moves a measurement by half a step at most, so every run is within the bounds."""
    result = pcbench.run(study(OSCILLATOR, BOUNDED, seeds=64))
    rows = result.runs_of("lti", ["interval_coverage"], 0)
    assert (rows.interval_coverage == 1).all()


@pytest.mark.parametrize(("key", "part"), [("noise_bound", [0.02]), ("initial_bound", [0.02, 0.02])])
def test_coverage_falls_below_1_when_a_bound_is_too_small(key, part):
    result = pcbench.run(study(OSCILLATOR, BOUNDED | {key: part}, seeds=64))
    assert (numbers(result, "interval_coverage") < 1).all()


def test_coverage_falls_below_1_when_the_noise_is_larger_than_assumed():
    true = INTEGRATORS | {"noise_std": 100 * SEEN / 6, "assumed_noise_scale": 0.01}
    assert (numbers(pcbench.run(study(true, {"poles": [0.2, 0.3]}, seeds=16)), "interval_coverage") < 1).all()


@pytest.mark.ci
@pytest.mark.parametrize(
    "late", [{"loss": [0.4]}, {"delay_jitter": [0.25]}, {"sampling_jitter": [0.04], "loss": [0.2]}]
)
def test_coverage_is_1_with_jitter_and_lost_and_out_of_sequence_samples(late):
    result = pcbench.run(study(OSCILLATOR, BOUNDED, seeds=64, axes=late))
    wide = numbers(result, "interval_width")
    assert (numbers(result, "interval_coverage") == 1).all()
    assert (wide > numbers(pcbench.run(study(OSCILLATOR, BOUNDED, seeds=64)), "interval_width")).all()


def test_a_channel_that_is_missing_corrects_nothing():
    """As a row of a recording may be: the same as a gain of 0 for the channel, in estimate and radius."""
    g = jax.tree.map(jnp.asarray, OBSERVERS["interval"].design(context_of(ODD_CASE), interval.Options()).gains)
    ball = interval.Ball(jnp.array([1.0, -2.0, 3.0]), jnp.asarray(4), jnp.asarray(np.arange(15.0).reshape(3, 5)))
    value, here = jnp.array([0.7, -0.4]), np.array([True, False])
    part = interval.correct(g, ball, Measurement(jnp.asarray(9), value, jnp.asarray(here), jnp.ones(3)))
    all_ = interval.correct(
        g._replace(L=g.L * here[None]), ball, Measurement(jnp.asarray(9), value, jnp.ones(2, bool), jnp.ones(3))
    )
    for a, b in zip(part, all_, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    assert np.abs(g.L[:, 1]).max() > 0.01


def test_a_gain_with_complex_poles_is_certified_and_covers():
    found = pcbench.design(study(OSCILLATOR, BOUNDED | {"L": [[0.5], [0.9]]}), "interval")
    g, N = found.gains, np.asarray(found.certificate.numbers["N"])
    assert np.abs(N - np.diag(np.diag(N))).max() > 0.01, "the poles are complex"
    assert found.certificate.margin == pytest.approx(1 - np.abs(np.linalg.eigvals(N)).max(), abs=1e-12)
    np.testing.assert_allclose(g.V @ g.V_inv, np.eye(2), atol=1e-12)
    rows = pcbench.run(study(OSCILLATOR, BOUNDED | {"L": [[0.5], [0.9]]}, seeds=64)).runs_of(
        "lti", ["interval_coverage"], 0
    )
    assert (rows.interval_coverage == 1).all()


def test_bounds_stay_where_innovations_are_judged_too():
    o = OBSERVERS["kf"].observer._replace(bounds=lambda gains, memory: (memory, gains))
    made = innovation_stats.sum_innovations(o, o.innovation)
    assert made.bounds(1, innovation_stats.StatsMemory(2, None)) == (2, 1)


def test_observers_without_bounds_have_neither_metric():
    both = study(INTEGRATORS, {"poles": [0.2, 0.3]}, seeds=2) | {"observers": ["interval", "kf"]}
    result = pcbench.run(both)
    asked = result.stats[result.stats.metric.str.startswith("interval")]
    assert set(asked.observer) == {"interval"}
    assert asked.unit.tolist() == ["1", "1", "1", "1"]
    assert "interval_width" not in pcbench.run(both | {"observers": ["kf"]}).runs_of("lti", ["rmse"], 0).columns
    assert not result.pairs.metric.str.startswith("interval").any()


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        ({"poles": [0.2]}, UserError, "poles: got 1, expected 2, one for each state"),
        ({"poles": [0.3, 0.3]}, DesignError, "got a gain with the poles .* per sample, expected distinct ones"),
        ({"poles": [0.3, 1.2]}, DesignError, "the gain is not certified"),
        ({"noise_bound": [0.1, 0.1]}, UserError, r"noise_bound: got \[0.1, 0.1\], expected 1 numbers of at least 0"),
        ({"initial_bound": [0.1, -0.1]}, UserError, "expected 2 numbers of at least 0, one for each state"),
    ],
)
def test_what_cannot_be_designed_is_one_sentence(options, error, sentence):
    with pytest.raises(error, match=sentence):
        pcbench.design(study(INTEGRATORS, options), "interval")
