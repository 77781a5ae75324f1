"""Shortcuts for late samples: each is what its source says, equals an independent reference, and believes what is true or not.

The plant has three states, two inputs, two outputs and process noise; inputs differ at every tick. Four schedules with two
clocks: nothing late; one sample late by less than a step; two clocks with late samples; and all of it late, lost or out
of sequence. Tolerances are rounding: 1e-10 of the signal's size, as everywhere.
"""

import re
from functools import cache

import driven
import numpy as np
import pytest
from documents import PAGES
from harness import ODD, Case, context_of, inputs, starts
from reference import irregular, late
from reference.linear import Model, discretise, process_noise

import pcbench
from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers import LATE, OBSERVERS
from pcbench.statistics.consistency import Band, verdict

TICKS, H = 150, 0.02
CASE = Case(ODD, 12, 0, ticks=TICKS, h=H, noise_std=0.2, seed=5, xhat0=[0.5, -1.0, 2.0], input_intensity=0.4)
MODEL = Model(ODD.A, ODD.B, ODD.C, H)
W = CASE.input_intensity * ODD.B @ ODD.B.T
R = np.array([0.04, 0.04])
EQUAL = ("kf-reprocess", "kf-cloning")


def _wild():
    """Periods 9 and 13, ages from 0 to 40, every fifth sample lost."""
    rng = np.random.default_rng(11)
    return [
        [(t, None if rng.random() < 0.2 else t + int(rng.integers(0, 41))) for t in range(0, TICKS + 1, every)]
        for every in (9, 13)
    ]


TIMES = {
    "now": [[(t, t) for t in range(0, TICKS + 1, 12)], [(t, t) for t in range(0, TICKS + 1, 17)]],
    "one step": [[(t, t) for t in range(0, TICKS + 1, 12)], [(t, t + 8) for t in range(7, TICKS + 1, 36)]],
    "late": [[(t, t + 30) for t in range(0, TICKS + 1, 12)], [(t, t + 5) for t in range(0, TICKS + 1, 17)]],
    "wild": _wild(),
}
KNOWN = context_of(CASE)._replace(oosm_lag=9, flight=9, latest=40, period=(12, 17), delay=(20, 20))


@cache
def plant(schedule, noise=True, model=MODEL):
    """The state [N+1, n], and the samples that arrive."""
    rng = np.random.default_rng(3)
    v = [rng.normal(size=TICKS + 1) * np.sqrt(R[j]) * noise for j in range(2)]
    return irregular.simulate(model, inputs(CASE), starts(CASE)[0], TIMES[schedule], v)


@cache
def found(name, schedule, **options):
    samples = plant(schedule)[1]
    there = driven.traffic(TIMES[schedule], samples, TICKS, 2)
    return driven.run(name, KNOWN, options, there, inputs(CASE), starts(CASE)[1])


@cache
def optimum(schedule):
    return irregular.kf(MODEL, inputs(CASE), plant(schedule)[1], starts(CASE)[1], KNOWN.P0, R, W)


def reference_arguments(schedule):
    return MODEL, inputs(CASE), plant(schedule)[1]


def same(a, b):
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * np.abs(b).max())


def apart(a, b):
    return np.abs(a - b).max() > 1e-4 * np.abs(b).max()


@pytest.mark.ci
@pytest.mark.parametrize("schedule", TIMES)
@pytest.mark.parametrize("name", EQUAL)
def test_going_back_and_cloning_are_the_optimum_whatever_is_late_lost_or_out_of_sequence(name, schedule):
    options = {"keep": 9} if name == "kf-reprocess" else {}
    xhat, P = found(name, schedule, **options)
    same(xhat, optimum(schedule))
    same(P, found("kf", schedule)[1])


@pytest.mark.ci
@pytest.mark.parametrize("name", LATE)
def test_where_nothing_is_late_all_are_the_optimum(name):
    options = {"lag": 0.0} if name == "kf-delayed-horizon" else {"keep": 9} if name == "kf-reprocess" else {}
    if name == "kf-shifted-innovation":  # it takes the plant for an integrator, but there is nothing to shift
        same(found(name, "now")[0], optimum("now"))
        return
    xhat, P = found(name, "now", **options)
    same(xhat, optimum("now"))
    same(P, found("kf", "now")[1])


