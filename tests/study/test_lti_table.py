"""What a study's own plant is where its table leaves something out, and what is said of its states."""

import pytest
import tomli_w
from commands import call

from pcbench.errors import UserError
from pcbench.plants import settles_alone, signals_of
from pcbench.study import parse

PLANT = {
    "A": [[-1.0, 2.0], [0.0, -0.5]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0]],
    "sampling_period": 0.1,
    "delay": 0.2,
    "noise_std": 0.3,
}


def scenario(**changes):
    made = parse.parse({"name": "own", "lti": PLANT | changes}, "own")
    return made.lti.scenario("lti", "own: lti")


def test_what_is_left_out_is_what_the_table_says():
    s = scenario()
    assert (s.dt, s.duration, s.scoring.steady_start, s.scoring.divergence_threshold) == (1e-3, 10.0, 3.0, 1e6)
    assert (s.truth.x0, s.belief.xhat0, s.belief.prior_std) == ((1.0, 1.0), (0.0, 0.0), (1.0, 1.0))
    assert s.scoring.settle_band == pytest.approx((0.05, 0.05))
    assert (s.loop.input, s.observers) == ("sine", ("kf", "model-only"))
    assert (s.sampling.sampling_period, s.sampling.delay, s.sampling.noise_std) == ((0.1,), (0.2,), (0.3,))


def test_the_prior_is_how_far_apart_the_starts_are_and_the_band_a_twentieth_of_it():
    s = scenario(x0=[3.0, -2.0], xhat0=[1.0, -2.0])
    assert s.belief.prior_std == (2.0, 1.0), "1 where they are the same"
    assert s.scoring.settle_band == pytest.approx((0.1, 0.05))
    known = scenario(x0=[3.0, -2.0], xhat0=[1.0, -2.0], prior_std=[0.0, 0.0])
    assert known.scoring.settle_band == pytest.approx((0.1, 0.05)), "an error that is rounding is in its band"
    pushed = scenario(E=[[0.0], [1.0]], unknown_std=[4.0], prior_std=[2.0, 6.0])
    assert pushed.scoring.settle_band == pytest.approx((0.1, 0.3, 0.2))
    assert (pushed.truth.unknown_input, pushed.scoring.headline) == ("sine", ("x1", "input"))


def test_a_run_diverges_beyond_one_threshold_or_one_for_each_signal():
    assert scenario(divergence_threshold=[10.0, 20.0]).scoring.divergence_threshold == (10.0, 20.0)
    with pytest.raises(UserError, match=r"lti.divergence_threshold: got 1 numbers, expected one, or 2"):
        scenario(divergence_threshold=[10.0])


def test_the_tail_and_the_horizon_are_whole_ticks():
    s = scenario(duration=2.0, tick=0.01, sampling_period=0.1)
    assert (s.duration, s.scoring.steady_start) == pytest.approx((2.0, 0.6))
    assert scenario(duration=2.0, steady_start=1.5).scoring.steady_start == 1.5


def test_states_have_their_names_and_units():
    assert signals_of(scenario(states=["angle [rad]", "speed"])) == (("angle", "rad"), ("speed", "1"))
    assert signals_of(scenario(E=[[0.0, 1.0], [1.0, 0.0]]))[2:] == (("input1", "1"), ("input2", "1"))
    with pytest.raises(UserError, match="got a state called 'input', expected another name"):
        scenario(states=["input", "speed"], E=[[0.0], [1.0]])


def test_a_discrete_plant_moves_by_its_own_tick():
    s = scenario(dt=0.05, duration=1.0)
    assert (s.dt, s.belief.model["discrete"]) == (0.05, True)
    assert s.belief.model["A"] == PLANT["A"]


def test_a_plant_may_grow_by_so_much_over_its_horizon_and_no_more():
    """A mode of 6.9 a second grows by 1e30 in ten seconds, one of 7 by more; a discrete one by its size a tick."""
    scenario(A=[[6.9, 0.0], [0.0, -100.0]])
    with pytest.raises(UserError, match="got a plant that grows by 1e3"):
        scenario(A=[[7.0, 0.0], [0.0, -100.0]])
    scenario(A=[[1.4, 0.0], [0.0, 0.1]], dt=0.05, duration=10.0)
    with pytest.raises(UserError, match="grows by 1e35"):
        scenario(A=[[0.1, 0.0], [0.0, 1.5]], dt=0.05, duration=10.0)


LONE = {
    "as it is": ({}, True),
    "process noise": ({"process_std": [0.0, 0.1]}, False),
    "full process noise": ({"QN": [[1.0, 0.5], [0.5, 1.0]]}, False),
    "an integrator": ({"A": [[-1.0, 2.0], [0.0, 0.0]]}, False),
    "discrete": ({"A": [[0.5, 0.2], [0.0, 0.9]], "dt": 0.05}, True),
    "discrete and growing": ({"A": [[0.5, 0.2], [0.0, 1.1]], "dt": 0.05}, False),
    "an unknown input": ({"E": [[0.0], [1.0]]}, False),
    "another plant": ({"plant": {"A": [[-1.0, 2.0], [0.0, -0.6]]}}, False),
}


@pytest.mark.parametrize("what", LONE)
def test_a_plant_settles_alone_where_nothing_but_its_input_pushes_it(what):
    changes, want = LONE[what]
    assert settles_alone(scenario(**changes)) is want


@pytest.mark.nightly
def test_the_closing_table_says_where_the_model_alone_wins(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(tomli_w.dumps({"lti": PLANT | {"duration": 1.0}, "seeds": 4}))
    said = "lti: the plant decays by itself, equals its model, and has no process noise."
    assert said in " ".join(call("run", str(path), "--out", str(tmp_path / "a")).stdout.split())
    axes = ("--set", "axes.process_std=[0.0, 0.1]")
    assert said not in " ".join(call("run", str(path), "--out", str(tmp_path / "b"), *axes).stdout.split())
