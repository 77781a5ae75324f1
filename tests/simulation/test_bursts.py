"""Losses that come in bursts, and delays of a histogram or a gamma distribution: their shares, their lengths, their limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from honest import STUDY
from scipy import stats

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.moments import realisations
from pcbench.simulation.schedule import random_times, sampling
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")
PLAIN = STUDY | {"observers": ["kf"], "options": {}}
MANY, RUNS = 2000, 16


def arrivals(clock):
    """(taken, arrives) [MANY, RUNS] of one clock that samples at every tick."""
    t = jax.tree.map(jnp.asarray, random_times.clock_params([clock], MANY - 1, 1, 0))
    return [np.asarray(a) for a in random_times.clock_times(t, 0, jnp.asarray(0), jnp.arange(RUNS))]


def gaps(lost):
    """The lengths of the gaps of every run, those at its ends left out."""
    padded = np.pad(lost.T.astype(int), [(0, 0), (1, 1)])
    begins, ends = (np.argwhere(np.diff(padded, axis=1) == sign) for sign in (1, -1))
    whole = (begins[:, 1] > 0) & (ends[:, 1] < lost.shape[0])
    return (ends[:, 1] - begins[:, 1])[whole]


@pytest.mark.ci
@pytest.mark.parametrize(("loss", "burst"), [(0.2, 5.0), (0.5, 2.5), (0.1, 20.0)])
def test_as_many_are_lost_as_without_and_so_many_in_a_row(loss, burst):
    """Gaps are geometric: the mean within four of its errors; the share within four, where 2 burst samples are one."""
    lost = arrivals(Clock((0,), 1, 3, loss=loss, burst=burst))[1] == NEVER
    found = gaps(lost)
    assert abs(found.mean() - burst) < 4 * np.sqrt(burst * (burst - 1) / found.size)
    assert abs(lost.mean() - loss) < 4 * np.sqrt(loss * (1 - loss) * 2 * burst / lost.size)


@pytest.mark.ci
def test_the_burst_that_losses_of_their_own_leave_is_those_losses():
    alone, told = (arrivals(Clock((0,), 1, 3, loss=0.3, burst=burst))[1] for burst in (0.0, 1 / 0.7))
    np.testing.assert_array_equal(alone, told)


@pytest.mark.ci
def test_a_histogram_has_its_shares_and_each_delay_is_by_itself():
    clock = Clock((0,), 1, 3, delay_values=(0, 7, 2), delay_weights=(0.5, 0.2, 0.3))
    taken, arrives = arrivals(clock)
    late = arrives - taken - 3
    shares = [(late == step).mean() for step in clock.delay_values]
    np.testing.assert_allclose(shares, clock.delay_weights, rtol=0, atol=4 * 0.5 / np.sqrt(late.size))
    again = ((late[1:] == 7) & (late[:-1] == 7)).mean()
    assert abs(again - 0.2**2) < 4 * np.sqrt(0.04 / late.size)


@pytest.mark.ci
@pytest.mark.parametrize(("mean", "shape"), [(12.0, 1.0), (40.0, 4.0), (3.0, 0.5)])
def test_a_gamma_distribution_is_in_whole_ticks_as_scipy_has_it(mean, shape):
    share = np.array(sampling.gamma(mean, shape))
    law = stats.gamma(shape, scale=mean / shape)
    ticks = np.arange(len(share) - 1)
    np.testing.assert_allclose(share[:-1], law.cdf(ticks + 0.5) - law.cdf(ticks - 0.5), rtol=0, atol=1e-12)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    assert law.sf(len(share) - 1.5) < 2e-4 < law.sf(0.9 * len(share) - 2)
    taken, arrives = arrivals(Clock((0,), 1, 3, delay_values=tuple(range(len(share))), delay_weights=tuple(share)))
    late = (arrives - taken - 3).ravel()
    assert late.mean() == pytest.approx(mean, abs=4 * mean / np.sqrt(shape * late.size) + 0.05)


def test_a_study_says_them_in_seconds_and_designers_know_the_mean():
    (cell,) = parse.grid_of(
        PLAIN | {"lti": PLAIN["lti"] | {"delay_gamma_mean": 0.4, "delay_gamma_shape": 2.0}}, {}, []
    ).cells
    (clock,) = cell.times.clocks
    np.testing.assert_allclose(clock.delay_weights, sampling.gamma(4.0, 2.0), rtol=1e-12)
    assert (clock.delay_values, clock.mean_extra_delay) == (tuple(range(len(clock.delay_weights))), 4)
    told = {"delay_values": [0.0, 0.3], "delay_weights": [3.0, 1.0]}
    (cell,) = parse.grid_of(PLAIN | {"lti": PLAIN["lti"] | told}, {}, []).cells
    assert (cell.times.clocks[0].delay_weights, cell.times.clocks[0].delay_values) == ((0.75, 0.25), (0, 3))


def test_losses_in_a_row_have_no_recursion():
    """Their exact numbers are averaged over drawn schedules; of losses that come one by one they move over both cases."""
    for given, alone in (({"loss": 0.3}, True), ({"loss": 0.3, "mean_burst_length": 4.0}, False)):
        (p,) = planning.plan(parse.parse(PLAIN | {"lti": PLAIN["lti"] | given}, "bursts"))
        assert realisations.only_losses_random(p) is alone


@pytest.mark.nightly
@pytest.mark.parametrize(
    "given",
    [
        {"loss": 0.3, "mean_burst_length": 4.0},
        {"delay_gamma_mean": 0.4},
        {"delay_values": [0.0, 0.9], "delay_weights": [0.8, 0.2]},
    ],
    ids=["mean_burst_length", "gamma", "histogram"],
)
def test_exact_answers_are_averaged_over_drawn_schedules_and_runs_come_to_them(given):
    """Both have errors of their own: within four of the two together. Two delays are few enough modes for no average."""
    study = PLAIN | {"lti": PLAIN["lti"] | given}
    keys = "metric == 'steady_mse' and signal == 'a'"
    exact = pcbench.exact_moments(study, schedules=64).stats.query(keys).iloc[0]
    runs = pcbench.run(study, seeds=2048).stats.query(keys).iloc[0]
    assert (exact.method, exact.n) == ("exact", 0 if "delay_values" in given else 64)
    assert abs(exact["mean"] - runs["mean"]) < 4 * np.hypot(exact.se, runs.se)


REFUSED = [
    ({"mean_burst_length": 5.0}, "with a loss of 0, expected a loss between 0 and 1; write one"),
    ({"mean_burst_length": 5.0, "loss": 1.0}, "with a loss of 1, expected a loss between 0 and 1"),
    ({"mean_burst_length": 2.0, "loss": 0.8}, "expected at least 4 samples, the shortest mean length"),
    ({"mean_burst_length": 0.5, "loss": 0.2}, "expected at least 1 samples"),
    ({"mean_burst_length": -1.0, "loss": 0.2}, "expected a number of at least 0"),
    ({"delay_weights": [0.5, 0.5]}, "got 2 values of delay_weights for 0 delay_values"),
    ({"delay_values": [0.0, 0.1], "delay_weights": [1.0, 0.0]}, "expected weights greater than 0"),
    ({"delay_values": [0.0, 0.1], "delay_weights": [0.0, 0.0]}, "expected weights greater than 0"),
    (
        {"delay_values": [0.0, 0.1], "delay_weights": [0.5, 0.5], "delay_self_transition": 0.5},
        "got delay_weights and delay_self_transition",
    ),
    ({"delay_values": [0.0, 0.1], "delay_gamma_mean": 0.1}, "and delay_values, expected one of them"),
    ({"delay_gamma_shape": 2.0}, "with a delay_gamma_mean of 0, so it has no effect"),
    ({"delay_gamma_mean": 0.1, "delay_gamma_shape": 0.0}, "expected a shape greater than 0"),
    ({"delay_gamma_mean": float("nan")}, "finite number"),
]


@pytest.mark.parametrize(("given", "sentence"), REFUSED, ids=str)
def test_what_cannot_be_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(PLAIN | {"lti": PLAIN["lti"] | given}, seeds=1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("axes", [{"delay_gamma_mean": [0.1]}, {"loss": [0.2]}], ids=str)
def test_who_works_with_constant_delays_alone_says_so_of_a_gamma_distribution(axes):
    with pytest.raises(UserError, match="got delay_gamma_mean, expected one constant delay"):
        pcbench.run("cart/white", observers=["kfbo"], axes={"delay_gamma_mean": [0.1]} | axes, seeds=1)
