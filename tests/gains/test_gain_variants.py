"""Studies whose gains come about in several ways: which versions there are, on which seeds, and what stands in the table."""

import json
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commands import call
from documents import PAGES
from interruptions import stop_tuning_at

import pcbench
from pcbench.dataset.study_diff import changes
from pcbench.errors import UserError
from pcbench.gains import gain_variants, tune
from pcbench.observers import OBSERVERS, entry_of
from pcbench.runtime import config
from pcbench.study import STUDIES, TUNINGS, observers_of, parse, serialize

PAGE = PAGES["wrong_assumptions.md"]
FAIR = {
    "name": "little",
    "scenarios": ["cart/gaussian"],
    "observers": ["pccebo", "model-only"],
    "seeds": 24,
    "options": {"scenario": {"random_initial_state": True}},
    "tuning": ["published", "design", "tuned"],
    "tune": {"objective": "steady_pooled_rmse", "budget": 3, "training": 16},
}


def prepare(**changes):
    with config.float64():
        return gain_variants.prepare(parse.grid_of(FAIR | changes, {}, []), None, False)


def test_paper_is_what_stands_there():
    grid = parse.grid_of(FAIR | {"tuning": "published"}, {}, [])
    assert gain_variants.prepare(grid, None, False) == (grid, [], None)


def test_two_versions_of_every_observer_that_has_a_design_of_its_own():
    names = ["pccebo", "kfbo", "pco", "pi-pco", "kf", "model-only"]
    made = prepare(
        observers=names, scenarios=["cart/white"], tuning=["published", "design"], options={"pco": {"decay": 0.1}}
    )
    labels = [v.label for v in made.versions]
    assert labels == [
        f"{o}-{t}" for o in names for t in ("published", "design") if t == "published" or entry_of(o).designed
    ]
    assert made.study.observers == labels
    assert made.study.tunings == ["published"]
    assert made.study.options["pco-published"] == {"Kp": -61.0, "decay": 0.1}
    assert made.study.options["pco-design"] == {"Kp": "lmi", "decay": 0.1}
    assert made.study.options["kfbo-design"]["R"] == "noise"
    assert made.study.options["model-only-published"] == {}


def test_a_design_alone_keeps_names_and_takes_any_scenarios():
    made = prepare(tuning="design", scenarios=["cart/white", "cart/variable"], observers=["pccebo", "pco", "kf"])
    assert made.study.observers == ["pccebo", "pco", "kf"]
    assert made.study.options["pccebo"] == {"gain": "riccati"}
    assert made.study.options["pco"] == {"Kp": "lmi"}
    assert "kf" not in made.study.options
    assert not made.versions


@pytest.mark.ci
def test_tuning_records_its_cell_and_what_it_found():
    made = prepare(tuning="tuned", axes={"noise_std": [0.3, 0.1]}, options={}, observers=["pccebo"])
    assert made.study.tuned.cell == {"noise_std": 0.3}
    (found,) = made.study.tuned.options.values()
    assert found
    assert all(made.study.options["pccebo"][name] == value for name, value in found.items())
    assert made.study.tuning_sentence == (
        "The gains of pccebo were tuned for steady_pooled_rmse of position in cart/gaussian at noise_std = 0.3. "
        "The other grid points use the same gains."
    )
    assert prepare(tuning="design").study.tuning_sentence is None


EVERY_CELL = {"axes": {"noise_std": [0.3, 0.1]}, "tune": FAIR["tune"] | {"cells": "all"}}


def mock_tuning(monkeypatch, without=()):
    """Stand in for tuning: R is 100 times the standard deviation of the noise; in cells `without`, no start works."""
    folders = []

    def found(study, observer, *, out, **_):
        (std,) = study.axes["noise_std"]
        folders.append(out)
        if std in without:
            raise tune.NoStart("none")
        return SimpleNamespace(kept_start="", best={"R": 100 * std})

    monkeypatch.setattr(tune, "tune", found)
    return folders


