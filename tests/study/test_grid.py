"""Cells: every point of a study's axes, known by all that decides their numbers and not by where they stand."""

import tomllib

import numpy as np
import pytest

import pcbench
from pcbench.cli.commands import app
from pcbench.errors import UserError
from pcbench.study import STUDIES, parse
from pcbench.study import grid as module
from pcbench.study.grid import cells, cells_of, identity, number_cells, numbering
from pcbench.study.serialize import digest, to_toml

pytestmark = pytest.mark.usefixtures("in_a_hurry")


def study(scenario="cart/white", **changes):
    return parse.parse({"name": "t", "scenarios": [scenario]} | changes, "t")


def text(chosen):
    return to_toml(chosen, cells_of(chosen))


def hash_study(chosen):
    return digest(chosen, cells_of(chosen))


def places(found):
    return [(c.values["noise_std"], c.values["delay"]) for c in found]


def test_cells_stand_in_the_order_of_the_axes_as_written():
    found = cells(study(axes={"noise_std": [0.5, 0.1], "delay": [0.3, 0.2, "interval"]}), "cart/white")
    assert places(found) == [(0.5, 0.3), (0.5, 0.2), (0.5, None), (0.1, 0.3), (0.1, 0.2), (0.1, None)]
    assert [c.number for c in found] == list(range(6))
    turned = cells(study(axes={"delay": [0.3, 0.2], "noise_std": [0.5, 0.1]}), "cart/white")
    assert places(turned) == [(0.5, 0.3), (0.1, 0.3), (0.5, 0.2), (0.1, 0.2)]


def test_a_cell_is_the_same_wherever_it_stands():
    long = cells(study(axes={"noise_std": [0.5, 0.1], "parameter_drift": [0.0, 1.0]}), "cart/white")
    short = cells(study(axes={"noise_std": [0.1]}), "cart/white")
    assert [c.digest for c in long].index(short[0].digest) == 2
    assert len({c.digest for c in long}) == 4


def test_a_cell_is_another_with_another_root_seed_choice_or_parameter():
    (plain,) = cells(study(), "cart/white")
    others = [
        cells(study(options={"scenario": {"random_initial_state": True}}), "cart/white")[0],
        cells(study(axes={"plant.lam": [110.0]}), "cart/white")[0],
        cells(study(axes={"sampling_jitter": [0.01]}), "cart/white")[0],
        cells(study(root_seed=1), "cart/white")[0],
    ]
    assert len({c.digest for c in (plain, *others)}) == 5
    assert others[-1].digest == identity(plain, 1)


def test_cells_that_are_known_keep_their_numbers_and_new_ones_follow():
    old = study(axes={"noise_std": [0.1, 0.5]})
    known = numbering(cells_of(old))
    found = number_cells(cells_of(study(axes={"noise_std": [0.9, 0.5, 0.3, 0.1]})), known)
    assert {c.values["noise_std"]: c.number for c in found} == {0.1: 0, 0.5: 1, 0.9: 2, 0.3: 3}


def test_a_cell_that_is_changed_is_of_no_study():
    (plain,) = cells(study(), "cart/white")
    changed = plain.with_fields(delay=(0.4,))
    assert (changed.digest, changed.times.clocks[0].delay) == ("", 400)


@pytest.mark.ci
def test_a_run_builds_each_cell_once(monkeypatch, tmp_path):
    """Options, digests and cells are made when a study is read; whatever writes, plans or closes it takes them from there."""
    counts = dict.fromkeys(("cells", "options_of", "identity"), 0)

    def counted(name):
        true = getattr(module, name)

        def called(*given):
            counts[name] += 1
            return true(*given)

        monkeypatch.setattr(module, name, called)
        if hasattr(parse, name):
            monkeypatch.setattr(parse, name, called)

    for name in counts:
        counted(name)
    words = [
        "run",
        "cart/white",
        "--seeds",
        "2",
        "--observers",
        "kf,model-only",
        "--out",
        str(tmp_path / "out"),
        "--quiet",
    ]
    app([*words, "--set", "axes.noise_std=[0.5, 0.1]"], standalone_mode=False)
    assert counts == {"cells": 1, "options_of": 2, "identity": 2}


def test_an_axis_wins_over_the_scenarios_own_parameter():
    (own,) = cells(study("cart/variable-bias"), "cart/variable-bias")
    (given,) = cells(study("cart/variable-bias", axes={"plant.input_bias": [0.5]}), "cart/variable-bias")
    assert (own.parameters, given.parameters) == ({"input_bias": 0.2}, {"input_bias": 0.5})


def test_a_study_is_written_with_all_that_decides_its_numbers():
    written = tomllib.loads(text(study("cart/variable", options={"kf": {"R": 2.0}})))
    resolved = written["resolved"]
    assert resolved["scenarios"]["cart/variable"]["delay"] == ["interval"]
    assert resolved["options"]["cart/variable"]["kf"]["R"] == 2.0
    assert resolved["options"]["cart/variable"]["pi-pco"] == {"Kp": -61.0, "Ki": 12.2, "decay": 0.0}
    assert resolved["observers"]["cart/variable"] == ["pco", "pi-pco", "pccebo", "kf", "kf-bias", "model-only"]


@pytest.mark.parametrize("changes", [{"seeds": 3}, {"root_seed": 1}, {"axes": {"loss": [0.1]}}, {"observers": ["kf"]}])
def test_the_digest_of_a_study_changes_with_whatever_changes_its_numbers(changes):
    assert hash_study(study()) == hash_study(study())
    assert hash_study(study(**changes)) != hash_study(study())


@pytest.mark.parametrize("name", STUDIES)
def test_every_scenario_of_a_study_has_the_same_columns(name):
    """`all` has loops with a controller, whose commands have columns, and loops without."""
    made = parse.grid_of(name, {}, [])
    assert len({tuple(cell.values) for cell in made.cells}) == 1


@pytest.mark.ci
def test_a_study_of_loops_with_and_without_a_controller_has_tables(tmp_path):
    chosen = {"name": "t", "scenarios": ["cart/white", "ncs-two-state/held"], "observers": ["model-only"], "seeds": 2}
    found = pcbench.run(chosen, out=tmp_path / "out").stats.groupby("scenario").command_loss.first()
    assert np.isnan(found["cart/white"])
    assert found["ncs-two-state/held"] == 0
    with pytest.raises(UserError, match="command_jitter: no scenario has a controller, and one has"):
        pcbench.run(chosen | {"scenarios": ["cart/white"]}, out=tmp_path / "out")
