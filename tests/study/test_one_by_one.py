"""A study that varies its axes one by one; how much of each fault is borne; and the guide's figures of `faults`."""

import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from documents import PAGES, code_blocks
from honest import STUDY

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import fault_tolerance
from pcbench.report import captions, figures
from pcbench.study import STUDIES, parse, serialize

pytestmark = pytest.mark.usefixtures("in_a_hurry")
AXES = {"outlier_probability": [0.0, 0.1, 0.2], "noise_std": [0.3], "loss": [0.0, 0.5]}
EACH = STUDY | {"observers": ["kf", "model-only"], "options": {}, "seeds": 4, "axes": AXES, "vary": "one-at-a-time"}
LABELS = ("kf", "kf-gate", "kf-huber", "pccebo")


def test_each_axis_leaves_its_first_value_while_the_others_stand_at_theirs():
    found = [tuple(c.values[name] for name in AXES) for c in parse.grid_of(EACH, {}, []).cells]
    assert found == [(0.0, 0.3, 0.0), (0.1, 0.3, 0.0), (0.2, 0.3, 0.0), (0.0, 0.3, 0.5)]
    assert len(parse.grid_of(EACH | {"vary": "all"}, {}, []).cells) == 6


def test_a_file_says_so_only_where_it_is_so():
    each, every = (parse.grid_of(EACH | {"vary": how}, {}, []).study for how in ("one-at-a-time", "all"))
    assert serialize.as_dict(each)["vary"] == "one-at-a-time"
    assert "vary" not in serialize.as_dict(every)


def test_it_is_all_or_each():
    with pytest.raises(UserError, match=r"vary: got 'one'.*'all' or 'one-at-a-time'") as caught:
        parse.grid_of(EACH | {"vary": "one"}, {}, [])
    assert "\n" not in str(caught.value)


def test_what_is_borne_is_where_the_model_alone_becomes_better():
    rows = [
        ("a", 0.0, "x", 0.5), ("a", 1.0, "x", 0.75), ("a", 3.0, "x", 1.25),
        ("a", 0.0, "y", 0.5), ("a", 1.0, "y", 0.6), ("a", 3.0, "y", np.nan),
        ("b", 1.0, "x", 0.5), ("b", 0.2, "x", 3.0), ("b", 4.0, "x", 0.9),
        ("b", 1.0, "y", 1.5), ("b", 0.2, "y", 0.9), ("b", 4.0, "y", 0.9),
    ]  # fmt: skip
    found = fault_tolerance.tolerances(pd.DataFrame(rows, columns=["axis", "value", "observer", "part"]))
    each = {
        (r.axis, r.observer): found[(found.axis == r.axis) & (found.observer == r.observer)].most.tolist()
        for r in found.itertuples()
    }
    assert each["a", "x"] == [pytest.approx(2.0)]
    assert each["a", "y"] == [1.0]
    assert each["b", "x"] == [float("inf"), pytest.approx(1.0 - 0.8 * 0.5 / 2.5)]
    assert np.isnan(each["b", "y"]).all()
    assert captions.tolerances(found).startswith(
        "Better than model-only: a: x up to 2, y up to 1; b: x everywhere, x up to 0.84"
    )


@pytest.mark.nightly
def test_the_picture_has_a_panel_for_each_axis_and_the_report_no_map():
    axes = {"noise_std": [0.3, 0.6, 0.9], "process_std": [[0.02, 0.1]], "assumed_noise_scale": [1.0, 2.0]}
    result = pcbench.run(EACH | {"axes": axes})
    parts = fault_tolerance.ratio_to_model_only(result, "lti", "a", "steady_rmse")
    stats = result.stats[(result.stats.signal == "a") & (result.stats.metric == "steady_rmse")].set_index(
        ["observer", "cell"]
    )["mean"]
    np.testing.assert_allclose(
        parts.part, [stats["kf", c] / stats["model-only", c] for c in (0, 1, 2, 0, 3)], rtol=1e-12
    )
    assert len(plots.bearing(result).axes) == 2
    where = figures.ScenarioData(result, "lti", 0, None, None, figures.DEFAULTS)
    names = {picture.name for picture in figures.of_signal(where, "a")}
    assert {f"{EACH['name']}-a-{each}" for each in ("bearing", "over-noise_std", "over-assumed_noise_scale")} <= names
    assert not {f"{EACH['name']}-a-{each}" for each in ("winners", "map")} & names
    assert figures.cell_of(result, "lti", figures.DEFAULTS) == 0
    others = SimpleNamespace(study=result.study.model_copy(update={"vary": "all"}), **{
        name: getattr(result, name) for name in ("stats", "stats_of", "scenarios", "signals", "ranks")})  # fmt: skip
    with pytest.raises(UserError, match='got vary = "all"'):
        plots.bearing(others)