@pytest.mark.ci
def test_gains_are_tuned_in_every_cell(monkeypatch, tmp_path):
    """Each cell has its own options, whatever the order of the axes, and a study that was written reads them again."""
    folders = mock_tuning(monkeypatch)
    grid = parse.grid_of(FAIR | EVERY_CELL | {"observers": ["kf"], "tuning": ["published", "tuned"]}, {}, [])
    with config.float64():
        made = gain_variants.prepare(grid, tmp_path / "out", False)
    assert [c.options["kf-tuned"].R for c in made.grid.cells] == [30.0, 10.0]
    assert len({c.options_digests["kf-tuned"] for c in made.grid.cells}) == 2
    assert len({c.options_digests["kf-published"] for c in made.grid.cells}) == 1
    assert len(set(folders)) == 2
    assert made.study.tuning_sentence.endswith("in cart/gaussian, separately at each of 2 grid points.")
    written = tomllib.loads(serialize.to_toml(made.study, made.grid.cells))
    del written["resolved"]
    again = parse.grid_of(written | {"axes": {"noise_std": [0.1, 0.3]}}, {}, [])
    assert [c.options["kf-tuned"].R for c in again.cells] == [10.0, 30.0]
    assert serialize.digest(*parse.grid_of(written, {}, [])) == serialize.digest(*made.grid)
    with pytest.raises(UserError, match=r"no gains of kf-tuned at noise_std = 0\.2, .*; tune again"):
        parse.grid_of(written | {"axes": {"noise_std": [0.1, 0.2]}}, {}, [])
    other = tomllib.loads(serialize.to_toml(made.study, made.grid.cells))
    other["tuned"]["cells"][1]["options"]["kf-tuned"]["R"] = 11.0
    (changed,) = changes(serialize.resolve_study(*made.grid), other)
    assert changed == "options tuned at noise_std = 0.1.kf-tuned.R: 10.0 there, 11.0 here"


@pytest.mark.ci
def test_a_cell_that_cannot_be_tuned_keeps_its_start_and_says_so(monkeypatch):
    mock_tuning(monkeypatch, without=[0.1])
    made = prepare(**EVERY_CELL, observers=["kf"], tuning="tuned")
    assert made.grid.cells[0].options["kf"].R == 30.0
    assert made.grid.cells[1].options_digests != made.grid.cells[0].options_digests
    assert made.versions[0].note == "at noise_std = 0.1: the start has no finite value on the training runs"


@pytest.mark.nightly
def test_a_study_tuned_in_every_cell_is_a_dataset_like_any_other(tmp_path):
    """Each cell is tuned as a study of that cell alone is, and the dataset is verified, resumed and merged."""
    study = FAIR | {"observers": ["pccebo"], "tuning": "tuned", "seeds": 8}
    alone = [pcbench.run(study | {"axes": {"noise_std": [std]}}) for std in (0.3, 0.1)]
    whole = pcbench.run(study | EVERY_CELL, out=tmp_path / "out")
    means = [r.stats.query("metric == 'rmse' and signal == 'position'")["mean"].to_list() for r in (*alone, whole)]
    assert means[0] + means[1] == means[2]
    assert pcbench.run(study | EVERY_CELL, out=tmp_path / "out").cost.runs == 0
    done = call("verify", str(tmp_path / "out"), "--all")
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("observer", [o for o in OBSERVERS if entry_of(o).designed])
def test_a_design_of_its_own_is_made_of_options_that_there_are(observer):
    assert entry_of(observer).options.model_validate(dict(entry_of(observer).designed))


def test_kfbo_by_design_has_the_noise_of_the_scenario():
    with config.float64():
        numbers = pcbench.design("cart/white", "kfbo", overrides=["options.kfbo.R=noise"]).certificate.numbers
    assert numbers["R"] == pytest.approx(0.07, rel=1e-12)  # power: variance of a sample times the period


