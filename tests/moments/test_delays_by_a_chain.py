"""Delays that are a Markov chain, or in turn: exact on each schedule, averaged over drawn ones, against impulses in NumPy."""

import numpy as np
import pytest
from harness import ODD
from reference import irregular, linear, moments

import pcbench
from pcbench.errors import UserError
from pcbench.moments import delay_modes
from pcbench.simulation.schedule import random_times
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

N, TICK, TE, LATE, STEPS, STAY, SCHEDULES = 46, 0.02, 7, 3, [0, 16, 5], [0.6, 0.3, 0.5], 4
NOISE, X0, XHAT0, PRIOR = [0.3, 0.2], [0.5, -0.2, 0.3], [0.1, 0.1, -0.2], [0.4, 0.3, 0.5]
R = [0.1, 0.05]
STUDY = {
    "name": "chained",
    "observers": ["kf"],
    "lti": {
        "A": ODD.A.tolist(), "B": ODD.B.tolist(), "C": ODD.C.tolist(), "x0": X0, "xhat0": XHAT0, "prior_std": PRIOR,
        "tick": TICK, "duration": N * TICK, "steady_start": 0.5, "noise_std": NOISE, "sampling_period": TE * TICK,
        "delay": LATE * TICK, "delay_values": [s * TICK for s in STEPS], "delay_self_transition": STAY,
        "states": ["a", "b", "c"], "input": "sine,sawtooth",
    },
    "options": {"kf": {"R": R}},
}  # fmt: skip


def by_impulses(seed, driven):
    """Mean square [3] over ticks 0 .. N-1 of kf's errors on the schedule of one run, and the ages of its samples."""
    clock = Clock((0, 1), TE, LATE, delay_values=tuple(STEPS), delay_self_transition=tuple(STAY))
    drawn = random_times.draw_samples([clock], N, 2, 0, seed)
    times = [[(s.tick, s.arrives if s.arrives <= N else None) for s in drawn if s.channel == j] for j in range(2)]
    ages = {arrives - taken for time in times for taken, arrives in time if arrives is not None}
    return mean_square(times, driven), ages


def mean_square(times, driven):
    """The same on samples (taken, arrives or None) of each channel."""
    model, P0 = linear.Model(ODD.A, ODD.B, ODD.C, TICK), np.diag(np.square(PRIOR))

    def error_of(u, start, xhat0, noise):
        x, samples = irregular.simulate(model, u, start, times, noise)
        return x - irregular.kf(model, u, samples, xhat0, P0, np.array(R))

    counts = [len(time) for time in times]
    found = moments.error_map(error_of, driven, np.array(X0), np.array(XHAT0), counts)
    variance = np.diagonal(moments.covariance(found, np.repeat(NOISE, counts)), axis1=1, axis2=2)
    return np.mean((found.base**2 + variance)[:N], 0)


@pytest.mark.nightly
def test_they_are_the_mean_over_schedules_with_the_error_that_remains(monkeypatch):
    """As they are where there are too many modes for a recursion (`test_modes`)."""
    monkeypatch.setattr(delay_modes, "MOST_MODES", 0)
    stats = pcbench.exact_moments(STUDY, schedules=SCHEDULES).stats.query("metric == 'mse'").set_index("signal")
    driven = pcbench.simulate(STUDY, "model-only")[["u1", "u2"]].to_numpy()
    each, ages = zip(*(by_impulses(seed, driven) for seed in range(SCHEDULES)), strict=True)
    assert {LATE + s for s in STEPS} == set().union(*ages), "every delay was there"
    assert (stats.n == SCHEDULES).all()
    np.testing.assert_allclose(stats["mean"], np.mean(each, 0), rtol=1e-10)
    np.testing.assert_allclose(stats.se, np.std(each, 0, ddof=1) / np.sqrt(SCHEDULES), rtol=1e-7)


@pytest.mark.nightly
def test_in_turn_they_are_those_of_the_one_schedule_with_its_losses():
    later = [0, 16, "lost", 5]
    lti = {k: v for k, v in STUDY["lti"].items() if k not in ("delay_values", "delay_self_transition")}
    turns = [v if v == "lost" else v * TICK for v in later]
    stats = (
        pcbench.exact_moments(STUDY | {"lti": lti | {"delay_sequence": turns}})
        .stats.query("metric == 'mse'")
        .set_index("signal")
    )
    driven = pcbench.simulate(STUDY, "model-only")[["u1", "u2"]].to_numpy()
    each = [(i, TE * i) for i in range(N // TE + 1)]
    arrives = [
        None if later[i % 4] == "lost" or t + LATE + later[i % 4] > N else t + LATE + later[i % 4] for i, t in each
    ]
    times = [(t, a) for (_, t), a in zip(each, arrives, strict=True)]
    np.testing.assert_allclose(stats["mean"], mean_square([times, times], driven), rtol=1e-10)
    assert (stats.se == 0).all()


MISTAKES = [
    (
        {"delay_self_transition": [0.5, 0.5]},
        "got 2 values of delay_self_transition for 3 delay_values, expected one, or one for each",
    ),
    ({"delay_values": []}, "got delay_self_transition in lti without delay_values"),
    ({"delay_values": [0.1]}, "expected two or more different values"),
    ({"delay_self_transition": 1.0}, "got 1, expected a probability below 1"),
    ({"delay_values": [0.0, 0.013]}, "expected a whole number of ticks"),
]


@pytest.mark.parametrize(("changes", "sentence"), MISTAKES, ids=[s for _, s in MISTAKES])
def test_mistakes_are_one_sentence(changes, sentence):
    with pytest.raises(UserError) as caught:
        parse.grid_of(STUDY | {"lti": STUDY["lti"] | changes}, {}, [])
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("observer", ["kfbo", "chain"])
def test_who_works_with_constant_delays_alone_says_so(observer):
    with pytest.raises(UserError, match="got delay_values, expected"):
        parse.grid_of(STUDY | {"observers": [observer]}, {}, [])


def test_as_an_axis_it_is_a_column_and_else_there_is_none():
    plain = parse.grid_of(STUDY, {}, []).cells[0]
    assert "delay_self_transition" not in plain.values
    axes = {"delay_self_transition": [0.2, 0.8], "delay_values": [[0.0, 0.1]]}
    few = STUDY | {"axes": axes, "lti": {k: v for k, v in STUDY["lti"].items() if not k.startswith("delay_")}}
    cells = parse.grid_of(few, {}, []).cells
    assert [(c.values["delay_self_transition"], c.values["delay_values"]) for c in cells] == [
        (0.2, "0, 0.1"),
        (0.8, "0, 0.1"),
    ]
    assert cells[1].times.clocks[0].delay_self_transition == (0.8, 0.8)


def test_one_or_one_for_each_stand_in_one_column():
    axes = {"delay_self_transition": [0.2, [0.5, 0.6, 0.7]]}
    assert [c.values["delay_self_transition"] for c in parse.grid_of(STUDY | {"axes": axes}, {}, []).cells] == [
        [0.2],
        [0.5, 0.6, 0.7],
    ]
