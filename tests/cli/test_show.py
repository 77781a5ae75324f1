"""`pcbench show` says what a scenario is, and prints it as a study that gives the same numbers."""

import json
import tomllib

import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.cli.catalogue import scenario
from pcbench.cli.commands import app
from pcbench.scenarios import SCENARIOS
from pcbench.study import grid, observers_of, parse, scenario_template
from pcbench.study.grid import cell_of, identity


@pytest.mark.ci
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_printed_as_a_study_is_the_scenario(name):
    """Equal in every field, as the digests see them."""
    found = parse.parse(tomllib.loads(scenario_template.as_study(SCENARIOS[name])), "mine.toml")
    (own,) = grid.cells_of(found)
    assert own.scenario.name == "my-" + name.replace("/", "-")
    published = cell_of(SCENARIOS[name], parameters=dict(SCENARIOS[name].truth.parameters))
    assert identity(own._replace(scenario=own.scenario.with_fields(name=name)), 0) == identity(published, 0)


@pytest.mark.ci
@pytest.mark.parametrize("name", SCENARIOS)
def test_what_stands_there_as_a_comment_is_a_value_that_changes_nothing(name):
    text = scenario_template.as_study(SCENARIOS[name])
    bare = "\n".join(line.removeprefix("# ") if " = " in line else line for line in text.splitlines())
    a, b = (parse.parse(tomllib.loads(each), "mine.toml") for each in (text, bare))
    (one,), (other,) = grid.cells_of(a), grid.cells_of(b)
    assert one.digest == other.digest


def test_a_tail_is_said_even_where_it_is_the_records_default():
    """Left out of a table, it would begin after 30 % of the horizon."""
    assert "\nsteady_start = 3.0" in scenario_template.as_study(SCENARIOS["cart/white"].with_fields(duration=20.0))


@pytest.mark.nightly  # by default its identity is enough: equal in every field that a number depends on
@pytest.mark.parametrize("name", SCENARIOS)
def test_it_gives_the_same_numbers_bit_for_bit(name, tmp_path):
    printed = tmp_path / "mine.toml"
    printed.write_text(call("show", name, "--toml").stdout)
    own, published = (pcbench.run(what, seeds=2) for what in (str(printed), name))
    for mine, theirs in ((own.runs, published.runs), (own.stats, published.stats)):
        a, b = (frame.drop(columns=["study", "scenario"]) for frame in (mine, theirs))
        pd.testing.assert_frame_equal(a, b, check_exact=True)


@pytest.mark.ci
def test_the_sheet_is_what_list_says_and_a_file_of_ones_own_has_one(tmp_path):
    shown = call("show", "csth/10s-noise")
    assert shown.returncode == 0
    assert "signal enthalpy [J]: settled within 1000" in shown.stdout
    assert shown.stdout.strip().endswith("pcbench show csth/10s-noise --toml > mine.toml")
    assert json.loads(call("show", "cart/white", "--json").stdout) == {"cart/white": scenario(SCENARIOS["cart/white"])}
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


def test_a_study_with_options_of_labels_is_printed_with_them(tmp_path, capsys):
    text = """observers = ["kfbo", 'kfbo-"]x']\n[scenario]\nbase = "cart/white"\n[options.'kfbo-"]x']\nR = 0.3\n"""
    (tmp_path / "own.toml").write_text(text + "[options.scenario]\nrandom_initial_state = true\n")
    again = parse.parse(tomllib.loads(stdout(capsys, tmp_path / "own.toml", "--toml")), "mine.toml")
    assert again.options == {'kfbo-"]x': {"R": 0.3}, "scenario": {"random_initial_state": True}}


def stdout(capsys, *words):
    app(["show", *map(str, words)], standalone_mode=False)
    return capsys.readouterr().out


FAULTS = {"delay_jitter": 0.2, "loss": 0.1, "process_std": [0.0, 0.05], "clock_skew": 20.0, "delay": 0.15}
OWN = (
    """name = "a"
observers = ["kf", "kfbo"]
[lti]
A = [[0.0, 1.0], ["-k", -2.0]]
B = [[0.0], [3.0]]
C = [[1.0, 0.0]]
tick = 0.01
sampling_period = 0.1
noise_std = 0.1
x0 = [1.0, 0.0]
duration = 5.0
"""
    + "".join(f"{key} = {value}\n" for key, value in FAULTS.items())
    + "[lti.parameters]\nk = 2.0\n[axes]\nloss = [0.1, 0.2]\n"
)


def test_show_names_every_field_that_is_not_as_usual(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "own.toml").write_text(OWN)
    text = stdout(capsys, tmp_path / "own.toml")
    for key, value in FAULTS.items():
        assert (
            f"{key.replace('_', ' ')}: {', '.join(f'{v:g}' for v in value) if isinstance(value, list) else f'{value:g}'}\n"
            in text
        )
    assert "observers: kf, kfbo\n" in text
    assert "axes of the study: loss 0.1, 0.2\n" in text
    assert "plant.k" in text


def test_what_show_says_to_type_is_accepted(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "own.toml").write_text(OWN)
    assert stdout(capsys, tmp_path / "own.toml").rstrip().endswith(f"then pcbench run {tmp_path}/own.toml")
    for name in ("cart/white", "delayed-measurements"):
        assert f"pcbench show {name} --toml" in stdout(capsys, name)
        assert stdout(capsys, name, "--toml").startswith("name = ")


@pytest.mark.parametrize("name", ["delayed-measurements", "reactor/batch"])
def test_a_study_is_printed_with_its_observers_and_axes(name, capsys):
    study = parse.load(name)
    again = parse.parse(tomllib.loads(stdout(capsys, name, "--toml")), "mine.toml")
    (printed,), (own,) = again.scenarios, study.scenarios
    assert observers_of(again, printed) == observers_of(study, own)
    assert again.axes == study.axes
