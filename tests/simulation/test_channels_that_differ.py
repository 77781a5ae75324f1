"""Faults of one channel alone: which samples are lost, late or outliers, by each channel's own probability and draws."""

import numpy as np
import pytest
from reference import threefry

import pcbench
from pcbench.errors import UserError
from pcbench.scenarios.scenario import per_channel
from pcbench.simulation.schedule import random_times
from pcbench.study import parse, times

pytestmark = pytest.mark.usefixtures("in_a_hurry")
STUDY = {
    "name": "channels",
    "observers": ["kf"],
    "seeds": 2,
    "lti": {"A": [[0.0, 1.0], [-1.0, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]], "tick": 0.1,
            "sampling_period": 0.5, "delay": 0.3, "noise_std": [0.1, 0.3], "duration": 6.0, "states": ["a", "b"]},
}  # fmt: skip


def having(observers=("kf",), **given):
    return STUDY | {"lti": STUDY["lti"] | given, "observers": list(observers)}


def samples(seed, **given):
    """By channel, (number, tick at which it is taken, tick at which it arrives) of a run's samples."""
    (cell,) = parse.grid_of(having(**given), {}, []).cells
    t = times.times_of(cell.scenario)
    found = random_times.draw_samples(t.clocks, t.ticks, 2, 0, seed)
    return [[(s.number, s.tick, s.arrives) for s in found if s.channel == j] for j in range(2)]


@pytest.mark.ci
@pytest.mark.parametrize("seed", [0, 5])
def test_each_channel_loses_samples_by_its_own_probability(seed):
    for j, (found, loss) in enumerate(zip(samples(seed, loss=[0.2, 0.6]), (0.2, 0.6), strict=True)):
        lost = [threefry.uniform(0, seed, "loss", j, i, 1)[0] < loss for i, _, _ in found]
        assert [arrives == random_times.NEVER for _, _, arrives in found] == lost
        assert 0 < sum(lost) < len(lost)


@pytest.mark.ci
def test_each_channel_is_late_and_early_by_its_own_jitter():
    for j, found in enumerate(samples(3, delay_jitter=[0.4, 0.1], sampling_jitter=[0.0, 0.2])):
        for i, taken, arrives in found:
            _, instant, late = threefry.uniform(0, 3, "jitter", j, i, 3)
            moved = int(instant * 5) - 2 if j and i else 0
            assert (taken, arrives) == (5 * i + moved, 5 * i + moved + 3 + int(late * (2 if j else 5)))


def test_a_gamma_distribution_of_one_channel_leaves_the_other_its_delay():
    steady, late = samples(1, delay_gamma_mean=[0.0, 0.4])
    assert {arrives - taken for _, taken, arrives in steady} == {3}
    assert len({arrives - taken for _, taken, arrives in late}) > 2
    both, _ = samples(1, delay_gamma_mean=[0.4, 0.0])
    assert len({arrives - taken for _, taken, arrives in both}) > 2


@pytest.mark.ci
@pytest.mark.parametrize("given", [{}, {"loss": [0.0, 0.5]}])
def test_outliers_are_those_of_the_channel(given):
    ticks = np.arange(3, 61, 5)
    u = np.array([threefry.uniform(0, 4, "outlier", 1, i, 1)[0] for i in range(len(ticks))])
    chance = float(np.sort(u)[len(u) // 2])  # half of them
    odd = pcbench.simulate(having(outlier_probability=[0.0, chance], outlier_scale=7.0, **given), "kf", seed=4)
    without = pcbench.simulate(having(**given), "kf", seed=4)
    lost = given.get("loss", [0.0, 0.0])[1]
    came = np.array([threefry.uniform(0, 4, "loss", 1, i, 1)[0] >= lost for i in range(len(ticks))])
    w = np.array([threefry.normal(0, 4, "measurement", 1, i) for i in range(len(ticks))])
    apart = (odd["y2"] - without["y2"]).to_numpy()[ticks]
    np.testing.assert_allclose(apart[came], np.where(u < chance, 6.0 * 0.3 * w, 0.0)[came], rtol=0, atol=1e-10)
    np.testing.assert_array_equal(odd["y1"], without["y1"])
    assert (u[came] < chance).any()


@pytest.mark.ci
@pytest.mark.parametrize("engine", ["steps", "definition"])
def test_a_perfect_start_is_zero_whatever_becomes_of_each_channel(engine):
    network = {
        "loss": [0.1, 0.5],
        "delay_jitter": [0.4, 0.0],
        "sampling_jitter": [0.0, 0.2],
        "delay_gamma_mean": [0.0, 0.3],
    }
    study = having(["kf", "ekf"], **network, noise_std=0.0, x0=[1.0, -0.5], xhat0=[1.0, -0.5], prior_std=1.0)
    runs = pcbench.run(study | {"engine": engine, "seeds": 4}).runs
    assert runs.max_abs_error.max() < 1e-12


def test_a_list_of_equal_numbers_is_the_number():
    name = ("sampling_jitter", "delay_jitter", "loss", "outlier_probability")
    one, each = (
        {"sampling_jitter": 0.1, "delay_jitter": 0.2, "loss": 0.1, "outlier_probability": 0.2} for _ in range(2)
    )
    (a,), (b,) = (parse.grid_of(having(**given), {}, []).cells for given in (one, {k: [v, v] for k, v in each.items()}))
    assert a.scenario == b.scenario
    assert all(isinstance(a.scenario.value(n), float) for n in name)
    assert per_channel(0.1, 2) == (0.1, 0.1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"loss": [0.1, 0.2, 0.3]}, r"lti.loss: got 3 values, expected one or 2 \(a value for each output channel\)"),
        ({"loss": [0.1, 1.2]}, "lti.loss: got 1.2, expected a probability from 0 to 1"),
        ({"sampling_jitter": [0.0, 0.3]}, "got a sampling_jitter of 0.3 s with intervals down to 0.5 s"),
        ({"loss": [0.0, 0.4], "mean_burst_length": 0.5}, "mean_burst_length = 0.5 in lti with a loss of 0.4"),
        ({"delay_gamma_mean": [0.1, 90.0]}, "got delay_gamma_mean = 90 s"),
        (
            {"observers": ["pccebo"], "loss": [0.0, 0.3], "delay_jitter": [0.1, 0.1]},
            r"pccebo in lti got channels that differ \(loss = \[0.0, 0.3\]\), expected one period",
        ),
        ({"outlier_scale": [3.0, 4.0]}, "got outlier_scale = .3.0, 4.0. in lti with an outlier_probability of 0"),
    ],
)
def test_a_channel_that_cannot_be_is_one_sentence(given, said):
    with pytest.raises(UserError, match=said) as caught:
        parse.grid_of(having(**given), {}, [])
    assert "\n" not in str(caught.value)
