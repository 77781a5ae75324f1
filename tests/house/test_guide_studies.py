"""The studies, observers and numbers of the guide are what its pages say: they are run as they stand there."""

import re
import tomllib

import numpy as np
import pytest
from documents import PAGES, blocks

import pcbench
from pcbench import checking
from pcbench.dataset.seed_ranges import seed_range
from pcbench.gains import tune
from pcbench.scenarios import SCENARIOS
from pcbench.statistics import number_format
from pcbench.study import grid, parse

OBSERVERS_PAGE = PAGES["wrong_assumptions.md"]


@pytest.mark.nightly
def test_the_study_runs_as_written(tmp_path):
    (text,) = [b for b in blocks("toml") if "noise-map" in b]
    path = tmp_path / "noise-map.toml"
    path.write_text(text)
    found = parse.load(str(path))
    assert len(pcbench.run(str(path), seeds=2).stats.cell.unique()) == 16
    assert len(grid.cells(found, "cart/gaussian")) == 16
    assert tomllib.loads(text)["name"] == "noise-map"


def test_the_slower_camera_is_a_scenario_as_written(tmp_path):
    (text,) = [b for b in blocks("toml") if "slower-camera" in b]
    (cell,) = grid.cells_of(parse.parse(tomllib.loads(text), "guide"))
    measured, base = cell.scenario.sampling, SCENARIOS["cart/white"]
    assert (cell.scenario.name, measured.sampling_period, measured.delay) == ("slower-camera", (0.4,), (0.6,))
    assert (measured.noise_std, cell.scenario.plant) == (base.sampling.noise_std, base.plant)


@pytest.mark.nightly
def test_the_motor_runs_as_written_and_is_what_the_text_says(tmp_path):
    (text,) = blocks("toml", "linear_plant.md")
    path = tmp_path / "motor.toml"
    path.write_text(text)
    result = pcbench.run(str(path))
    wide = result.stats.set_index(["signal", "metric", "plant.input_bias", "observer"])["mean"]
    rms, least = (
        wide["angle", "steady_pooled_rmse"],
        wide.xs("rms_efficiency", level="metric").xs("kf", level="observer"),
    )
    assert rms[0.2, "kf"] / rms[0.2, "kf-load"] == pytest.approx(1.7, abs=0.05)
    assert rms[0.0, "kf-load"] / rms[0.0, "kf"] == pytest.approx(1.01, abs=0.01)
    np.testing.assert_allclose(least, 1.0, atol=0.02)  # of three signals: the bound is attained
    lost = result.pairs.query("metric == 'steady_rmse' and observer_a == 'kf' and observer_b == 'model-only'")
    lost = lost[lost["plant.input_bias"] == 0.0]
    assert len(lost) == 3
    assert (lost.mean_diff < 0).all()
    assert (lost.p_holm < 0.05).all(), "the model alone loses on every signal"


@pytest.mark.nightly
def test_there_is_a_longest_period_of_the_motors_camera_that_suffices(tmp_path):
    """The error grows with the period, surely, and passes what is asked for between two of them."""
    (text,) = blocks("toml", "linear_plant.md")
    axes = {"plant.input_bias": [0.0], "sampling_period": [[p, 0.01] for p in (0.04, 0.08, 0.16)]}
    stats = pcbench.run(tomllib.loads(text) | {"observers": ["kf"]}, axes=axes).stats
    rows = stats[(stats.signal == "angle") & (stats.metric == "steady_pooled_rmse")]
    assert (rows.ci_high.to_numpy()[:-1] < rows.ci_low.to_numpy()[1:]).all()
    assert rows.ci_high.iloc[1] < 0.014 < rows.ci_low.iloc[2]


