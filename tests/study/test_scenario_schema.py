"""A scenario of a user's own, `[scenario]`: what is left out is the base's or a default, what does not fit is refused."""

import tomllib

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.planning import all_observers
from pcbench.scenarios import SCENARIOS
from pcbench.scenarios.sources import values
from pcbench.study import grid, parse, scenario_template

pytestmark = pytest.mark.usefixtures("in_a_hurry")

CART = {"plant": "cart", "x0": [2.0, -1.0], "sampling_period": 0.1, "delay": 0.05, "noise_std": 0.2}
WHITE, CIRCLE = {"base": "cart/white"}, {"Kp": [1.0, 2.0], "Kd": [1.0, 2.0], "limit": [1.0, 2.0], "path": "circl"}


def make_scenario(table, **study):
    found = parse.parse({"name": "mine", "scenario": table} | study, "mine.toml")
    return parse.scenarios_of(found)[found.scenarios[0]]


def test_what_is_left_out_is_filled_in():
    s = make_scenario(CART)
    assert (s.name, s.plant, s.dt, s.duration, s.observers) == ("mine", "cart", 1e-3, 10.0, ("kf", "model-only"))
    assert (s.truth.x0, s.belief.xhat0, s.belief.prior_std) == ((2.0, -1.0), (0.0, 0.0), (2.0, 1.0))
    assert s.scoring.settle_band == pytest.approx((0.1, 0.05))
    assert (s.scoring.steady_start, s.scoring.divergence_threshold, s.loop.input) == (3.0, 1e6, "sine")
    assert (s.sampling.sampling_period, s.sampling.delay, s.sampling.noise_std) == ((0.1,), (0.05,), (0.2,))
    unknown = CART | {"plant": "helicopter", "x0": [0.5, 0.4, 0.2, 0.0]}
    s = make_scenario(unknown | {"unknown_std": [2.0, 4.0], "input": "step"})
    assert (s.observers, s.belief.unknown_std) == (("ekf",), (2.0, 4.0))
    assert s.scoring.settle_band == pytest.approx((0.025, 0.02, 0.01, 0.05, 0.1, 0.2)), "1 where x(0) is believed"
    assert s.sampling.delay == (0.05, 0.05)


def test_a_base_has_only_what_is_said_changed():
    base, s = (
        SCENARIOS["cart/variable"],
        make_scenario({"base": "cart/variable", "noise-std": 0.1, "x0": [1, 2], "divergence_threshold": 50}),
    )
    different = {key for key, value in s.flat().items() if value != base.value(key)}
    assert different == {"name", "summary", "source", "noise_std", "x0", "divergence_threshold"}
    assert (s.sampling.noise_std, s.truth.x0, s.scoring.divergence_threshold) == ((0.1,), (1.0, 2.0), 50.0)
    assert s.summary == "cart/variable, changed"
    assert make_scenario({"base": "helicopter/constant", "input": "step"}).loop.controller == "", (
        "an input opens the loop"
    )


