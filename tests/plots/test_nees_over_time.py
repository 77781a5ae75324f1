"""How wrong observers believe to be, over time: the numbers of runs and traces, and pictures that show them."""

import numpy as np
import pytest
from honest import STUDY

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import one_run
from pcbench.report import captions, figures
from pcbench.statistics.consistency import band


@pytest.fixture(scope="module")
def result(in_a_hurry):
    return pcbench.run(STUDY)


@pytest.fixture(scope="module")
def run(result):
    return one_run.frame_of(result.study, "lti", None)


@pytest.mark.ci
def test_over_time_it_is_the_mean_of_the_runs_and_the_band_of_so_many(result, run):
    last = run[np.isclose(run.t, 5.9)].set_index(["series", "kind"]).value
    for observer in ("kf", "kf-bold"):
        runs = result.runs[(result.runs.observer == observer) & (result.runs.signal == "a")]
        assert last[observer, "nees"] == pytest.approx(runs.nees.mean(), rel=1e-9)
        assert (last[observer, "nees_low"], last[observer, "nees_high"]) == pytest.approx(band(2 * one_run.RUNS))
    assert ("model-only", "nees") not in last.index


@pytest.mark.ci
def test_the_standard_deviation_is_that_of_the_trace(run):
    trace = pcbench.simulate(STUDY, ["kf-bold"])
    mine = run[(run.series == "kf-bold") & (run.kind == "sigma")].set_index("signal").value
    for signal in "ab":
        np.testing.assert_allclose(mine[signal], trace[f"kf-bold.{signal}.sigma"], rtol=1e-9)


@pytest.mark.ci
def test_the_picture_has_a_line_for_each_that_says_so_and_the_band(result, run):
    (ax,) = plots.nees(result).axes
    lines = {line.get_label(): line.get_ydata() for line in ax.get_lines()}
    assert {"kf", "kf-bold"} < set(lines)
    assert "model-only" not in lines
    mine = run[(run.series == "kf") & (run.kind == "nees")]
    np.testing.assert_allclose(lines["kf"], mine.value)
    (shaded,) = ax.collections
    low, high = shaded.get_paths()[0].get_extents().intervaly
    ends = run[run.kind.isin(["nees_low", "nees_high"])].groupby("kind").value
    assert (low, high) == pytest.approx((ends.min()["nees_low"], ends.max()["nees_high"]))


@pytest.mark.ci
def test_errors_in_time_stand_between_three_standard_deviations(result, run):
    figure = plots.time(result, signal="a")
    below = figure.axes[1]
    sigma = run[(run.series == "kf") & (run.kind == "sigma") & (run.signal == "a")].value.to_numpy()
    drawn = [np.asarray(line.get_ydata()) for line in below.get_lines()]
    for side in (-3, 3):
        assert any(len(y) == len(sigma) and np.allclose(y, side * sigma) for y in drawn)
    assert "three times the standard deviation" in captions.time(run[run.signal == "a"], "", figure)[1]


@pytest.mark.ci
def test_the_report_has_it_where_somebody_says_how_wrong_it_is(result, run):
    here = figures.ScenarioData(result, "lti", 0, run, None, figures.DEFAULTS)
    found = {p.name: p for p in figures.of_all_signals(here)}
    assert "kf-bold" in found[f"{result.study.name}-nees"].text
    silent = here._replace(run=run[~run.kind.str.startswith("nees")])
    assert f"{result.study.name}-nees" not in {p.name for p in figures.of_all_signals(silent)}


@pytest.mark.ci
def test_where_nobody_says_so_there_is_no_picture_but_a_sentence(result, run, monkeypatch):
    monkeypatch.setattr(one_run, "frame_of", lambda *_: run[~run.kind.str.startswith("nees")])
    with pytest.raises(UserError, match="expected consistency = true") as caught:
        plots.nees(result)
    assert "\n" not in str(caught.value)
