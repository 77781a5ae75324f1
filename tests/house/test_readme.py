"""The README claims only what runs: its Python, its study, its observer and its two commands are executed as they stand."""

import re
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import call

import pcbench
from pcbench import checking
from pcbench.dataset.seeds import counted
from pcbench.gains import tune
from pcbench.observers import OBSERVERS
from pcbench.scenarios import SCENARIOS
from pcbench.statistics import wording
from pcbench.study import cells, read

RANKED = "scenario == 'cart/white' and signal == 'position' and metric == 'tail_rmse'"
ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.S | re.M)


def test_there_are_two_shell_commands_and_ci_runs_exactly_those():
    commands = blocks("sh")
    assert len(commands) == 2
    assert all(len(c.strip().splitlines()) == 1 for c in commands)
    assert commands[0].strip().endswith("pcbench run quick")
    assert commands[1].strip().endswith("pytest")
    assert "readme_command" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.slow
def test_the_study_runs_as_written(tmp_path):
    (text,) = [b for b in blocks("toml") if "noise-map" in b]
    path = tmp_path / "noise-map.toml"
    path.write_text(text)
    found = read.load(str(path))
    assert len(pcbench.run(str(path), seeds=2).stats.cell.unique()) == 16
    assert len(cells.cells(found, "cart/gaussian")) == 16
    assert tomllib.loads(text)["name"] == "noise-map"


def test_the_slower_camera_is_a_scenario_as_written(tmp_path):
    (text,) = [b for b in blocks("toml") if "slower-camera" in b]
    (cell,) = cells.cells_of(read.parse(tomllib.loads(text), "README.md"))
    measured, base = cell.scenario.sampling, SCENARIOS["cart/white"]
    assert (cell.scenario.name, measured.sampling_period, measured.delay) == ("slower-camera", (0.4,), (0.6,))
    assert (measured.noise_std, cell.scenario.plant) == (base.sampling.noise_std, base.plant)


@pytest.mark.slow
def test_the_motor_runs_as_written_and_is_what_the_text_says(tmp_path):
    (text,) = [b for b in blocks("toml") if '"motor"' in b]
    path = tmp_path / "motor.toml"
    path.write_text(text)
    result = pcbench.run(str(path))
    wide = result.stats.set_index(["signal", "metric", "plant.input_bias", "observer"])["mean"]
    rms, least = wide["angle", "tail_pooled_rmse"], wide.xs("efficiency", level="metric").xs("dkf", level="observer")
    assert rms[0.2, "dkf"] / rms[0.2, "dkf-load"] == pytest.approx(1.7, abs=0.05)
    assert rms[0.0, "dkf-load"] / rms[0.0, "dkf"] == pytest.approx(1.01, abs=0.01)
    np.testing.assert_allclose(least, 1.0, atol=0.02)  # of three signals: the bound is attained
    lost = result.pairs.query("metric == 'tail_rmse' and observer_a == 'dkf' and observer_b == 'open-loop'")
    lost = lost[lost["plant.input_bias"] == 0.0]
    assert len(lost) == 3
    assert (lost.mean_diff < 0).all()
    assert (lost.p_holm < 0.05).all(), "the model alone loses on every signal"


@pytest.mark.slow
def test_there_is_a_longest_period_of_the_motors_camera_that_suffices(tmp_path):
    """The error grows with the period, surely, and passes what is asked for between two of them."""
    (text,) = [b for b in blocks("toml") if '"motor"' in b]
    axes = {"plant.input_bias": [0.0], "sampling_period": [[p, 0.01] for p in (0.04, 0.08, 0.16)]}
    stats = pcbench.run(tomllib.loads(text) | {"observers": ["dkf"]}, axes=axes).stats
    rows = stats[(stats.signal == "angle") & (stats.metric == "tail_pooled_rmse")]
    assert (rows.ci_high.to_numpy()[:-1] < rows.ci_low.to_numpy()[1:]).all()
    assert rows.ci_high.iloc[1] < 0.014 < rows.ci_low.iloc[2]