@pytest.mark.parametrize("schedule", ["late", "wild"])
@pytest.mark.parametrize("name", ["kf-ignore-delay", "kf-shifted-innovation"])
def test_taking_late_for_now_equals_the_reference(name, schedule):
    want = late.as_of_now(
        *reference_arguments(schedule), starts(CASE)[1], KNOWN.P0, R, W, name == "kf-shifted-innovation"
    )
    for a, b in zip(found(name, schedule), want, strict=True):
        same(a, b)
    assert apart(want[0], optimum(schedule))


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["late", "wild"])
def test_discarding_is_the_optimum_of_what_is_kept(schedule):
    kept = [s for s in plant(schedule)[1] if s.arrival - s.taken <= 12]
    want = irregular.kf(MODEL, inputs(CASE), kept, starts(CASE)[1], KNOWN.P0, R, W)
    same(found("kf-drop-delayed", schedule, max_age=12 * H)[0], want)
    assert 0 < len(kept) < len(plant(schedule)[1])


@pytest.mark.ci
def test_between_the_samples_that_it_keeps_discarding_believes_what_the_model_alone_would():
    """P+ = F P F' + Q from tick to tick, but where one that is kept arrives; and there it is kf of those alone."""
    P = found("kf-drop-delayed", "wild", max_age=12 * H)[1]
    kept = [s for s in plant("wild")[1] if s.arrival - s.taken <= 12]
    there = driven.traffic(TIMES["wild"], kept, TICKS, 2)
    same(P, driven.run("kf", KNOWN, {}, there, inputs(CASE), starts(CASE)[1])[1])
    F, Q = discretise(ODD.A, ODD.B, H)[0], process_noise(ODD.A, W, H)
    alone = [k for k in range(1, TICKS + 1) if k not in {s.arrival for s in kept}]
    assert len(alone) > 100
    same(P[alone], F @ P[np.array(alone) - 1] @ F.T + Q)


@pytest.mark.ci
def test_taking_late_for_now_is_biased_by_the_motion_over_the_delay():
    """Of what moves evenly: behind by speed times delay, once it has forgotten its start."""
    moving = linear.Model(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)))
    speed, late = 0.7, 15
    case = Case(moving, 5, late, ticks=TICKS, h=H, noise_std=0.1, x0=[1.0], u=np.full((TICKS + 1, 1), speed))
    known = context_of(case)._replace(process_std=(0.5,))
    times = [[(t, t + late) for t in range(0, TICKS + 1, 5)]]
    model = Model(moving.A, moving.B, moving.C, H)
    x, samples = irregular.simulate(model, inputs(case), np.ones(1), times, [np.zeros(TICKS + 1)])
    there = driven.traffic(times, samples, TICKS, 1)
    e = {
        name: x - driven.run(name, known, {}, there, inputs(case), np.zeros(1))[0] for name in ("kf-ignore-delay", "kf")
    }
    np.testing.assert_allclose(e["kf-ignore-delay"][-5:], speed * late * H, rtol=1e-6)
    assert np.abs(e["kf"][-5:]).max() < 1e-6


ON_TIME = [
    name for name in LATE if name not in ("kf-ignore-delay", "kf-shifted-innovation")
]  # these two use a sample at another time than its own


@pytest.mark.ci
@pytest.mark.parametrize("name", ON_TIME)
def test_from_a_perfect_start_there_is_no_error_whatever_is_late_lost_or_out_of_sequence(name):
    x, samples = plant("wild", noise=False)
    there = driven.traffic(TIMES["wild"], samples, TICKS, 2)
    xhat, _ = driven.run(name, KNOWN, {}, there, inputs(CASE), starts(CASE)[0])
    assert np.abs(xhat - x).max() < 1e-12 * np.abs(x).max()
    earlier = [[(max(t - 1, 0), arrival) for t, arrival in time] for time in TIMES["wild"]]
    slipped = driven.traffic(earlier, [s._replace(taken=max(s.taken - 1, 0)) for s in samples], TICKS, 2)
    xhat, _ = driven.run(name, KNOWN, {}, slipped, inputs(CASE), starts(CASE)[0])
    assert np.abs(xhat - x).max() > 1e-4 * np.abs(x).max(), "a tick of slip is seen"


