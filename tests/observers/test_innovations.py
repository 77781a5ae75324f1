"""What filters believe of their error and expect of a sample: the joint normal of all samples says the same.

Plant and schedules are those of `test_late_samples`; on the arm the extended filter is held against an independent one.
"""

import driven
import numpy as np
import pytest
from harness import inputs, starts
from reference import ekf as extended
from reference import surprise
from test_ekf import arm
from test_late_samples import CASE, KNOWN, MODEL, TICKS, TIMES, H, R, W, plant

from pcbench import planning
from pcbench.observers import OBSERVERS
from pcbench.scenarios import SCENARIOS
from pcbench.study.grid import cell_of

SAYS = {name: e for name, e in OBSERVERS.items() if e.observer.innovation}
SILENT = (
    "kf-larsen",
    "kf-alexander",
    "kf-delayed-horizon",
    "ekf-delay",
    "mmae-delay",
)  # have a covariance, but no innovations that are independent, or of one delay, or none


def run_observer(name, schedule, samples=None, **options):
    samples = plant(schedule)[1] if samples is None else samples
    there = driven.traffic(TIMES[schedule], samples, TICKS, 2)
    return driven.whole(name, KNOWN, options, there, inputs(CASE), starts(CASE)[1])


def want(samples, every=False):
    return surprise.surprises(MODEL, inputs(CASE), samples, starts(CASE)[1], KNOWN.P0, R, W, every)


def same(a, b):
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * np.abs(b).max())


def test_who_has_a_covariance_says_what_it_expects_but_for_five():
    able = {name for name, e in OBSERVERS.items() if e.observer.covariance}
    assert able == {*SAYS, *SILENT}


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["now", "one step", "late", "wild"])
@pytest.mark.parametrize("name", ["kf", "ekf", "kf-reprocess"])
def test_every_sample_is_compared_with_all_that_arrived_before(name, schedule):
    options = {"keep": 9} if name == "kf-reprocess" else {}
    got, expected = run_observer(name, schedule, **options)[2], want(plant(schedule)[1], every=True)
    same(got, expected)
    assert expected[:, 1].sum() == len(plant(schedule)[1])


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["late", "wild"])
def test_who_corrects_all_copies_expects_rightly_of_those_out_of_order_too(schedule):
    expected = want(plant(schedule)[1], every=True)
    same(run_observer("kf-cloning", schedule)[2], expected)
    assert expected[:, 1].sum() == len(plant(schedule)[1])


@pytest.mark.ci
def test_what_is_discarded_is_not_judged():
    kept = [s for s in plant("wild")[1] if s.arrival - s.taken <= 12]
    same(run_observer("kf-drop-delayed", "wild", max_age=12 * H)[2], want(kept, every=True))


@pytest.mark.ci
@pytest.mark.parametrize("name", ["oosm-a1", "oosm-b1", "oosm-lag"])
def test_retrodiction_compares_every_sample_that_it_uses(name):
    same(run_observer(name, "now")[2], want(plant("now")[1]))
    got, in_order, every = run_observer(name, "wild")[2], want(plant("wild")[1]), want(plant("wild")[1], every=True)
    assert in_order[:, 1].sum() < got[:, 1].sum() <= every[:, 1].sum()
    assert (got[:, 1] >= in_order[:, 1]).all()


@pytest.mark.ci
@pytest.mark.parametrize("name", ["oosm-a1", "oosm-lag"])
def test_retrodiction_over_one_step_expects_what_all_before_say(name):
    same(run_observer(name, "one step")[2], want(plant("one step")[1], every=True))


def test_who_takes_late_for_now_expects_what_the_optimum_would_if_it_were():
    late = plant("late")[1]
    once = {(s.arrival, s.channel): s._replace(taken=s.arrival) for s in late}
    assert len(once) == len(late)
    same(run_observer("kf-ignore-delay", "late")[2], want(sorted(once.values())))


def test_shifting_expects_the_output_of_its_estimate_of_now_less_the_inputs_response():
    """Its samples stand for ones of now whose value is higher by what the input's response has moved the output since."""
    model, u, moved = surprise.Plant(MODEL, inputs(CASE), W), inputs(CASE), [np.zeros(3)]
    for k in range(TICKS):
        moved.append(model.F @ moved[k] + model.G @ u[k])

    def shifted(s):
        return s._replace(taken=s.arrival, value=s.value + MODEL.C[s.channel] @ (moved[s.arrival] - moved[s.taken]))

    same(run_observer("kf-shifted-innovation", "late")[2], want(sorted(map(shifted, plant("late")[1]))))


@pytest.mark.ci
@pytest.mark.parametrize("schedule", TIMES)
def test_on_a_linear_model_the_extended_filter_believes_what_kalmans_does(schedule):
    xhat, P, _ = run_observer("ekf", schedule)
    best, true, _ = run_observer("kf", schedule)
    same(xhat, best)
    same(P, true)


@pytest.mark.ci
def test_on_the_arm_the_extended_filter_believes_and_expects_what_the_reference_does():
    s = SCENARIOS["arm/sampled"].with_fields(duration=0.07, steady_start=0.03, noise_std=(1e-3, 2e-3))
    known, N = planning.context_of(cell_of(s)), 70
    u, rng = np.random.default_rng(3).normal(size=(N + 1, 1)) * 4, np.random.default_rng(4)
    times = [(taken, taken + 12) for taken in range(0, N - 12, 9)]
    samples = [(t, a, rng.normal(size=2)) for t, a in times]
    there = driven.Traffic(
        np.zeros((N + 1, 2), bool), np.full((N + 1, 1), -1), np.ones((N + 1, 1, 2), bool), np.zeros((N + 1, 1, 2))
    )
    for taken, arrival, y in samples:
        there.taken[taken], there.when[arrival], there.value[arrival, 0] = True, taken, y
    got = driven.whole("ekf", known._replace(ticks=N), {}, there, u, np.array(s.belief.xhat0))
    Q = np.diag([0, 0, 0, 0, s.dt])
    expected = extended.filter_by_arrival(
        arm, s.dt, [*s.belief.xhat0, 0.0], np.eye(5), Q, np.diag([1e-6, 4e-6]), np.eye(2, 5, 1), u,
        {a: [(t, y)] for t, a, y in samples},
    )  # fmt: skip
    for a, b in zip((got[0], got[1], got[2][:, 0]), expected, strict=True):
        same(a, b)