def test_its_name_is_the_studys_unless_it_has_one():
    assert make_scenario(WHITE | {"name": "other"}).name == "other"
    assert (
        parse.parse({"name": "mine", "scenario": WHITE, "scenarios": ["cart/white", "mine"]}, "").scenarios[1] == "mine"
    )


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (WHITE | {"noise": 0.1}, r"^mine.toml: scenario: 'noise' is no key here; did you mean 'noise_std'\?"),
        ({"base": "cart/whit"}, "scenario.base: 'cart/whit' is no built-in scenario; did you mean 'cart/white'"),
        ({"plant": "cart", "x0": [1.0, 0.0]}, "scenario: sampling_period is missing; write sampling_period = ..."),
        (WHITE | {"plant": "kart"}, "scenario.plant: 'kart' is no plant .*; did you mean 'cart'"),
        (
            WHITE | {"plant": "lti"},
            "scenario.plant: got 'lti', expected a plant with its own equations; write the table",
        ),
        (WHITE | {"plant": "csth"}, "scenario.x0: got 2 numbers, expected 3, one for each state of csth"),
        (WHITE | {"x0": [1.0]}, "scenario.x0: got 1 numbers, expected 2, one for each state of cart"),
        (WHITE | {"x0": "1"}, "scenario.x0: got '1', expected"),
        (WHITE | {"x0": [1.0, "a"]}, r"scenario.x0\[1\]: got 'a', expected a valid number"),
        (WHITE | {"process_std": [0.1]}, "scenario.process_std: got 1 numbers, expected 2"),
        (
            WHITE | {"assumed_noise_std": [0.1, 0.1]},
            "assumed_noise_std: got 2 numbers, expected 1, one for each output",
        ),
        (WHITE | {"divergence_threshold": [1.0]}, "scenario.divergence_threshold: got 1 numbers, expected one, or 2"),
        (WHITE | {"delay": [0.1, 0.2]}, "scenario.delay: got 2 values, expected one or 1"),
        (WHITE | {"delay": 0.0505}, "scenario.delay: got 0.0505 s, expected a whole number of ticks"),
        (WHITE | {"dt": 0.003}, "scenario.sampling_period: got 0.2 s, expected a whole number of ticks of 0.003 s"),
        (
            WHITE | {"duration": 0.1, "steady_start": 0.05},
            "sampling_period: got 0.2 s, expected at most the duration of mine",
        ),
        (WHITE | {"steady_start": 10.0}, "scenario.steady_start: got 10 s, expected less than the duration of 10 s"),
        (WHITE | {"loss": 1.5}, "scenario.loss: got 1.5, expected a probability"),
        (WHITE | {"prefilled": 1}, "scenario.prefilled: got 1, expected a valid boolean"),
        (WHITE | {"input": "sin"}, "scenario.input: 'sin' is no input; did you mean 'sine'"),
        (WHITE | {"input": "sine, step"}, r"scenario.input: got 2 signals, expected one, or one for each of 1 inputs"),
        (WHITE | {"input": ""}, "scenario: got neither an input nor a controller, expected one"),
        (WHITE | {"input": "sine", "controller": "pd"}, "scenario: got an input and a controller, expected one"),
        (
            WHITE | {"controller": "pd"},
            "scenario.controller: got 'pd' on cart, expected a plant that it supports: helicopter",
        ),
        (WHITE | {"controller": "pidd"}, "scenario.controller: 'pidd' is no controller"),
        ({"base": "helicopter/constant", "control": CIRCLE}, "control.path: 'circl' is no path; did you mean 'circle'"),
        ({"base": "helicopter/constant", "control": {"Kp": [1.0, 2.0]}}, "scenario.control: Kd is missing"),
        (WHITE | {"unknown_input": "sine"}, "scenario.unknown_input: got 'sine' for cart, expected none"),
        (
            {"base": "arm/sine", "unknown_input": "arm-sin"},
            "unknown_input: 'arm-sin' is no input; did you mean 'arm-sine'",
        ),
        (
            WHITE | {"parameters": {"lamb": 1.0}},
            "scenario.parameters: 'lamb' is no parameter of plant cart; did you mean",
        ),
        (WHITE | {"parameters": {"drift_sign": 2.0}}, "parameters.drift_sign: got 2.0, expected a sign"),
        (
            {"base": "csth/10s", "model": {"literal": 1}},
            "scenario.model.literal: got 1, expected a value such as False",
        ),
        (WHITE | {"signals": ["a [m]"]}, "scenario.signals: got 1 names, expected 2"),
        (WHITE | {"signals": ["a [m]", "2b"]}, "scenario.signals: got '2b', expected a name with a unit"),
        (WHITE | {"signals": ["a [m]", "a"]}, "scenario.signals: got 'a' twice"),
        (WHITE | {"headline": ["speed"]}, "scenario.headline: 'speed' is no signal; .*valid: position, velocity"),
        (WHITE | {"observers": ["kff"]}, "scenario.observers: 'kff' is no observer; did you mean 'kf'"),
        (WHITE | {"options": {"kf": {"r": 1.0}}}, "scenario.options.kf: 'r' is no key here; did you mean 'R'"),
        (WHITE | {"name": "cart/slow"}, "scenario.name: got 'cart/slow', expected a name that no other scenario has"),
        (WHITE | {"continuous": True}, "whose measurements are continuous and without noise, expected no such axis"),
        (
            {"base": "csth/literal", "continuous": True},
            "continuous: got true for csth, expected a plant that is a vector",
        ),
        ("cart/white", "scenario: got 'cart/white', expected a valid table"),
    ],
)
def test_what_does_not_fit_is_one_sentence(table, sentence):
    with pytest.raises(UserError, match=sentence):
        make_scenario(table)


