"""Cells: every point of a study's axes, known by all that decides their numbers and not by where they stand."""

import tomllib

import pytest

from pcbench.study import read
from pcbench.study.cells import cells, cells_of, digest, identity, numbering, to_toml


def study(scenario="cart/white", **changes):
    return read.parse({"name": "t", "scenarios": [scenario]} | changes, "t")


def places(found):
    return [(c.values["noise_std"], c.values["delay"]) for c in found]


def test_cells_stand_in_the_order_of_the_axes_as_written():
    found = cells(study(axes={"noise_std": [0.5, 0.1], "delay": [0.3, 0.2, "interval"]}), "cart/white")
    assert places(found) == [(0.5, 0.3), (0.5, 0.2), (0.5, None), (0.1, 0.3), (0.1, 0.2), (0.1, None)]
    assert [c.number for c in found] == list(range(6))
    turned = cells(study(axes={"delay": [0.3, 0.2], "noise_std": [0.5, 0.1]}), "cart/white")
    assert places(turned) == [(0.5, 0.3), (0.1, 0.3), (0.5, 0.2), (0.1, 0.2)]


def test_a_cell_is_the_same_wherever_it_stands():
    long = cells(study(axes={"noise_std": [0.5, 0.1], "drift": [0.0, 1.0]}), "cart/white")
    short = cells(study(axes={"noise_std": [0.1]}), "cart/white")
    assert [identity(c, 0) for c in long].index(identity(short[0], 0)) == 2
    assert len({identity(c, 0) for c in long}) == 4


def test_a_cell_is_another_with_another_root_seed_choice_or_parameter():
    (plain,) = cells(study(), "cart/white")
    others = [
        cells(study(options={"scenario": {"random_start": True}}), "cart/white")[0],
        cells(study(axes={"plant.lam": [110.0]}), "cart/white")[0],
        cells(study(axes={"jitter": [0.01]}), "cart/white")[0],
    ]
    assert len({identity(c, 0) for c in (plain, *others)} | {identity(plain, 1)}) == 5


def test_cells_that_are_known_keep_their_numbers_and_new_ones_follow():
    old = study(axes={"noise_std": [0.1, 0.5]})
    known = numbering(old, cells_of(old))
    found = cells_of(study(axes={"noise_std": [0.9, 0.5, 0.3, 0.1]}), known)
    assert {c.values["noise_std"]: c.number for c in found} == {0.1: 0, 0.5: 1, 0.9: 2, 0.3: 3}


def test_an_axis_wins_over_the_scenarios_own_parameter():
    (own,) = cells(study("cart/variable-bias"), "cart/variable-bias")
    (given,) = cells(study("cart/variable-bias", axes={"plant.input_bias": [0.5]}), "cart/variable-bias")
    assert (own.parameters, given.parameters) == ({"input_bias": 0.2}, {"input_bias": 0.5})


def test_a_study_is_written_with_all_that_decides_its_numbers():
    written = tomllib.loads(to_toml(study("cart/variable", options={"dkf": {"R": 2.0}})))
    resolved = written["resolved"]
    assert resolved["scenarios"]["cart/variable"]["delay"] == ["interval"]
    assert resolved["options"]["cart/variable"]["dkf"]["R"] == 2.0
    assert resolved["options"]["cart/variable"]["pi-pco"] == {"Kp": -61.0, "Ki": 12.2, "decay": 0.0}
    assert resolved["observers"]["cart/variable"] == ["pco", "pi-pco", "pccebo", "dkf", "dkf-bias", "open-loop"]


@pytest.mark.parametrize("changes", [{"seeds": 3}, {"root_seed": 1}, {"axes": {"loss": [0.1]}}, {"observers": ["dkf"]}])
def test_the_digest_of_a_study_changes_with_whatever_changes_its_numbers(changes):
    assert digest(study()) == digest(study())
    assert digest(study(**changes)) != digest(study())