@pytest.mark.parametrize(("schedule", "horizon"), [("late", 30), ("wild", 40), ("wild", 25)])
def test_a_horizon_is_the_optimum_of_samples_that_all_arrive_so_late(schedule, horizon):
    """Not, where they come sooner, that of those as they come: the finding."""
    kept = [s for s in plant(schedule)[1] if s.arrival - s.taken <= horizon]
    held = [s._replace(arrival=s.taken + horizon) for s in kept if s.taken + horizon <= TICKS]
    want = irregular.kf(MODEL, inputs(CASE), held, starts(CASE)[1], KNOWN.P0, R, W)
    same(found("kf-delayed-horizon", schedule, lag=horizon * H)[0], want)
    assert apart(want, optimum(schedule))


@pytest.mark.parametrize("schedule", ["one step", "wild"])
def test_larsens_gain_is_the_best_for_its_innovation_and_its_covariance_true(schedule):
    want = late.larsen(*reference_arguments(schedule), starts(CASE)[1], KNOWN.P0, R, W)
    for a, b in zip(found("kf-larsen", schedule), want, strict=True):
        same(a, b)


def test_larsen_is_the_optimum_with_one_sample_on_its_way_and_above_it_with_several():
    quiet = found("kf-larsen", "now")[1], found("kf", "now")[1]
    same(*quiet)
    for schedule in ("late", "wild"):
        excess = np.trace(found("kf-larsen", schedule)[1] - found("kf", schedule)[1], axis1=1, axis2=2)
        assert excess.min() > -1e-9
        assert excess.max() > 1e-3


@pytest.mark.parametrize("schedule", ["one step", "late", "wild"])
def test_alexander_equals_the_reference(schedule):
    want = late.alexander(*reference_arguments(schedule), TIMES[schedule], starts(CASE)[1], KNOWN.P0, R, W)
    for a, b in zip(found("kf-alexander", schedule), want, strict=True):
        same(a, b)


def test_alexander_is_the_optimum_when_nothing_is_on_its_way_and_counts_on_what_is():
    busy = np.zeros(TICKS + 1, bool)
    for taken, arrival in TIMES["one step"][1]:
        busy[taken:arrival] = True
    xhat, best = found("kf-alexander", "one step")[0], optimum("one step")
    same(xhat[~busy], best[~busy])
    assert apart(xhat[busy], best[busy])
    reported, true = (np.trace(found(name, "wild")[1], axis1=1, axis2=2) for name in ("kf-alexander", "kf"))
    assert (reported <= true + 1e-9).all(), "its covariance is that of samples that are neither late nor lost"
    assert (reported < 0.9 * true).any()


RETRODICTED = {
    "oosm-a1": {},
    "oosm-b1": {"zero": True},
    "oosm-lag": {"several": True, "steps": 4},
}


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["one step", "late", "wild"])
@pytest.mark.parametrize("name", RETRODICTED)
def test_retrodiction_equals_the_reference(name, schedule):
    want = late.retrodicted(*reference_arguments(schedule), starts(CASE)[1], KNOWN.P0, R, W, **RETRODICTED[name])
    for a, b in zip(found(name, schedule), want, strict=True):
        same(a, b)


def test_one_step_back_is_exact_by_a1_above_by_b1_and_the_same_by_lag():
    best, P = optimum("one step"), found("kf", "one step")[1]
    a1, b1, lag = (found(name, "one step") for name in RETRODICTED)
    same(a1[0], best)
    same(a1[1], P)
    same(lag[0], best)
    same(lag[1], P)
    assert apart(b1[0], best)
    excess = np.trace(b1[1] - P, axis1=1, axis2=2)
    assert excess.min() > -1e-9
    assert excess.max() > 1e-5


INTEGRATOR = linear.Model(np.zeros((2, 2)), np.array([[1.0, 0.3], [0.2, -1.0]]), np.array([[1.0, 0.5], [0.0, 2.0]]))