@pytest.mark.slow
def test_the_longest_period_of_the_motors_camera_is_found(tmp_path):
    path = tmp_path / "motor.toml"
    path.write_text(next(b for b in blocks("toml") if '"motor"' in b))
    how = {"signal": "angle", "metric": "tail_pooled_rmse", "overrides": ["axes.plant.input_bias=0.0"]}
    found = pcbench.suffices(path, over="sampling_period[0]", below=0.014, between=(0.04, 0.32), **how)
    found = found.set_index("observer")
    assert 0.08 <= found.largest["dkf"] < found.exceeds["dkf"] <= 0.16
    assert found.answer["open-loop"] == "no value"


@pytest.mark.slow
def test_the_answer_shown_is_the_one_that_comes_out(tmp_path):
    found = pcbench.suffices("cart/white", over="sampling_period", below=0.15, observers=["dkf", "pccebo"])
    (shown,) = [b for b in blocks("text") if b.startswith("cart/white: tail_rmse of position below")]
    for row, line in zip(found.to_dict("records"), shown.split("─\n")[1].splitlines(), strict=True):
        ends = [wording.estimate(row["exceeds_mean"], row["exceeds_ci_low"], row["exceeds_ci_high"])]
        ends += [f" {row['exceeds']:g} "] + ([f" {row['largest']:g} "] if row["answer"] == "up to" else [" none "])
        assert all(end in line for end in ends)
        assert line.split()[0] == row["observer"]


@pytest.mark.slow
def test_tuning_finds_the_motors_noise_by_channel_from_ten_times_wrong(tmp_path):
    """The two ratios of R to the current's Q, within 10 %: on 128 runs they scatter by a third of that."""
    (text,) = [b for b in blocks("toml") if '"motor"' in b]
    start = {"R": [4e-5, 2.5], "Q": [0.0, 0.0, 2.5e-4]}
    raw = tomllib.loads(text) | {"observers": ["dkf"], "axes": {}, "options": {"dkf": start}}
    made = tune.tune(
        raw,
        "dkf",
        budget=40,
        objective="tail_pooled_rmse",
        signal="speed",
        only=["R", "Q"],
        training=counted(3_000_000_000, 128),
    )
    found = np.array(made.found["R"]) / made.found["Q"][2]
    np.testing.assert_allclose(found, np.array([0.002, 0.5]) ** 2 / 0.05**2, rtol=0.1)
    assert made.judged[1].difference < -10 * made.judged[1].difference_se


@pytest.mark.slow
def test_the_pushed_cart_runs_as_written_and_its_push_is_found(tmp_path):
    (text,) = [b for b in blocks("toml") if '"pushed"' in b]
    path = tmp_path / "pushed.toml"
    path.write_text(text)
    stats = pcbench.run(str(path), seeds=8).stats.query("metric == 'tail_pooled_rmse'")
    rms = stats.set_index(["signal", "observer"])["mean"]
    assert set(rms["input"].index) == {"smo", "pio", "dkf"}
    assert max(rms["input"]) < 0.5  # of a push of size 1
    assert rms["position"].idxmax() == "open-loop"


@pytest.mark.parametrize(
    "first_line",
    ["import pcbench", pytest.param("import control", marks=pytest.mark.slow)],
)
def test_python_examples_run(first_line, capsys):
    (example,) = [b for b in blocks("python") if b.startswith(first_line)]
    exec(compile(example.replace("pcbench.setup()", ""), "README.md", "exec"), {})
    shown = capsys.readouterr().out
    assert "dkf" in shown or "pccebo" in shown


