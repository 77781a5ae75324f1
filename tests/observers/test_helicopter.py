"""The helicopter's closed loop against the independent reference, tick by tick, and numbers worked out beforehand."""

import jax.numpy as jnp
import numpy as np
import pytest
from helicopters import EARLY, OBSERVERS, TRUTH, estimate, gap, plan_run, record, reference_run
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import high_gain as forms

from pcbench.plants import helicopter
from pcbench.protocols import Arrival, Now

PAGE = {  # scenario, observer, t [s]: pitch, yaw, rates; estimates
    ("constant", "high-gain", 0.2): (
        (0.75218322, 0.55962378, -0.68169631, 0.08354768),
        (0.90943441, 0.70891440, 0.00295226, 1.53341931, -0.26119997, -0.09955112),
    ),
    ("constant", "high-gain", 1.0): (
        (1.22846267, 0.70092927, 0.42429276, 1.44232089),
        (1.21961052, 0.70454599, 0.38777588, 1.52285695, 0.89628588, 0.25589311),
    ),
    ("constant", "high-gain", 20.0): (
        (1.22846331, 0.79399943, 0.45708995, 0.43613415),
        (1.22846330, 0.79399943, 0.45708991, 0.43613416, 0.80000004, 0.31799999),
    ),
    ("varying", "high-gain", 1.0): (
        (1.23720133, 0.57914114, 0.36049004, -1.69236518),
        (1.21348420, 0.61199818, 0.30115652, -1.96037129, 0.88753168, 0.21518490),
    ),
    ("varying", "high-gain", 20.0): (
        (1.23509469, 0.79347545, 0.45823207, 0.43660497),
        (1.23509468, 0.79347545, 0.45823204, 0.43660498, 0.80000002, 0.31799998),
    ),
    ("constant", "high-gain-robust", 1.0): (
        (1.10805486, 0.70461511, 0.54421463, 0.97159748),
        (1.12819911, 0.70970198, 0.63436834, 1.02527926, 0.69469811, 0.28871150),
    ),
}
SHORT = 0.5  # s: one shape for all tests, but for the first second that was worked out beforehand


def test_the_worked_accelerations():
    params = helicopter.prepare(helicopter.Numbers(), 1e-3, 1)
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(1e-3), jnp.array([8.0, -3.0]), lambda age: age)
    rate = helicopter.field(params, now, jnp.array([0.5, -0.3, 0.7, -1.1]))
    np.testing.assert_allclose(rate, [0.7, -1.1, -13.822427543781945, 3.4668418838283315], rtol=0, atol=1e-12)


def test_viscosities_drift_as_a_sine_of_twenty_seconds():
    """At rest where they began, the whole drift more after five seconds, and back after ten."""
    params = helicopter.prepare(helicopter.Numbers(drift=0.3), 1e-3, 1)
    nothing = jnp.zeros(2)
    for t, part in ((0.0, 0.0), (5.0, 0.3), (10.0, 0.0), (15.0, -0.3), (20 / 12, 0.15)):
        now = Now(jnp.asarray(t), jnp.asarray(0), jnp.asarray(1e-3), nothing, lambda age: nothing)
        found = helicopter.unknown(params, now, jnp.zeros(4))
        np.testing.assert_allclose(found, np.array(TRUTH) * (1 + part), rtol=1e-12)


def test_an_older_sample_does_not_take_the_place_of_a_newer_one():
    """Each channel by itself; what is not fresh changes nothing, and c is what the model expected less what was measured."""
    p = plan_run("high-gain", SHORT)
    gains, observer = p.problem.gains["high-gain"], p.layout.observers[0][1]
    memory = observer.init(gains, jnp.asarray(p.problem.xhat0))._replace(
        c=jnp.array([5.0, 6.0]), newest=jnp.array([3, 3])
    )
    snapshot, value = jnp.array([1.0, 2.0]), jnp.array([0.25, 0.5])
    now = Now(jnp.asarray(0.005), jnp.asarray(5), jnp.asarray(1e-3), jnp.zeros(2), lambda age: jnp.zeros(2))
    for mask, index, c, newest in (
        ((True, True), (4, 2), (0.75, 6.0), (4, 3)),
        ((False, True), (9, 4), (5.0, 1.5), (3, 4)),
        ((True, True), (3, 3), (5.0, 6.0), (3, 3)),
    ):
        arrival = Arrival(value, jnp.array(mask), jnp.zeros(2, int), jnp.array(index), snapshot, jnp.asarray(1))
        jumped = observer.jump(gains, memory, now, arrival)
        assert (jumped.c.tolist(), jumped.newest.tolist()) == (list(c), list(newest))


@pytest.mark.ci
@pytest.mark.parametrize("case", [case for case in PAGE if case[2] <= 1], ids=str)
def test_the_worked_first_second(case):
    assert_page(case, record(plan_run(case[1], 1.0, name=case[0])))


def assert_page(case, got):
    k = round(case[2] / 1e-3)
    x, z = PAGE[case]
    np.testing.assert_allclose(got.x[k, :4], x, rtol=0, atol=1e-6)
    np.testing.assert_allclose(estimate(got)[k], z, rtol=0, atol=1e-6)