MISTAKES = [
    ({"tuning": "luck"}, "tuning: got 'luck', expected 'published', 'design', 'tuned', or a list of them"),
    ({"tuning": ["published", "published"]}, "expected each of them once"),
    ({"tuning": []}, "or a list of them"),
    ({"scenarios": ["cart/white", "cart/gaussian"]}, "for 2 scenarios, expected one"),
    ({"first_seed": 3_000_000_010}, "on which gains are tuned"),
    ({"tune": {"objective": "beauty"}}, "'beauty' is no metric to tune for"),
    ({"tune": {"signal": "speed"}}, "'speed' is no signal"),
    ({"tune": {"budget": 0}}, "tune.budget: got 0"),
    ({"tune": {"exact_objective": True, "objective": "rmse"}}, "rmse, which has no exact value"),
    ({"tune": {"effort": 3}}, "tune: 'effort' is no key here"),
    ({"tune": {"cells": "some"}}, "tune.cells: got 'some', expected 'first' or 'all'"),
    ({"tune": {"only": []}}, "tune.only: got [], expected a list of at least 1"),
    ({"tune": {"only": ["Qq"]}}, "tune.only: 'Qq' is no option that an observer of the study tunes"),
    (
        {"scenarios": None, "scenario": {"base": "cart/gaussian", "options": {"pccebo-tuned": {"gain": "lmi"}}}},
        "got pccebo-tuned for gains of pccebo, expected a label that little has no options for",
    ),
]


@pytest.mark.parametrize(("changes", "sentence"), MISTAKES, ids=[s for _, s in MISTAKES])
def test_mistakes_are_one_sentence_and_write_nothing(changes, sentence, tmp_path):
    with pytest.raises(UserError) as caught:
        pcbench.run(FAIR | changes, out=tmp_path / "out")
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.ci
def test_only_what_is_named_is_tuned_of_each_observer_that_has_it(monkeypatch):
    """Of kf R, of pccebo nothing: it has no R, so there is no tuned version of it."""
    asked = []

    def without_start(*_, only, **__):
        asked.append(only)
        raise tune.NoStart("none")

    monkeypatch.setattr(tune, "tune", without_start)
    made = prepare(observers=["pccebo", "kf"], seeds=2, tune=FAIR["tune"] | {"only": ["R"], "training": 2})
    assert asked == [["R"]]
    assert [v.label for v in made.versions if v.tuning == "tuned"] == ["kf-tuned"]


