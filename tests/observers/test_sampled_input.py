"""Observers of an unknown input on samples of the arm: tick by tick what the reference does, drift and kf included.

Tolerance: 1e-10 (two programs of the same arithmetic agree to some 1e-14; kf without noise, whose variances span 12 decades,
to 1e-10 of the input's size of 1). Every tick has another input and another noise.
"""

from functools import cache
from itertools import pairwise

import jax
import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from reference import unknown_input as ui

import pcbench
from pcbench import planning
from pcbench.observers import entry_of
from pcbench.planning import padding, run_local
from pcbench.scenarios import SCENARIOS
from pcbench.scenarios.signals import SIGNALS
from pcbench.simulation import rng, trajectory
from pcbench.study import Study
from pcbench.study.grid import cell_of

OBSERVERS = ("smo", "pio", "kf")
FINDERS = {"smo": ui.SMO, "pio": ui.PIO}
TICK, TICKS = 5e-4, 900
TIMES = [(20, 0), (1, 0), (40, 40), (7, 13), (30, 400), (400, 400)]  # sampling period and delay, in ticks
VARIANTS = {
    "predict": {},
    "hold": {"measurement": "hold"},
    "reconstruct": {"reconstruct": True},
}


def plan_cell(te, d, option=None, others=None, **changes):
    """A cell of arm/sampled, its finders with an option; all of one shape, that of a drifting plant with room for any delay."""
    s = SCENARIOS["arm/sampled"].with_fields(duration=TICKS * TICK, steady_start=TICKS * TICK / 2, noise_std=(0.0, 0.0))
    s = s.with_fields(sampling_period=(te * TICK,) * 2, delay=(d * TICK,) * 2, **changes)
    given = dict.fromkeys(FINDERS, option or {}) | (others or {})
    options = {o: entry_of(o).options(**{**s.options.get(o, {}), **given.get(o, {})}) for o in OBSERVERS}
    return planning.draft(cell_of(s), options)


@cache
def layout():
    (p,) = padding.fit([plan_cell(1, 400, parameter_drift=0.05)])
    return p.layout


def record(p, seed=0):
    """One run, arrays [N+1, ...]."""
    problem = jax.tree.map(np.asarray, p.problem)
    return jax.tree.map(np.asarray, trajectory.jit_record()(layout(), problem, np.asarray(0), np.asarray(seed)))


@cache
def arm(parameter_drift=0.0, seed=0):
    """The arm's x by the reference [N+1, 1, 4]; a drift of size a has the pace and the phase that the library draws."""
    pace, phase = np.asarray(rng.uniforms(0, np.array([seed]), "drift", 0, 1, 2))[0, :, 0] * [
        1.8,
        2 * np.pi,
    ] + [
        0.2,
        0,
    ]
    t = ui.stage_times(TICKS, TICK)
    factors = np.repeat(1 + parameter_drift * np.sin(pace * t + phase)[:, None], 3, axis=1)
    return ui.plant(ui.d1(t)[:, None], ui.X0[None], TICK, factors)


@cache
def noise(seed):
    """The noise of one run [samples, 1, 2] before scaling: addressed by sample, so more of it is the same and more."""
    draw = jax.jit(rng.measurement_noise, static_argnums=(2, 3))
    return np.asarray(draw(0, seed, TICKS + 1, 2)).T[:, None]


def samples(x, te, d, noise_std, seed):
    return ui.samples_of(x, te, d, noise_std * noise(seed))


def with_input(xhat, fhat):
    """What an observer estimates, [N+1, 5], from xhat and the lumped input found."""
    return np.column_stack([xhat[:, 0], fhat[:, 0] + ui.DELTA * np.sin(xhat[:, 0, 0])])


@cache
def referenced(name, measurement, drift, cases):
    """xd and fhat of the reference, [N+1, cases, ...]; cases are (te, d, noise_std, seed), and runs are done all at once."""
    arrivals = [ui.deliver(samples(arm(drift, seed), te, d, std, seed), TICKS, te, d) for te, d, std, seed in cases]
    return ui.sampled(FINDERS[name], np.concatenate(arrivals, axis=1), TICK, measurement)


def finders_agree(got, option, drift, cases, i):
    """Compare one run with case i."""
    _, d, _, seed = cases[i]
    np.testing.assert_allclose(got.x[:, :4], arm(drift, seed)[:, 0], rtol=0, atol=1e-10)
    for name in FINDERS:
        xd, fhat = (part[:, [i]] for part in referenced(name, option.get("measurement", "predict"), drift, cases))
        want = with_input(ui.to_now(xd, fhat, d * TICK, option.get("reconstruct", False)), fhat)
        np.testing.assert_allclose(got.estimates[name], want, rtol=0, atol=1e-10, err_msg=name)