def test_its_fields_can_be_set_and_are_axes_like_any_others():
    study = parse.grid_of(
        {"name": "mine", "scenario": WHITE}, {}, ["scenario.sampling_jitter=0.01", "axes.delay=[0.1, 0.3]"]
    ).study
    first, second = grid.cells_of(study)
    assert (first.scenario.sampling.sampling_jitter, first.scenario.sampling.delay, second.scenario.sampling.delay) == (
        0.01,
        (0.1,),
        (0.3,),
    )


@pytest.mark.ci
def test_a_result_says_its_scenario_and_goes_on_with_it(tmp_path):
    table = {
        "base": "cart/slow",
        "duration": 4.0,
        "noise_std": 0.1,
        "observers": ["kf"],
        "options": {"kf": {"R": 0.02}},
    }
    out = tmp_path / "mine"
    asked = {"name": "mine", "scenario": table}
    first = pcbench.run(asked, seeds=4, out=str(out))
    again = pcbench.open_result(str(out))
    assert again.study.scenario.model_dump(exclude_none=True) == table
    pd.testing.assert_frame_equal(first.stats, again.stats)
    more = pcbench.run(str(out / "study.toml"), seeds=6, out=str(out))
    assert set(more.stats.n) == {6}
    with pytest.raises(UserError, match="noise_std"):
        pcbench.run({"name": "mine", "scenario": table | {"noise_std": 0.2}}, seeds=6, out=str(out))


def test_inputs_are_waves_rows_or_a_file_and_are_shown_as_they_were_written(tmp_path):
    wave = {"signal": "sine", "amplitude": 2.0, "frequency": 0.5}
    assert values(make_scenario(CART | {"input": wave}).loop.input[0], np.array([0.5])) == pytest.approx(2.0)
    rows = [[0.0, 1.0], [2.5, -1.0]]
    (tmp_path / "u.csv").write_text("t,u1\n0,1\n2.5,-1\n")
    lines = [f"{key} = {value!r}" for key, value in (CART | {"input": "u.csv"}).items()]
    (tmp_path / "s.toml").write_text("\n".join(["[scenario]", *lines]))
    read_back = parse.scenario_of(str(tmp_path / "s.toml"))
    assert read_back.loop.input == make_scenario(CART | {"input": rows}).loop.input
    for given in (wave, rows, [wave]):
        s = make_scenario(CART | {"input": given})
        again = tomllib.loads(scenario_template.as_study(s))["scenario"]
        assert make_scenario(again).loop.input == s.loop.input, given
    with pytest.raises(UserError, match=r"scenario.input.signal: 'sin' is no shape of a signal; did you mean 'sine'"):
        make_scenario(CART | {"input": {"signal": "sin"}})
    pushed = {"base": "arm/sine", "unknown_input": wave}
    assert make_scenario(pushed).truth.unknown_input[0].amplitude == 2.0


def test_a_loop_for_any_plant_has_its_law_and_its_network_checked():
    law = {"controller": "lqr", "control": {"Q1": 1.0, "Q2": 1.0}}
    s = make_scenario(CART | law | {"command_loss": 0.1, "actuator_delay": 0.02})
    assert (s.loop.command_loss, s.loop.actuator_delay, s.loop.input) == (0.1, 0.02, "")
    wrong = {
        "scenario.control.Q1: got a flat list of 3": CART | law | {"control": {"Q1": [1.0] * 3, "Q2": 1.0}},
        "scenario.command_loss: got 0.1 where no controller": CART | {"command_loss": 0.1},
        "command_jitter: got 0.0015 s, expected a whole number of ticks": CART | law | {"command_jitter": 0.0015},
    }
    for sentence, table in wrong.items():
        with pytest.raises(UserError, match=sentence):
            make_scenario(table)


@pytest.mark.parametrize("name", ["cart/white", "ncs-reactor/round-robin"])
def test_changes_of_a_named_scenario_apply_to_it(name):
    grid = all_observers.grid_of(name, {}, ["scenario.noise_std=0.5", "seeds=8"])
    (cell,) = grid.cells
    changed, original = cell.scenario, SCENARIOS[name]
    assert set(np.ravel(changed.sampling.noise_std)) == {0.5}
    sampling = changed.sampling._replace(noise_std=original.sampling.noise_std)
    assert changed._replace(name=name, sampling=sampling, source=original.source, summary=original.summary) == original