@pytest.mark.parametrize("schedule", ["late", "wild"])
def test_shifting_is_the_optimum_of_an_integrator_without_process_noise(schedule):
    case = Case(INTEGRATOR, 12, 0, ticks=TICKS, h=H, noise_std=0.2, xhat0=[0.5, -1.0])
    model, known = Model(INTEGRATOR.A, INTEGRATOR.B, INTEGRATOR.C, H), context_of(case)._replace(oosm_lag=9)
    rng = np.random.default_rng(4)
    v = [rng.normal(size=TICKS + 1) * 0.2 for _ in range(2)]
    _, samples = irregular.simulate(model, inputs(case), starts(case)[0], TIMES[schedule], v)
    want = irregular.kf(model, inputs(case), samples, starts(case)[1], known.P0, R)
    there = driven.traffic(TIMES[schedule], samples, TICKS, 2)
    same(driven.run("kf-shifted-innovation", known, {}, there, inputs(case), starts(case)[1])[0], want)


@pytest.mark.ci
def test_rewinding_loses_what_is_older_than_it_keeps_and_says_so():
    assert apart(found("kf-reprocess", "wild", keep=1)[0], optimum("wild"))
    short = OBSERVERS["kf-reprocess"].design(KNOWN, OBSERVERS["kf-reprocess"].options(keep=1)).certificate
    assert "9 newer ones may arrive before a sample" in short.inequality
    enough = OBSERVERS["kf-reprocess"].design(KNOWN, OBSERVERS["kf-reprocess"].options(keep=9)).certificate
    assert enough.margin < float("inf")


SINGULAR = linear.Model(np.diag([0.5, 0.0]), np.ones((2, 1)), np.eye(2), discrete=True)
REFUSED = [
    ("kf-cloning", KNOWN._replace(flight=17), {}, "up to 17 samples in transit at once, expected at most 16"),
    ("kf-alexander", KNOWN._replace(error=2), {}, "assumed_delay_error of 0.04 s, expected 0"),
    ("kf-delayed-horizon", KNOWN, {"lag": 99.0}, "a lag of 99 s, expected at most the run's 3 s"),
    ("oosm-a1", context_of(Case(SINGULAR, 5, 5, ticks=20)), {}, "discrete model whose A is singular"),
]


@pytest.mark.parametrize(("name", "known", "options", "sentence"), REFUSED, ids=[row[0] for row in REFUSED])
def test_what_cannot_be_is_refused_in_a_sentence(name, known, options, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        OBSERVERS[name].design(known, OBSERVERS[name].options(**options))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "option"),
    [("kf-drop-delayed", "max_age"), ("kf-delayed-horizon", "lag"), ("kf-reprocess", "keep"), ("oosm-lag", "keep")],
)
@pytest.mark.parametrize("value", [-1, float("nan"), float("inf")])
def test_options_that_are_no_times_or_counts_are_refused(name, option, value):
    with pytest.raises(ValueError, match=option):
        OBSERVERS[name].options(**{option: value})


@pytest.mark.nightly
def test_the_guides_table_is_what_comes_out():
    rows = re.findall(r"^\| `([\w-]+)` \| ([\d.]+ \|.*?) \| (\d+) \|$", PAGES["delay_findings.md"], re.M)
    name = "delayed-measurements"
    stats, costs = pcbench.run(name).stats, pcbench.operation_counts(name).set_index(["cell", "observer"])
    stats = stats[stats.signal == "position"].set_index(["observer", "metric", "delay"])
    assert len(rows) == 13
    for name, said, products in rows:
        *errors, consistency = said.split(" | ")
        found = stats.loc[name, "steady_rmse"]["mean"].sort_index()
        np.testing.assert_allclose(found, [float(e) for e in errors], rtol=0.01)
        assert costs.loc[(1, name), "sample"] == int(products)
        if consistency != "no covariance":
            mean, band = stats.loc[(name, "nees", 0.8)], stats.loc[(name, "nees_band", 0.8)]
            assert verdict(mean["mean"], Band(band.ci_low, band.ci_high)) == consistency