def filter_agrees(got, x, te, d, noise_std, seed):
    y = samples(x, te, d, noise_std, seed)
    want = with_input(*ui.kf(y, TICKS, te, d, TICK, noise_std**2 or 1e-12))
    np.testing.assert_allclose(got.estimates["kf"], want, rtol=0, atol=1e-10)


CASES = tuple((te, d, 3e-3 * (i % 3), i) for i, (te, d) in enumerate(TIMES))  # every third without noise


@pytest.mark.ci
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("i", range(len(CASES)), ids=lambda i: "{} {} {:g}".format(*CASES[i]))
def test_smo_and_pio_equal_the_reference(i, variant):
    te, d, std, seed = CASES[i]
    got = record(plan_cell(te, d, VARIANTS[variant], noise_std=(std,) * 2), seed)
    np.testing.assert_array_equal(got.x[:, 4], ui.d1(np.arange(TICKS + 1) * TICK))
    finders_agree(got, VARIANTS[variant], 0.0, CASES, i)


@pytest.mark.ci
@pytest.mark.parametrize("case", [(1, 40, 3e-3, 5), (20, 0, 0.0, 0), (7, 13, 1e-3, 1), (30, 400, 0.1, 2)], ids=str)
def test_kf_with_the_input_as_a_random_walk_equals_the_reference(case):
    te, d, std, seed = case
    filter_agrees(record(plan_cell(te, d, noise_std=(std,) * 2), seed), arm(), te, d, std, seed)


@pytest.mark.ci
@pytest.mark.parametrize("seed", [3, 4])
def test_a_drifting_arm_is_the_references_and_all_observers_see_its_samples(seed):
    """One factor on k/J, M g l/J and F/J; its pace and phase are of the run's own."""
    got = record(plan_cell(20, 40, parameter_drift=0.05, noise_std=(1e-3, 1e-3)), seed)
    assert np.abs(arm(0.05, 3) - arm(0.05, 4)).max() > 1e-3
    assert np.abs(arm(0.05, seed) - arm()).max() > 1e-3
    finders_agree(got, {}, 0.05, ((20, 40, 1e-3, seed),), 0)
    filter_agrees(got, arm(0.05, seed), 20, 40, 1e-3, seed)


@pytest.mark.nightly
def test_runs_that_drift_are_their_traces():
    """Each lane has its own drift and noise: what the tables say of a seed is what its trace shows. Compiles for 15 s."""
    p = plan_cell(20, 40, parameter_drift=0.05, noise_std=(1e-3, 1e-3))
    (fitted,) = padding.fit([p])
    (done,) = run_local.execute(Study(name="parameter_drift", scenarios=["arm/sampled"]), [fitted], np.array([3, 0, 4]))
    for column, seed in enumerate([3, 0, 4]):
        got = record(p, seed)
        for name in OBSERVERS:
            e = (got.x - got.estimates[name])[TICKS // 2 : -1]
            np.testing.assert_allclose(done.results[name]["steady_rmse"][:, column], np.sqrt((e**2).mean(0)), rtol=1e-9)


def test_without_drift_a_run_is_undisturbed_whatever_its_seed():
    one, other = (record(plan_cell(20, 40), seed).x for seed in (3, 4))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one[:, :4], arm()[:, 0], rtol=0, atol=1e-10)


# ---------------------------------------------------------------- perfect start

START = (0.3, -0.7, 0.5, 1.1)


def perfect(te, d, option=None, x0=START, xi=0.0, **changes):
    """No weight, nobody pushes, a true start; PIO without its sign, which would chatter about zero (see below)."""
    linear = {"model": {"M": 0.0}, "unknown_input": "zero", "x0": x0, "xhat0": x0, "input": "sine"}
    p = plan_cell(te, d, option, {"kf": {"R": 1e-6}}, **linear | changes)
    pio = p.problem.gains["pio"]
    gains = p.problem.gains | {"pio": pio._replace(law=pio.law._replace(xi=np.asarray(xi)))}
    return p._replace(problem=p.problem._replace(gains=gains))


def error(got, name):
    return np.abs(got.x - got.estimates[name]).max()