def test_the_observer_example_is_short_and_knows_its_schedule(tmp_path, monkeypatch):
    """At most 25 lines of code, it passes every check, and it runs from the study file that is shown."""
    monkeypatch.chdir(tmp_path)
    (example,) = [b for b in blocks("python") if "pcbench.Observer(" in b]
    assert len([line for line in example.splitlines() if line.strip()]) <= 25
    (tmp_path / "mine.py").write_text(example)
    found = checking.check("mine.py:nudge", options={"share": 0.2}).findings
    assert [f.check for f in found if f.verdict != "passes"] == []
    (study,) = [b for b in blocks("toml") if 'use = "mine.py:nudge"' in b]
    (tmp_path / "s.toml").write_text(study)
    result = pcbench.run("s.toml", seeds=8)
    assert list(dict.fromkeys(result.stats.observer)) == ["dkf", "strong"]


def test_the_table_shown_is_the_one_that_comes_out():
    result = pcbench.run("quick")
    stats = result.stats.query("scenario == 'cart/white' and signal == 'position'").set_index(["observer", "metric"])
    (shown,) = [b for b in blocks("text") if b.startswith("cart/white: error")]
    rows = shown.split("─\n")[1].splitlines()
    assert len(rows) == 4
    for line in rows:
        observer = line.split()[0]
        for metric in ("tail_rmse", "efficiency"):
            assert f" {wording.interval(stats.loc[(observer, metric)])}" in line, (observer, metric)
        best = wording.difference(result.pairs.query(RANKED), observer, "dkf") if observer != "dkf" else ""
        assert best in line
        assert observer == "dkf" or best.startswith("+")


def test_every_observer_and_command_is_named():
    for name in OBSERVERS:
        assert f"`{name}`" in README
    for command in ("list", "show", "run", "trace", "design", "reproduce", "compare"):
        assert f"pcbench {command}" in README
    assert set(re.findall(r"(?:cart|arm|csth|helicopter)/[\w-]+", README)) <= set(SCENARIOS)


ROW = re.compile(r"^\| .*? \| .*? \| (`.*?) \| `([a-z0-9/-]+)` (\w+) \[.*?\] \|$", re.M)


@pytest.mark.slow
@pytest.mark.parametrize(("errors", "scenario", "signal"), ROW.findall(README))
def test_the_decision_table_is_what_comes_out(errors, scenario, signal):
    said = {name: float(value) for name, value in re.findall(r"`([a-z-]+)` ([\d.]+)", errors)}
    stats = pcbench.run(scenario, observers=list(said), seeds=256).stats
    rms = stats[(stats.metric == "tail_rmse") & (stats.signal == signal)].set_index("observer")["mean"]
    for name, value in said.items():
        assert rms[name] == pytest.approx(value, rel=0.06, abs=1e-9), name
    assert list(said.values()) == sorted(said.values())


def test_the_decision_table_names_the_scenarios_it_is_drawn_from():
    assert len(ROW.findall(README)) == 8


def test_the_top_level_is_as_promised():
    allowed = {"pyproject.toml", "pcbench", "benchmarks", "notebooks", "tests", "README.md", "LICENSE", "CHANGELOG.md",
               "CITATION.cff", "CONTRIBUTING.md", "REPRODUCTION.md", "SECURITY.md"}  # fmt: skip
    tracked = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True, check=False).stdout
    top = {line.split("/")[0] for line in tracked.splitlines()}
    assert {name for name in top if not name.startswith(".")} <= allowed


def test_every_option_that_the_readme_names_exists():
    said = set(re.findall(r"(?<![\w-])(--[a-z][a-z-]+)", "\n".join(blocks("text"))))
    there = set()
    for command in (
        "run",
        "status",
        "verify",
        "merge",
        "compare",
        "trace",
        "design",
        "tune",
        "reproduce",
        "report",
        "suffices",
        "tables",
        "cite",
        "check",
        "show",
    ):
        there |= set(re.findall(r"--[a-z][a-z-]+", call(command, "--help").stdout))
    assert said <= there, said - there
