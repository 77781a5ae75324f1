"""Whose options an observer has, and how a study comes together from a name, a file, changes and overrides."""

import pytest

from pcbench.errors import UserError
from pcbench.study import STUDIES, choices_of, merge_options, observers_of, options_of, parse, scenarios_of


def study(scenario="cart/variable", **changes):
    return parse.parse({"name": "t", "scenarios": [scenario]} | changes, "t")


def options(made, observer):
    (name,) = made.scenarios
    return merge_options(made, scenarios_of(made)[name], observer)


def test_the_studys_options_win_over_the_scenarios_and_the_labels_over_its_names():
    made = study(options={"kf": {"R": 2.0, "q": 0.5}, "kf-bias": {"R": 3.0}, "pco": {"Kp": -5.0}})
    assert options(made, "kf") == {"R": 2.0, "q": 0.5}
    assert options(made, "kf-bias") == {"R": 3.0, "q": 0.5, "bias_variance": 1.0}
    assert options(made, "pco") == {"Kp": -5.0}
    assert options(made, "pi-pco") == {"Kp": -61.0, "Ki": 12.2}, "the scenario's own"
    assert options_of(made, scenarios_of(made)["cart/variable"], "kf-bias").R == 3.0


def test_an_option_is_known_with_either_dash():
    made = study("cart/white", options={"kfbo": {"lag-aware": True}, "scenario": {"initial-spread": 0.5}})
    assert options(made, "kfbo") == {"R": 0.004, "lag_aware": True}
    assert choices_of(made).initial_spread == 0.5


def test_a_studys_observers_run_and_without_any_the_scenarios():
    assert observers_of(study(observers=["kf"]), "cart/variable") == ["kf"]
    assert observers_of(study(), "cart/variable")[:2] == ["pco", "pi-pco"]


def test_a_random_initial_state_is_drawn_in_one_way():
    for both in (
        {"random_initial_state": True, "initial_spread": 0.1},
        {"random_initial_state": True, "initial_spread": 2.0},
    ):
        with pytest.raises(UserError, match="got random_initial_state and initial_spread, expected one of them"):
            study(options={"scenario": both})


def test_changes_and_overrides_are_both_put_in():
    made = parse.grid_of({"name": "t", "scenarios": ["cart/white"], "seeds": 5}, {"seeds": 3}, ["first_seed=7"]).study
    assert (made.seeds, made.first_seed) == (3, 7)
    named = parse.grid_of("cart/white", {"seeds": 3}, ["first_seed=7", "axes.noise_std=0.5"]).study
    assert (named.seeds, named.first_seed, named.axes) == (3, 7, {"noise_std": [0.5]})


def test_one_cell_is_one_cell():
    with pytest.raises(UserError, match="got 2 grid points, expected one"):
        parse.one_cell("cart/white", ["kf"], ["axes.noise_std=[0.1, 0.5]"])
    made, cell = parse.one_cell("cart/white", ["kf"], ["axes.noise_std=0.5"])
    assert (made.observers, cell.values["noise_std"]) == (["kf"], 0.5)


def test_a_plants_parameters_may_stand_as_a_table_of_their_own():
    """As TOML reads plant.lam = [...] under [axes]."""
    made = study("cart/white", axes={"plant": {"lam": [110.0, 122.0]}, "delay": [0.2]})
    assert made.axes == {"delay": [0.2], "plant.lam": [110.0, 122.0]}
    with pytest.raises(UserError, match=r"got plant.lam twice"):
        study("cart/white", axes={"plant": {"lam": [110.0]}, "plant.lam": [120.0]})


def test_a_label_without_its_options_or_its_dash_is_answered_with_how_it_is_written():
    for changes, answer in (
        ({"observers": ["kf-gate"]}, r"observers: got 'kf-gate' without options, .* write \[options\.kf-gate\]"),
        ({"options": {"kf2": {"R": 2.0}}}, r"options\.kf2: got no observer, .* write \[options\.kf-2\]"),
    ):
        with pytest.raises(UserError, match=answer):
            study("cart/white", **changes)


def test_filters_from_random_initial_states_are_judged_by_their_consistency():
    """Reports of `camera-target` and `processor` did not say which filter is optimistic."""
    for name in ("camera-target", "processor"):
        chosen = STUDIES[name].options["scenario"]
        assert chosen == {"random_initial_state": True, "consistency": True}, name