@pytest.mark.ci
@example(te=1, d=123, x0=(0.0, -1.507, 1.539, 0.279), signal="sawtooth", carry=False)
@settings(max_examples=8, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    te=st.integers(1, 400),
    d=st.integers(0, 400),
    x0=st.tuples(*[st.floats(-2, 2)] * 4),
    signal=st.sampled_from([name for name in SIGNALS if not name.startswith(("arm", "heater"))]),
    carry=st.booleans(),
)
def test_perfect_start_is_zero_for_any_period_delay_start_and_known_input(te, d, x0, signal, carry):
    got = record(perfect(te, d, {"reconstruct": carry}, x0, input=signal))
    steeper = {"kf": max(1, 20 / te)}  # rounding of a sample reads as a push of that over the interval between two
    for name in OBSERVERS:
        assert error(got, name) < 1e-12 * steeper.get(name, 1) * max(np.abs(got.x).max(), 1), name


@pytest.mark.parametrize(("te", "d"), [(1, 0), (40, 60)])
def test_from_a_perfect_start_pio_chatters_no_further_than_one_tick_takes_it(te, d):
    """sgn of a rounding error is 1: w moves by xi h a tick, the state by xi h^2, and is turned back."""
    got = record(perfect(te, d, xi=2.0))
    e = np.abs(got.x - got.estimates["pio"]).max(0)
    assert 1e-9 < e[:4].max() < 2 * TICK**2
    assert 1e-6 < e[4] < 2 * TICK


def test_held_samples_bring_an_error_of_first_order_in_their_age():
    """`hold` says e_y = Y - C xd with Y up to a period old: half a tick at best, and twice the error at twice the period."""
    runs = {te: record(perfect(te, 0, VARIANTS["hold"])) for te in (1, 20, 40, 80)}
    for name in FINDERS:
        one, *rest = (np.abs(got.x - got.estimates[name])[:, 1].max() for got in runs.values())
        assert 1e-4 < one < 1e-3
        assert rest[0] > 5e-3
        assert all(1.8 < b / a < 2.2 for a, b in pairwise(rest))


def lagging(p, by):
    changed = {name: p.problem.gains[name]._replace(lag=p.problem.gains[name].lag + by) for name in FINDERS}
    return p._replace(problem=p.problem._replace(gains=p.problem.gains | changed))


@pytest.mark.parametrize("slip", [-1, 1])
def test_one_tick_of_slip_in_the_age_is_caught(slip):
    p = perfect(40, 60)
    late = p.problem._replace(schedule=p.problem.schedule._replace(timestamp=p.problem.schedule.timestamp - slip))
    assert error(record(p._replace(problem=late)), "kf") > 1e-4
    got = record(lagging(p, slip))
    assert all(error(got, name) > 1e-4 for name in FINDERS)


def test_delivering_the_neighbouring_packet_is_caught():
    p = perfect(40, 60)
    plan = p.problem.schedule
    wrong = plan._replace(arrive=np.where(plan.arrive > 0, plan.arrive - 1, plan.arrive))
    got = record(p._replace(problem=p.problem._replace(schedule=wrong)))
    assert all(error(got, name) > 1e-4 for name in OBSERVERS)


# ---------------------------------------------------------------- numbers worked out beforehand


@pytest.mark.nightly
def test_the_worked_sampled_errors_come_out():
    """Root mean squares of the x2 error over 6 .. 10 s: SMO and PIO, printed to two or three digits."""
    raw = {"name": "page", "scenarios": ["arm/sampled"], "seeds": 1}
    names = [f"{o}{way}" for o in FINDERS for way in ("", "-hold", "-reconstruct")]
    axes = {"sampling_period": [0.01, 0.02, 0.2], "delay": [0.0, 0.02], "noise_std": [0.0]}
    runs = pcbench.run(raw, observers=names, axes=axes).runs.set_index(
        ["sampling_period", "delay", "observer", "signal"]
    )
    printed = {
        (0.01, 0.0, "hold"): (".0168", ".0170"),
        (0.01, 0.0, ""): (".0025", ".0012"),
        (0.2, 0.0, "hold"): (".331", ".318"),
        (0.2, 0.0, ""): (".026", ".026"),
        (0.02, 0.02, ""): (".0078", ".0066"),
        (0.02, 0.02, "reconstruct"): (".0044", ".0026"),
    }
    for (te, d, way), texts in printed.items():
        for name, text in zip(FINDERS, texts, strict=True):
            value = runs.loc[(te, d, f"{name}-{way}".rstrip("-"), "link_velocity")].steady_rmse
            unit = 10.0 ** -len(text.partition(".")[2])
            assert abs(value - float(text)) <= max(0.01 * float(text), 0.5 * unit), (te, d, way, name, value)


@pytest.mark.nightly
def test_the_worked_error_of_kf_comes_out():
    rows = pcbench.run("arm/sampled", observers=["kf"], seeds=64).stats.query("signal == 'link_velocity'")
    assert rows.set_index("metric")["mean"]["steady_rmse"] == pytest.approx(0.00258, rel=0.02)