def test_a_folder_that_is_another_studys_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match=r"contains other files \(notes.txt\)"):
        pcbench.run(FAIR, out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.nightly
def test_versions_are_compared_on_two_ranges_of_seeds_and_against_the_bound(tmp_path):
    result = pcbench.run(FAIR | {"tuning": ["published", "design"]}, out=tmp_path / "out")
    fair = result.fair.set_index("label")
    assert list(fair.index) == ["pccebo-published", "pccebo-design", "model-only-published"]
    metric = "signal == 'position' and metric == 'steady_pooled_rmse'"
    held = result.stats.query(metric).set_index("observer")["mean"]
    there = pd.read_parquet(tmp_path / "out" / "training" / "stats.parquet")
    trained = there.query(metric).set_index("observer")["mean"]
    for label in fair.index:
        assert fair.held_out[label] == held[label]
        assert fair.training[label] == trained[label]
        assert fair.gap[label] == held[label] - trained[label]
    runs = pd.read_parquet(tmp_path / "out" / "training" / "runs")
    assert set(runs.seed) == set(range(tune.TRAINING[0], tune.TRAINING[0] + 16))
    assert fair.rms_efficiency["pccebo-published"] > 3 * fair.rms_efficiency["model-only-published"] > 0
    stored = pd.read_parquet(tmp_path / "out" / "fair.parquet")
    pd.testing.assert_frame_equal(stored, result.fair)


@pytest.mark.nightly
def test_what_is_tuned_exactly_is_held_against_its_expected_value(tmp_path):
    study = FAIR | {"tuning": ["published", "tuned"], "tune": {"budget": 4, "exact_objective": True}}
    result = pcbench.run(study, out=tmp_path / "out")
    assert (result.fair.metric == "pooled_rmse").all()
    assert not result.fair.training_se.any()
    assert not (tmp_path / "out" / "training" / "runs").exists()
    fair = result.fair.set_index("label")
    assert fair.training["pccebo-tuned"] < fair.training["pccebo-published"]
    assert (fair.gap.abs() < 4 * fair.gap_se).all()


@pytest.mark.nightly
def test_a_fair_study_goes_on_where_it_was_stopped_and_is_a_dataset_like_any_other(tmp_path, monkeypatch):
    whole = pcbench.run(FAIR, out=tmp_path / "whole")
    (tuned,) = whole.fair[whole.fair.tuning == "tuned"].to_dict("records")
    assert tuned["observer"] == "pccebo"
    count = stop_tuning_at(2, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        pcbench.run(FAIR, out=tmp_path / "out")
    assert not (tmp_path / "out" / "study.toml").exists()
    again = pcbench.run(FAIR, out=tmp_path / "out")
    pd.testing.assert_frame_equal(again.fair, whole.fair)
    counted = count[0]
    once_more = pcbench.run(FAIR, out=tmp_path / "out")
    assert count[0] == counted, "a finished tuning is read, not done again"
    assert once_more.cost.runs == 0
    pd.testing.assert_frame_equal(once_more.fair, whole.fair)
    done = call("verify", str(tmp_path / "out"), "--all")
    assert done.returncode == 0, done.stdout
    with pytest.raises(UserError, match="another study"):
        pcbench.run(FAIR | {"tune": FAIR["tune"] | {"budget": 4}}, out=tmp_path / "out")
    overwrite = pcbench.run(FAIR | {"tune": FAIR["tune"] | {"budget": 4}}, out=tmp_path / "out", overwrite=True)
    assert set(overwrite.fair.tuning) == set(TUNINGS)


@pytest.mark.nightly
def test_the_command_prints_all_versions_and_their_gap(tmp_path):
    words = ["--set", "tune.budget=2", "--seeds", "16", "--observers", "pccebo,kf"]
    done = call("run", "equal-tuning", *words, "--out", str(tmp_path / "out"))
    assert "efficiency" in done.stdout, done.stderr
    assert [w for w in ("published", "design", "tuned", "held out", "gap") if w not in done.stdout] == [], done.stdout
    said = json.loads(call("run", "equal-tuning", *words, "--out", str(tmp_path / "out"), "--json").stdout)
    assert {row["tuning"] for row in said["fair"]} == set(TUNINGS)


@pytest.mark.nightly
def test_nothing_beats_the_bound_and_tuned_is_not_worse_than_its_start():
    """The study as it stands: every version, on 1024 runs that none was tuned on."""
    study = STUDIES["equal-tuning"]
    table = pcbench.run("equal-tuning").fair
    assert set(table.observer) == set(observers_of(study, "cart/gaussian"))
    assert (table.efficiency_low < 1).all()
    by = table.set_index(["observer", "tuning"])
    assert by.rms_efficiency["kf", "published"] > 0.95
    for observer in ("pccebo", "kfbo", "kf"):
        start = min(by.held_out[observer][t] for t in ("published", "design") if t in by.held_out[observer])
        se = np.hypot(by.held_out_se[observer, "tuned"], by.held_out_se[observer, "published"])
        assert by.held_out[observer, "tuned"] <= start + 2 * se
    rows = re.findall(
        r"^\| (as printed|by design|tuned) \| (\d+) % \| (\d+) % \| (?:(\d+) %|as printed) \|$", PAGE, re.M
    )
    assert len(rows) == 3
    for (_, *said), tuning in zip(rows, TUNINGS, strict=True):
        for observer, share in zip(("pccebo", "kfbo", "kf"), said, strict=True):
            assert not share or abs(100 * by.rms_efficiency[observer, tuning] - int(share)) < 1, (observer, tuning)
    assert (100 * (by.efficiency_high - by.efficiency_low) / 2).max() < 4
    printed, tuned = (by.held_out["kfbo", t] / by.held_out["pccebo", t] for t in ("published", "tuned"))
    assert (round(printed, 1), round(tuned, 1)) == (2.6, 2.2)