def test_losses_in_a_row_are_no_fault_that_stands_alone():
    """Which is why `mean_burst_length` is not among those of `measurement-errors`."""
    axes = {**STUDIES["measurement-errors"].axes, "mean_burst_length": [0.0, 5.0]}
    with pytest.raises(
        UserError, match="got mean_burst_length = 5 in cart/gaussian with a loss of 0, expected a loss between 0 and 1"
    ):
        parse.grid_of("measurement-errors", {"axes": axes}, [])


@pytest.mark.nightly
def test_the_guides_figures_of_losses_in_a_row_are_what_comes_out():
    section = PAGES["measurement_error_findings.md"].split("## Bursts of lost samples")[1]
    (text,) = (b.text for b in code_blocks("measurement_errors.md") if b.title == "bursts.toml")
    study = tomllib.loads(text) | {"seeds": 256}
    stats = pcbench.run(study).stats
    mean = stats[stats.signal == "position"].set_index(["observer", "metric", "mean_burst_length"])["mean"]
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", section, re.M)
    assert [float(burst) for burst, _ in rows] == study["axes"]["mean_burst_length"]
    for burst, said in rows:
        *errors, nees = map(float, said.split(" | "))
        np.testing.assert_allclose([mean[o, "steady_rmse", float(burst)] for o in LABELS], errors, rtol=0.01)
        assert mean["kf", "nees", float(burst)] == pytest.approx(nees, rel=0.01)
        assert mean["model-only", "steady_rmse", float(burst)] == pytest.approx(4.16, rel=0.01)


@pytest.mark.nightly
def test_the_guides_figures_of_faults_are_what_comes_out():
    """One run of the whole study: three tables."""
    result, page = pcbench.run("measurement-errors"), PAGES["measurement_error_findings.md"]
    stats = result.stats[result.stats.signal == "position"]
    mean = stats.set_index(["observer", "metric", "cell"])["mean"]
    cells = stats.drop_duplicates("cell").set_index("cell")
    usual = cells.loc[0]

    def at(axis, value):
        alone = cells[axis] == value if value != usual[axis] else cells.index == 0
        (cell,) = cells.index[alone]
        return cell

    rows = re.findall(r"^\| `([\w-]+)`(?: with `(\w+) = [\d.]+`)? \| ([\d.]+ \|.*) \|$", page, re.M)
    assert len(rows) == 5
    for name, option, said in rows:
        label, (*errors, nees) = f"{name}-{option}" if option else name, said.split(" |")
        found = [mean[label, "steady_rmse", at("outlier_probability", p)] for p in (0.0, 0.01, 0.05, 0.2)]
        np.testing.assert_allclose(found, [float(e) for e in errors], rtol=0.01)
        if nees.strip():
            assert mean[label, "nees", at("outlier_probability", 0.05)] == pytest.approx(float(nees), rel=0.01)
    page = page.split("## Bursts of lost samples")[0]
    rows = re.findall(r"^\| (none|\w+ = [\d.-]+) \| (.*) \|$", page, re.M)
    assert len(rows) == 16
    for name, said in rows:
        cell = at(*((n, float(v)) for n, v in [name.split(" = ")]).__next__()) if "=" in name else 0
        *errors, nees = map(float, said.split(" | "))
        np.testing.assert_allclose([mean[o, "steady_rmse", cell] for o in LABELS], errors, rtol=0.01)
        assert mean["kf", "nees", cell] == pytest.approx(nees, rel=0.01)
    found = fault_tolerance.tolerances(
        fault_tolerance.ratio_to_model_only(result, "cart/gaussian", "position", "steady_rmse")
    )
    bounded = found[np.isfinite(found.most)].set_index(["axis", "observer"]).most
    rows = re.findall(r"^\| `(\w+)` \[\w+\] \| (.*) \|$", page, re.M)
    told = {
        (axis, o): float(v) for axis, said in rows for o, v in zip(LABELS, said.split(" | "), strict=True) if v != "all"
    }
    assert set(told) == set(bounded.index)
    for key, value in told.items():
        assert bounded[key] == pytest.approx(value, rel=0.01)