@pytest.mark.nightly
@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("name", ["constant", "varying"])
def test_twenty_seconds_equal_the_reference(name, observer):
    """The loop amplifies rounding: 1e-9, and the numbers worked out beforehand on the way."""
    p = plan_run(observer, 20.0, name=name)
    got, want = record(p), reference_run(p)
    for found, there in ((got.x[:, :4], want.x), (estimate(got), want.z), (got.u, want.u)):
        np.testing.assert_allclose(found, there, rtol=0, atol=1e-9)
    for case in PAGE:
        if case[:2] == (name, observer):
            assert_page(case, got)
    if (name, observer) == ("constant", "high-gain"):
        rmse = np.sqrt(((got.x[:-1, :4] - estimate(got)[:-1, :4]) ** 2).mean(0))
        np.testing.assert_allclose(rmse, [0.0132608, 0.00916999, 0.0986503, 0.1009805], rtol=2e-6)


@pytest.mark.nightly
@settings(max_examples=3)
@given(
    observer=st.sampled_from(sorted(OBSERVERS)),
    period=st.integers(1, 300),
    delay=st.integers(0, 60),
    swing=st.floats(0, 0.9),
    noise=st.sampled_from([0.0, 5e-3]),
    drift=st.sampled_from([0.0, 0.3]),
)
def test_any_period_delay_and_noise_equals_the_reference(observer, period, delay, swing, noise, drift):
    if delay < 2 or period == 1:
        swing = 0.0  # no delay at all, or one tick; with a sample at every tick some would come twice
    p = plan_run(observer, SHORT, sampling_period=period * 1e-3, delay=delay * 1e-3,
                delay_sine=(swing * (delay - 1) * 1e-3, 2.0), noise_std=noise, parameter_drift=drift)  # fmt: skip
    if len(p.problem.schedule.early) > EARLY:
        return
    assert gap(p) < 1e-9


BOTH = {"feedforward": True, "predictor": True}


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("constant", {"feedforward": True}),
        *(pytest.param("constant", c, marks=pytest.mark.nightly) for c in ({"predictor": True}, BOTH)),
        pytest.param("varying", BOTH, marks=pytest.mark.nightly),
    ],
)
@pytest.mark.nightly
def test_the_controllers_options_equal_the_reference(name, choices):
    assert gap(plan_run("high-gain", SHORT, name=name, choices=choices)) < 1e-9


@pytest.mark.parametrize("form", [forms.blocks(), forms.predictor()], ids=["two blocks", "predictor"])
@pytest.mark.nightly
def test_other_forms_of_the_observer_are_the_same(form):
    assert gap(plan_run("high-gain", SHORT, name="varying"), form) < 1e-10


@pytest.mark.ci
@pytest.mark.parametrize("misprint", forms.MISPRINTS)
def test_a_misprint_would_be_seen(misprint):
    tuning = forms.Tuning(misprint=misprint)
    assert not gap(plan_run("high-gain", SHORT), forms.high_gain(tuning)) < 1e-3


@pytest.mark.parametrize(
    "observer", [pytest.param(o, marks=pytest.mark.nightly) if o == "ekf" else o for o in OBSERVERS]
)
@settings(max_examples=4)
@given(period=st.integers(1, 250), delay=st.integers(0, 60), feedforward=st.booleans())
def test_a_perfect_start_has_no_error(observer, period, delay, feedforward):
    """True start and viscosities, no noise: z follows x; only rounding, which the loop amplifies."""
    p = plan_run(
        observer, SHORT, sampling_period=period * 1e-3, delay=delay * 1e-3, choices={"feedforward": feedforward}
    )
    s = p.cell.scenario
    p = plan_run(observer, SHORT, sampling_period=period * 1e-3, delay=delay * 1e-3, choices={"feedforward": feedforward},
                xhat0=s.truth.x0, unknown0=TRUTH)  # fmt: skip
    got = record(p)
    assert np.abs(got.x - estimate(got)).max() < 1e-11


def shift_tick(p, what):
    """One tick off somewhere in the loop."""
    problem, plan = p.problem, p.problem.schedule
    if what == "line":
        return problem._replace(line=problem.line._replace(lag=problem.line.lag + 1))
    if what == "whole tick":  # the command read at the tick's start
        return problem._replace(line=problem.line._replace(weight=problem.line.weight - 0.5))
    if what == "path":
        return problem._replace(control=problem.control._replace(path=np.roll(problem.control.path, 1, 0)))
    if what == "note":
        return problem._replace(schedule=plan._replace(snapshot=np.roll(plan.snapshot, 1), event=np.ones_like(plan.event),
                                                       next_event=np.arange(1, len(plan.event) + 1)))  # fmt: skip
    if what == "sense":
        return problem._replace(schedule=plan._replace(sense=np.roll(plan.sense, 1), sample=np.roll(plan.sample, 1, 0),
                                                       event=np.ones_like(plan.event),
                                                       next_event=np.arange(1, len(plan.event) + 1)))  # fmt: skip
    return problem._replace(schedule=plan._replace(timestamp=plan.timestamp + 1))


@pytest.mark.parametrize(
    ("observer", "what"),
    [
        *(("high-gain", what) for what in ("line", "whole tick", "path", "note", "sense")),
        *(pytest.param("ekf", what, marks=pytest.mark.nightly) for what in ("line", "age")),
    ],
)
def test_one_tick_off_is_seen(observer, what):
    p = plan_run(observer, SHORT)
    got, want = record(p._replace(problem=shift_tick(p, what))), reference_run(p)
    assert np.abs(estimate(got) - want.z).max() > 1e-4


@pytest.mark.nightly
def test_process_noise_of_another_state_is_seen():
    p = plan_run("ekf", SHORT)
    gains = p.problem.gains["ekf"]
    wrong = p.problem.gains | {"ekf": gains._replace(Q=np.roll(gains.Q, 1, 0))}
    got, want = record(p._replace(problem=p.problem._replace(gains=wrong))), reference_run(p)
    assert np.abs(estimate(got) - want.z).max() > 1e-4
