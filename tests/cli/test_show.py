"""`pcbench show` says what a scenario is, and prints it as a study that gives the same numbers."""

import json
import tomllib

import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.cli.catalogue import scenario
from pcbench.scenarios import SCENARIOS
from pcbench.study import cells, read, scenario_toml
from pcbench.study.cells import cell_of, identity


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_printed_as_a_study_is_the_scenario(name):
    """Equal in every field, as the digests see them."""
    found = read.parse(tomllib.loads(scenario_toml.as_study(SCENARIOS[name])), "mine.toml")
    (own,) = cells.cells_of(found)
    assert own.scenario.name == "my-" + name.replace("/", "-")
    published = cell_of(SCENARIOS[name], parameters=dict(SCENARIOS[name].truth.parameters))
    assert identity(own._replace(scenario=own.scenario.having(name=name)), 0) == identity(published, 0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_what_stands_there_as_a_comment_is_a_value_that_changes_nothing(name):
    text = scenario_toml.as_study(SCENARIOS[name])
    bare = "\n".join(line.removeprefix("# ") if " = " in line else line for line in text.splitlines())
    a, b = (read.parse(tomllib.loads(each), "mine.toml") for each in (text, bare))
    (one,), (other,) = cells.cells_of(a), cells.cells_of(b)
    assert one.digest == other.digest


def test_a_tail_is_said_even_where_it_is_the_records_default():
    """Left out of a table, it would begin after 30 % of the horizon."""
    assert "\ntail = 3.0" in scenario_toml.as_study(SCENARIOS["cart/white"].having(horizon=20.0))


@pytest.mark.slow  # by default its identity is enough: equal in every field that a number depends on
@pytest.mark.parametrize("name", SCENARIOS)
def test_it_gives_the_same_numbers_bit_for_bit(name, tmp_path):
    printed = tmp_path / "mine.toml"
    printed.write_text(call("show", name, "--toml").stdout)
    own, published = (pcbench.run(what, seeds=2) for what in (str(printed), name))
    for mine, theirs in ((own.runs, published.runs), (own.stats, published.stats)):
        a, b = (frame.drop(columns=["study", "scenario"]) for frame in (mine, theirs))
        pd.testing.assert_frame_equal(a, b, check_exact=True)


def test_the_sheet_is_what_list_says_and_a_file_of_ones_own_has_one(tmp_path):
    shown = call("show", "csth/10s-noise")
    assert shown.returncode == 0
    assert "signal enthalpy [J]: settled within 1000" in shown.stdout
    assert shown.stdout.strip().endswith("pcbench show csth/10s-noise --toml > mine.toml")
    assert json.loads(call("show", "cart/white", "--json").stdout) == {"cart/white": scenario("cart/white")}
    own = tmp_path / "mine.toml"
    own.write_text("[scenario]\nbase = 'cart/white'\nnoise_std = 0.125\n")
    assert "noise std: 0.125" in call("show", own).stdout
    assert "noise_std = [0.125]" in call("show", own, "--toml").stdout


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("cart/whit",), "'cart/whit' is no study, scenario or TOML file; did you mean 'cart/white'?"),
        (("quick",), "quick: got 2 scenarios, expected one here; name a scenario."),
        (("cart/white", "--toml", "--json"), "got --toml and --json, expected one of them"),
    ],
)
def test_what_is_no_scenario_is_one_sentence(words, sentence):
    said = call("show", *words)
    assert said.returncode == 2
    assert sentence in said.stderr