@pytest.mark.nightly
def test_the_longest_period_of_the_motors_camera_is_found(tmp_path):
    path = tmp_path / "motor.toml"
    path.write_text(*blocks("toml", "linear_plant.md"))
    how = {"signal": "angle", "metric": "steady_pooled_rmse", "overrides": ["axes.plant.input_bias=0.0"]}
    found = pcbench.find_limit(path, axis="sampling_period[0]", threshold=0.014, between=(0.04, 0.32), **how)
    found = found.set_index("observer")
    assert 0.08 <= found.largest["kf"] < found.exceeds["kf"] <= 0.16
    assert found.answer["model-only"] == "no value"


@pytest.mark.nightly
def test_the_answer_shown_is_the_one_that_comes_out(tmp_path):
    found = pcbench.find_limit("cart/white", axis="sampling_period", threshold=0.15, observers=["kf", "pccebo"])
    (shown,) = [b for b in blocks("text") if b.startswith("cart/white: steady_rmse of position below")]
    for row, line in zip(found.to_dict("records"), shown.split("─\n")[1].splitlines(), strict=True):
        ends = [number_format.estimate(row["exceeds_mean"], row["exceeds_ci_low"], row["exceeds_ci_high"])]
        ends += [f" {row['exceeds']:g} "] + ([f" {row['largest']:g} "] if row["answer"] == "up to" else [" none "])
        assert all(end in line for end in ends)
        assert line.split()[0] == row["observer"]


@pytest.mark.nightly
def test_tuning_finds_the_motors_noise_by_channel_from_ten_times_wrong(tmp_path):
    """The two ratios of R to the current's Q, within 10 %: on 128 runs they scatter by a third of that."""
    (text,) = blocks("toml", "linear_plant.md")
    start = {"R": [4e-5, 2.5], "Q": [0.0, 0.0, 2.5e-4]}
    raw = tomllib.loads(text) | {"observers": ["kf"], "axes": {}, "options": {"kf": start}}
    made = tune.tune(
        raw,
        "kf",
        budget=40,
        objective="steady_pooled_rmse",
        signal="speed",
        only=["R", "Q"],
        training_seeds=seed_range(3_000_000_000, 128),
    )
    found = np.array(made.best["R"]) / made.best["Q"][2]
    np.testing.assert_allclose(found, np.array([0.002, 0.5]) ** 2 / 0.05**2, rtol=0.1)
    assert made.judgements[1].difference < -10 * made.judgements[1].difference_se


@pytest.mark.nightly
def test_the_pushed_cart_runs_as_written_and_its_push_is_found(tmp_path):
    (text,) = [b for b in blocks("toml") if '"pushed"' in b]
    path = tmp_path / "pushed.toml"
    path.write_text(text)
    stats = pcbench.run(str(path), seeds=8).stats.query("metric == 'steady_pooled_rmse'")
    rms = stats.set_index(["signal", "observer"])["mean"]
    assert set(rms["input"].index) == {"smo", "pio", "kf"}
    assert max(rms["input"]) < 0.5  # of a push of size 1
    assert rms["position"].idxmax() == "model-only"


@pytest.mark.nightly
def test_a_plant_of_python_control_runs(capsys):
    (example,) = [b for b in blocks("python") if b.startswith("import control")]
    exec(compile(example, "your_own_plant.md", "exec"), {})
    assert "pccebo" in capsys.readouterr().out


@pytest.mark.ci
def test_the_observer_example_is_short_and_knows_its_schedule(tmp_path, monkeypatch):
    """At most 25 lines of code, it passes every check, and it runs from the study file that is shown."""
    monkeypatch.chdir(tmp_path)
    example = blocks("python", "your_own_observer.md")[0]
    assert len([line for line in example.splitlines() if line.strip()]) <= 25
    (tmp_path / "mine.py").write_text(example)
    found = checking.check("mine.py:nudge", options={"share": 0.2}).findings
    assert [f.check for f in found if f.verdict != "passes"] == []
    (study,) = [b for b in blocks("toml") if 'use = "mine.py:nudge"' in b]
    (tmp_path / "s.toml").write_text(study)
    result = pcbench.run("s.toml", seeds=8)
    assert list(dict.fromkeys(result.stats.observer)) == ["kf", "strong"]


