"""Stamps that are wrong: what a filter makes of them in NumPy, their first-order cost, and what they cannot be."""

import numpy as np
import pytest
from harness import ODD
from honest import STUDY
from reference import irregular, linear, moments, threefry

import pcbench
from pcbench.errors import UserError

pytestmark = pytest.mark.usefixtures("in_a_hurry")
N, TICK, LATE = 60, 0.02, [9, 6]
X0, XHAT0, PRIOR, R = [0.5, -0.2, 0.3], [0.1, 0.1, -0.2], [0.4, 0.3, 0.5], [0.1, 0.05]
WRONG = {"timestamp_offset": -2 * TICK, "clock_skew": -3e4, "timestamp_jitter": 2 * TICK}
ODD_STUDY = {
    "name": "stamped",
    "observers": ["kf"],
    "lti": {
        "A": ODD.A.tolist(), "B": ODD.B.tolist(), "C": ODD.C.tolist(), "x0": X0, "xhat0": XHAT0, "prior_std": PRIOR,
        "tick": TICK, "duration": N * TICK, "steady_start": 0.5, "noise_std": [0.0, 0.0], "sampling_period": [7 * TICK,
        11 * TICK],
        "delay": [late * TICK for late in LATE], "states": ["a", "b", "c"], "input": "sine,sawtooth",
    },
    "options": {"kf": {"R": R}},
}  # fmt: skip


def stamp_study(**given):
    return ODD_STUDY | {"lti": ODD_STUDY["lti"] | given}


def stamp_tick(taken, wrong, seed):
    """The tick that the stamp of a sample says."""
    jitter = round(wrong.get("timestamp_jitter", 0.0) / TICK)
    drawn = int(threefry.uniform(0, seed, "stamp", 0, taken, 1)[0] * (2 * jitter + 1)) - jitter
    off = round(wrong.get("timestamp_offset", 0.0) / TICK) + round(1e-6 * wrong.get("clock_skew", 0.0) * taken)
    return max(taken + off + drawn, 0)


