"""Filters that look for a delay, where ages vary, samples are lost or overtake, and channels have clocks of their own.

The plant and its schedules are those of `test_late_samples`. Stamps say by how much one sample is older than another; what is
looked for is the mean. Tolerances are rounding: 1e-10 of the signal's size, 1e-12 from a perfect start.
"""

import driven
import numpy as np
import pytest
from harness import inputs, starts
from reference import unknown_delay
from reference.linear import process_noise
from test_late_samples import CASE, KNOWN, MODEL, TICKS, TIMES, H, R, W, optimum, plant, same
from test_late_samples import found as of_family
from test_unknown_delay import LATE, STUDY, TICK

import pcbench
from pcbench.errors import UserError

pytestmark = pytest.mark.usefixtures("in_a_hurry")
MEAN = KNOWN.delay[0]  # ticks, the stated delay of the samples
OLDEST = KNOWN.latest - MEAN
Q = process_noise(MODEL.A, W, H)
RIGHT = {"mmae-delay": {"delays": [MEAN * H]}, "ekf-delay": {"delay": MEAN * H, "longest": 0.8}}


def run_observer(name, schedule, options, noise=True, perfect=False):
    start = starts(CASE)[0 if perfect else 1]
    there = driven.traffic(TIMES[schedule], plant(schedule, noise)[1], TICKS, 2)
    return driven.run(name, KNOWN, options, there, inputs(CASE), start)


@pytest.mark.ci
@pytest.mark.parametrize("schedule", TIMES)
def test_a_bank_of_the_right_delay_is_the_optimum_whatever_is_late_lost_or_out_of_sequence(schedule):
    xhat, P = run_observer("mmae-delay", schedule, RIGHT["mmae-delay"])
    same(xhat, optimum(schedule))
    same(P, of_family("kf", schedule)[1])


@pytest.mark.ci
@pytest.mark.parametrize("schedule", ["late", "wild"])
def test_a_bank_is_the_mixture_of_textbook_filters_of_all_samples_in_their_order(schedule):
    delays = [2, 13, 20, 22, 31]
    options = {"delays": [d * H for d in delays], "delay": 0.3, "delay_std": 0.2}
    given = MODEL, inputs(CASE), plant(schedule)[1], starts(CASE)[1], KNOWN.P0, R, Q
    want, P_end = unknown_delay.bank(*given, delays, 0.3, 0.2, MEAN)
    xhat, P = run_observer("mmae-delay", schedule, options)
    same(xhat, want[:, :-1])
    same(P[-1], P_end[:-1, :-1])


@pytest.mark.parametrize("schedule", ["late", "wild"])
def test_the_delay_as_a_state_is_what_the_loops_make_of_samples_of_any_age(schedule):
    options = {"delay": 0.3, "delay_std": 0.1, "longest": 0.8, "delay_walk": 0.001}
    given = MODEL, inputs(CASE), plant(schedule)[1], starts(CASE)[1], KNOWN.P0, R, Q
    want = unknown_delay.ekf_delay(*given, 0.3, 0.1, 40, 0.001 * H, MEAN, OLDEST)
    same(run_observer("ekf-delay", schedule, options)[0], want[:, :-1])


@pytest.mark.ci
@pytest.mark.parametrize("schedule", TIMES)
@pytest.mark.parametrize("name", RIGHT)
def test_from_a_perfect_start_at_the_right_delay_there_is_no_error(name, schedule):
    xhat, _ = run_observer(name, schedule, RIGHT[name], noise=False, perfect=True)
    x = plant(schedule, noise=False)[0]
    assert np.abs(xhat - x).max() < 1e-12 * np.abs(x).max()
    slipped = {"mmae-delay": {"delays": [(MEAN + 1) * H]}, "ekf-delay": {"delay": (MEAN + 1) * H, "longest": 0.8}}
    xhat, _ = run_observer(name, schedule, slipped[name], noise=False, perfect=True)
    assert np.abs(xhat - x).max() > 1e-4 * np.abs(x).max(), "a tick of slip is seen"


SPREAD = 6  # ticks, of a jitter of the delay
VARYING = {"delay_jitter": SPREAD * TICK, "loss": 0.2, "sampling_jitter": TICK, "sampling_period": [4 * TICK, 5 * TICK]}


@pytest.mark.ci
def test_in_a_run_with_jitter_and_losses_the_right_mean_delay_makes_it_the_filter_that_knows_every_age():
    """A constant error of all ages changes nothing, so a bank finds the mean of delays that vary."""
    R, Q = STUDY["options"]["mmae-delay"]["R"], STUDY["options"]["mmae-delay"]["Q"]
    mean = LATE + SPREAD // 2
    lti = STUDY["lti"] | VARYING
    options = {"mmae-delay": {"R": R, "Q": Q, "delays": [mean * TICK]}, "kf": {"R": R, "Q": Q}}
    known = pcbench.simulate(STUDY | {"lti": lti, "observers": ["kf"], "options": options}, "kf", seed=3)
    wrong = {"lti": lti, "observers": ["mmae-delay"], "options": options, "axes": {"assumed_delay_error": [-3 * TICK]}}
    bank = pcbench.simulate(STUDY | wrong, "mmae-delay", seed=3)
    np.testing.assert_allclose(bank[["mmae-delay.a", "mmae-delay.b"]], known[["kf.a", "kf.b"]], rtol=0, atol=1e-10)


@pytest.mark.ci
def test_a_delay_that_is_constant_is_looked_for_alike_whatever_all_ages_are_told_wrong_by():
    """Also where the first samples would be of before t = 0, which no stamp says."""
    given = STUDY | {"observers": ["mmae-delay"]}
    known, wrong = (
        pcbench.simulate(given | {"axes": {"assumed_delay_error": [error]}}, "mmae-delay", seed=2)[
            ["mmae-delay.a", "mmae-delay.b"]
        ]
        for error in (0.0, 5 * TICK)
    )
    np.testing.assert_allclose(wrong, known, rtol=0, atol=1e-12)


@pytest.mark.ci
def test_without_stamps_ages_are_not_read_so_a_sample_is_as_late_as_all():
    """A wrong age changes nothing, and channels of different delays are refused."""
    some = STUDY["options"]["mmae-delay"] | {"stamps": False}
    lti = STUDY["lti"] | {"timestamp_jitter": TICK}  # of each run's own
    given = STUDY | {"observers": ["mmae-delay"], "options": {"mmae-delay": some}}
    right, wrong = (pcbench.simulate(given | each, "mmae-delay", seed=2) for each in ({}, {"lti": lti}))
    np.testing.assert_array_equal(right[["mmae-delay.a", "mmae-delay.b"]], wrong[["mmae-delay.a", "mmae-delay.b"]])
    two = STUDY["lti"] | {"delay": [LATE * TICK, 0.1]}
    with pytest.raises(UserError, match=r"got stamps = false with delays of 0\.35, 0\.1 s, expected one for all"):
        pcbench.run(given | {"lti": two}, seeds=1)
