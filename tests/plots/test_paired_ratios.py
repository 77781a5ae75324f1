"""Forest plot of paired ratios: the numbers are those of an independent computation, and the figure shows them."""

import numpy as np
import pytest
from matplotlib.text import Text
from reference import statistics as reference

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.paired_ratios import ratios_of
from pcbench.report import captions

OBSERVERS = ["pccebo", "kfbo", "kf", "kf-twin"]
AT = {"noise_std": [0.1, 0.5]}
STUDY = {"name": "forest", "scenarios": ["cart/white"], "observers": OBSERVERS, "seeds": 12, "options": {"kf-twin": {}}}


@pytest.fixture(scope="module")
def result():
    return pcbench.run(STUDY | {"axes": AT})


def values(result, cell, observer, column, seeds=range(12)):
    rows = result.runs.query("signal == 'position' and cell == @cell and observer == @observer").sort_values("seed")
    return rows[rows.seed.isin(seeds)][column].to_numpy()


def require_equal(rows, best, known):
    """Compare each row with a ratio of the reference."""
    for row in rows[rows.observer != best].to_dict("records"):
        expected = known(row["observer"])
        assert row["ratio"] == pytest.approx(expected["mean"], rel=1e-10)
        assert row["n"] == expected["n"]
        for end in ("ci_low", "ci_high"):
            assert row[end] == pytest.approx(expected[end], rel=1e-10)


@pytest.mark.parametrize("metric", ["steady_rmse", "mae"])
@pytest.mark.parametrize("cell", [0, 1])
def test_ratios_equal_independent_computation_from_the_runs(result, metric, cell):
    found = ratios_of(result, metric=metric, cell=cell)
    means = {o: values(result, cell, o, metric).mean() for o in OBSERVERS}
    assert list(found.rows.observer) == sorted(means, key=lambda o: (means[o], OBSERVERS.index(o)))
    assert found.value == pytest.approx(min(means.values()), rel=1e-12)
    best = values(result, cell, found.best, metric)
    require_equal(found.rows, found.best, lambda o: reference.ratio(values(result, cell, o, metric), best))


def test_ratio_of_pooled_metric_is_root_of_the_ratio_of_mean_squares(result):
    found = ratios_of(result, metric="pooled_rmse", cell=1)
    best = values(result, 1, found.best, "mse")

    def root(observer):
        squares = reference.ratio(values(result, 1, observer, "mse"), best)
        return {k: v if k == "n" else np.sqrt(v) for k, v in squares.items()}

    require_equal(found.rows, found.best, root)


def test_ratio_is_over_runs_in_which_neither_observer_diverged(result, monkeypatch):
    whole = result.runs_of

    def lossy(*given):
        runs = whole(*given)
        lost = ((runs.observer == "pccebo") & (runs.seed < 3)) | ((runs.observer == "kf") & (runs.seed == 7))
        return runs.assign(diverged=lost)

    monkeypatch.setattr(result, "runs_of", lossy)
    found, kept = ratios_of(result), {"pccebo": {*range(3, 12)} - {7}}
    assert found.best == "kf"

    def known(observer):
        seeds = kept.get(observer, {*range(12)} - {7})
        return reference.ratio(*(values(result, 0, o, "steady_rmse", seeds) for o in (observer, "kf")))

    require_equal(found.rows, "kf", known)