@pytest.mark.parametrize(
    "names",
    [
        list(WRONG),
        *(pytest.param([name], marks=pytest.mark.nightly) for name in WRONG),
    ],
    ids=",".join,
)
def test_a_filter_that_is_told_them_is_the_one_whose_samples_are_of_those_times(names):
    wrong = {name: WRONG[name] for name in names}
    trace = pcbench.simulate(stamp_study(**wrong), "kf", seed=3)
    u, model = trace[["u1", "u2"]].to_numpy(), linear.Model(ODD.A, ODD.B, ODD.C, TICK)
    times = [[(k, k + late) for k in range(0, N + 1, te)] for te, late in zip((7, 11), LATE, strict=True)]
    x, samples = irregular.simulate(model, u, np.array(X0), times)
    samples = [s._replace(taken=stamp_tick(s.taken, wrong, 3)) for s in samples]
    want = irregular.kf(model, u, samples, np.array(XHAT0), np.diag(np.square(PRIOR)), np.array(R))
    np.testing.assert_allclose(trace[["a", "b", "c"]].to_numpy(), x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(trace[["kf.a", "kf.b", "kf.c"]].to_numpy(), want, rtol=0, atol=1e-10)


@pytest.mark.ci
def test_all_else_is_as_without_and_an_offset_is_a_delay_error_that_nobody_assumes():
    plain = pcbench.simulate(stamp_study(), "kf", seed=3)
    wrong = pcbench.simulate(stamp_study(**WRONG), "kf", seed=3)
    np.testing.assert_array_equal(plain[["a", "b", "c", "y1", "y2"]], wrong[["a", "b", "c", "y1", "y2"]])
    older, offset = (
        pcbench.simulate(ODD_STUDY | {"axes": {name: [late]}}, "kf")
        for name, late in (("assumed_delay_error", 0.06), ("timestamp_offset", -0.06))
    )
    np.testing.assert_allclose(older["kf.a"], offset["kf.a"], rtol=0, atol=1e-12)


@pytest.mark.nightly
@pytest.mark.parametrize("wrong", [WRONG, {"timestamp_jitter": 2 * TICK}], ids=["all", "sampling_jitter"])
def test_a_run_among_others_is_the_run_alone(wrong):
    study = stamp_study(**wrong, loss=0.2, delay_jitter=0.1, noise_std=[0.1, 0.1])
    runs = pcbench.run(study, seeds=3).runs.set_index(["seed", "signal"])
    for seed in range(3):
        trace = pcbench.simulate(study, "kf", seed=seed)
        assert runs.loc[(seed, "b"), "final_error"] == pytest.approx((trace["b"] - trace["kf.b"])[N - 1], rel=1e-9)


@pytest.mark.nightly
def test_jitter_costs_what_noise_of_the_signals_slope_costs_to_first_order():
    """A stamp off by d makes a sample wrong by y' d: noise of variance y'^2 s^2, s^2 = J (J + 1) / 3 ticks^2.

    The filter's error is linear in that noise: the reference's covariance of impulses, each of the size y'(t_i) s. What is left
    out is of second order, (y'' s / y')^2, below 1 % here; the mean of 4096 runs is known to 3 %.
    """
    h, jitter, R, prior, start, ticks = 0.01, 3, 0.02, 0.3, STUDY["lti"]["x0"], 600
    own = {k: v for k, v in STUDY["lti"].items() if k != "process_std"}
    own |= {"tick": h, "noise_std": [0.0], "xhat0": start, "prior_std": [prior] * 2, "input": "sine"}
    study = {
        "name": "first",
        "observers": ["kf"],
        "lti": own | {"timestamp_jitter": jitter * h},
        "options": {"kf": {"R": R}},
    }
    found = pcbench.run(study, seeds=4096).stats.query("metric == 'steady_mse'").set_index("signal")["mean"]
    steady = pcbench.simulate(study | {"lti": own}, "kf")
    model = linear.Model(*(np.array(own[each]) for each in "ABC"), h)
    times = [[(k, k + 30) for k in range(0, ticks + 1, 50)]]

    def error_of(u, x0, xhat0, noise):
        x, samples = irregular.simulate(model, u, x0, times, noise)
        return x - irregular.kf(model, u, samples, xhat0, prior**2 * np.eye(2), np.array([R]))

    impulses = moments.error_map(error_of, steady[["u1"]].to_numpy(), np.array(start), np.array(start), [len(times[0])])
    slope = steady["b"].to_numpy()[::50]  # the speed is the position's slope
    P = moments.covariance(impulses, np.abs(slope) * h * np.sqrt(jitter * (jitter + 1) / 3))
    want = np.diagonal(P, axis1=1, axis2=2)[200:ticks].mean(0)
    np.testing.assert_allclose([found["a"], found["b"]], want, rtol=0.05)


REFUSED = [
    (
        {"timestamp_offset": 7 * TICK},
        "got timestamps up to 0.14 s after the sampling in lti, whose shortest delay is 0.12 s",
    ),
    ({"timestamp_jitter": 3 * TICK}, "expected less than half the shortest interval, so that timestamps stay in order"),
    ({"timestamp_jitter": -TICK}, "expected a number of at least 0"),
    ({"timestamp_jitter": 0.013}, "expected a whole number of ticks"),
    ({"clock_skew": float("inf")}, "finite number"),
    ({"clock_skew": -2e5}, "expected at most 100,000"),
    ({"clock_skew": 8000.0}, "moves no timestamp by half a tick"),
]


@pytest.mark.parametrize(("given", "sentence"), REFUSED, ids=str)
def test_what_cannot_be_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(stamp_study(**given), seeds=1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("observer", "scenario"), [("kfbo", "cart/white"), ("chain", "csth/10s-noise")])
def test_who_does_not_use_the_age_of_a_sample_says_so(observer, scenario):
    given = {"clock_skew": [5000.0]}
    with pytest.raises(UserError, match="got clock_skew, expected"):
        pcbench.run(scenario, observers=[observer], axes=given, seeds=1)


def test_who_is_told_when_a_sample_is_taken_says_so():
    with pytest.raises(UserError, match="kf-cloning in lti got timestamp_offset, expected correct timestamps"):
        pcbench.run(stamp_study(timestamp_offset=-TICK) | {"observers": ["kf-cloning"], "options": {}}, seeds=1)


def test_an_axis_of_them_is_refused_where_nothing_is_sampled():
    with pytest.raises(UserError, match=r"got clock_skew = 5\.0 in arm/sine, whose measurements are continuous"):
        pcbench.run("arm/sine", axes={"clock_skew": [5.0]}, seeds=1)


@pytest.mark.nightly
def test_in_a_loop_of_the_paper_an_offset_is_a_delay_error_that_nobody_assumes():
    older, offset = (
        pcbench.run("helicopter/constant", observers=["ekf"], axes={name: [late]}, seeds=1).runs.set_index("signal")
        for name, late in (("assumed_delay_error", 0.01), ("timestamp_offset", -0.01))
    )
    np.testing.assert_allclose(older["rmse"], offset["rmse"], rtol=1e-9)
    assert (older["rmse"] > 1e-4).all()


@pytest.mark.parametrize("axis", ["timestamp_jitter", "delay_gamma_mean"])
def test_a_loop_of_the_paper_is_not_offered_with_times_of_each_runs_own(axis):
    with pytest.raises(
        UserError, match=r"got a random schedule in helicopter/constant, .* expected one schedule for all runs"
    ):
        pcbench.run("helicopter/constant", axes={axis: [0.05]}, seeds=1)