ROW = re.compile(r"^\| .*? \| .*? \| (`.*?) \| `([a-z0-9/-]+)` (\w+) \[.*?\] \|$", re.M)


@pytest.mark.nightly
@pytest.mark.parametrize(("errors", "scenario", "signal"), ROW.findall(OBSERVERS_PAGE))
def test_the_decision_table_is_what_comes_out(errors, scenario, signal):
    said = {name: float(value) for name, value in re.findall(r"`([a-z-]+)` ([\d.]+)", errors)}
    stats = pcbench.run(scenario, observers=list(said), seeds=256).stats
    rms = stats[(stats.metric == "steady_rmse") & (stats.signal == signal)].set_index("observer")["mean"]
    for name, value in said.items():
        assert rms[name] == pytest.approx(value, rel=0.06, abs=1e-9), name
    assert list(said.values()) == sorted(said.values())


def test_the_decision_table_names_the_scenarios_it_is_drawn_from():
    assert len(ROW.findall(OBSERVERS_PAGE)) == 8


BELIEVED = re.compile(r"^\| `([a-z-]+)` \| ((?:[\d.]+ \| ){6}[\d.]+) \|$", re.M)


def test_the_table_of_assumptions_has_what_the_study_has():
    study = parse.grid_of("model-mismatch", {}, []).study
    assert [name for name, _ in BELIEVED.findall(OBSERVERS_PAGE)] == study.observers
    tables = {name: study.tables[name].as_table() for name in study.scenarios}
    late = [tables[f"delay-{which}"]["assumed_delay_error"] / 0.2 for which in ("over", "under")]
    assert late == pytest.approx([0.2, -0.2])
    assert tables["gain-off"]["parameters"]["b"] == pytest.approx(1.1 * 355)
    assert np.divide(
        tables["noise-under"]["assumed_process_std"], tables["as-assumed"]["process_std"]
    ) == pytest.approx(4)
    assert np.divide(tables["as-assumed"]["process_std"], tables["noise-over"]["assumed_process_std"]) == pytest.approx(
        4
    )
    assert tables["noise-over"]["options"]["kfbo"]["R"] == 16 * tables["as-assumed"]["options"]["kfbo"]["R"]


@pytest.mark.nightly
def test_the_table_of_beliefs_is_what_comes_out():
    """Every number within one of its standard errors (the draws are the same), and what the text says of them."""
    result = pcbench.run("model-mismatch")
    rows = result.stats.query("metric == 'steady_pooled_rmse' and signal == 'position'")
    wide = rows.set_index(["observer", "scenario"])
    rms = wide["mean"].unstack()
    for observer, numbers in BELIEVED.findall(OBSERVERS_PAGE):
        for scenario, said in zip(
            parse.grid_of("model-mismatch", {}, []).study.scenarios, numbers.split(" | "), strict=True
        ):
            one = wide.loc[observer, scenario]
            assert abs(one["mean"] - float(said)) < max(one["se"], 0.005 * one["mean"]), (observer, scenario)
    assert rms["as-assumed"].idxmin() == "kf"
    assert rms.loc["pccebo-riccati", "as-assumed"] / rms.loc["kf", "as-assumed"] < 1.01
    assert (rms.loc["pco"].drop("parameter_drift") < rms.loc["pi-pco"].drop("parameter_drift")).all()
    delayed = ["kf", "pccebo-riccati", "pccebo-loose", "pco", "pi-pco"]
    assert rms.loc[delayed, "parameter_drift"].idxmax() == "kf"
    same = result.pairs.query("metric == 'steady_rmse' and signal == 'position' and scenario == 'noise-over'")
    (pair,) = same[(same.observer_a == "kf") & (same.observer_b == "pco")].to_dict("records")
    assert pair["p_holm"] > 0.05