@pytest.mark.parametrize("cell", [0, 1])
def test_figure_shows_ratios_intervals_p_values_and_the_kalman_bound(result, cell):
    found, (ax,) = ratios_of(result, cell=cell), plots.ratios(result, cell=cell).axes
    names = [t.get_text() for t in ax.get_yticklabels()]
    assert names == [*found.rows.observer, "Kalman bound"]
    rows = found.rows.set_index("observer")
    drawn = [line for line in ax.get_lines() if line.get_linestyle() == "None"]
    np.testing.assert_array_equal([line.get_xdata()[0] for line in drawn[: len(rows)]], rows.ratio)
    bars = np.concatenate([np.array(c.get_segments())[:, :, 0] for c in ax.collections])
    np.testing.assert_array_equal(bars[1 : len(rows)], rows[["ci_low", "ci_high"]][1:])
    stats = result.stats.query("metric == 'rms_efficiency' and signal == 'position' and cell == @cell")
    bound = stats[stats.observer == found.best].iloc[0]
    np.testing.assert_array_equal(bars[-1], bound[["ci_low", "ci_high"]].astype(float))
    low, high = ax.get_xlim()
    assert low < np.nanmin(bars) <= np.nanmax(bars) < high
    for zone, half in zip(ax.patches, np.sqrt(rows.ci_high / rows.ci_low)[rows.ci_high > rows.ci_low], strict=True):
        assert [zone.get_x(), zone.get_x() + zone.get_width()] == pytest.approx([1 / half, half])
    pairs = result.pairs.query("metric == 'steady_rmse' and signal == 'position' and cell == @cell")
    words = dict(zip(names, [t.get_text() for t in ax.texts], strict=False))
    assert words[found.best] == "best"
    assert words["kf-twin" if found.best == "kf" else "kf"] == "equal"
    for observer in ("pccebo", "kfbo"):
        (p,) = pairs[(pairs.observer_a == observer) & (pairs.observer_b == found.best)].p_holm
        assert words[observer] == ("p < 0.001" if p < 1e-3 else f"p = {p:.2g}")
    said = " ".join(t.get_text().replace("\n", " ") for t in plots.ratios(result, cell=cell).findobj(Text))
    for part in ("12 runs", "95 % paired intervals", "paired t-test (Holm)", "[m]"):
        assert part in said


def test_hollow_markers_are_those_that_are_not_significant(result):
    """And the caption names the others."""
    found, (ax,) = ratios_of(result), plots.ratios(result).axes
    markers = [line for line in ax.get_lines() if line.get_linestyle() == "None"][: len(OBSERVERS)]
    hollow = {o for o, line in zip(found.rows.observer, markers, strict=True) if line.get_mfc() == "white"}
    stood = frames.standings(result).iloc[0]
    assert hollow == set(stood.leaders) - {found.best} == {"kf-twin"}
    assert captions.best(found) == (
        "kf has the least error, and pccebo and kfbo are significantly worse, kf-twin is not "
        "(12 runs, 95 % paired intervals, paired t-test with Holm's correction at 5 %)."
    )
    assert "kf-twin 1 (1 to 1), equal" in captions.ratios(found)


@pytest.mark.ci
def test_exact_ratios_have_no_interval():
    exact = pcbench.run(STUDY | {"evaluation": "exact", "observers": ["kf", "kfbo"], "options": {}})
    found = ratios_of(exact)
    means = exact.stats.query("metric == 'steady_pooled_rmse' and signal == 'position'").set_index("observer")["mean"]
    assert found.exact
    (row,) = found.rows[found.rows.observer == "kfbo"].to_dict("records")
    assert row["ratio"] == row["ci_low"] == row["ci_high"] == means["kfbo"] / means["kf"]
    (ax,) = plots.ratios(exact).axes
    assert [t.get_text() for t in ax.texts] == ["best", "exact"]
    assert not ax.patches


@pytest.mark.ci
def test_without_ratio_there_is_no_figure():
    """Nothing is divided by an error of 0, and one observer is compared with nobody."""
    for change in ({"scenarios": ["cart/nominal"]}, {"observers": ["kf"], "options": {}}):
        result = pcbench.run(STUDY | {"seeds": 2} | change)
        assert ratios_of(result) is None
        with pytest.raises(UserError, match="expected two observers"):
            plots.ratios(result)


def test_label_below_narrow_axes_stays_in_the_figure():
    """The name of the best was cut off at the right of reports, as the axes lie left of the p-values."""
    best = "kf-with-a-name-of-many-letters"
    result = pcbench.run(STUDY | {"observers": [best, "pccebo"], "options": {best: {}}, "seeds": 3})
    figure = plots.ratios(result)
    (ax,) = figure.axes
    assert best in ax.get_xlabel()
    box = ax.xaxis.label.get_window_extent()
    assert 0 < box.x0 < box.x1 < figure.bbox.width
