"""Figures of a result: they show its numbers, with units, and say who wins only where that is sure."""

from copy import copy
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy import stats as scipy_stats

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import frames, labels, layout
from pcbench.report import captions

STUDY = {
    "name": "map",
    "scenarios": ["cart/white"],
    "observers": ["pccebo", "kfbo", "pccebo-twin"],
    "seeds": 24,
    "axes": {"delay": [0.2, 0.4], "noise_std": [0.1, 2.0]},
    "options": {"pccebo-twin": {"gain": "lmi"}},
}


@pytest.fixture(scope="module")
def result():
    return pcbench.run(STUDY)


def outer_texts(figure):
    """Every text but those in the axes: titles of the picture and of its axes, keys, numbers at ticks."""
    every = [text for text in figure.findobj(Text) if text not in {t for ax in figure.axes for t in ax.texts}]
    return [text.get_text().replace("\n", " ").replace("\u00a0", " ") for text in every if text.get_text()]


def dots(ax):
    """The points of every observer."""
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


@pytest.mark.ci
def test_a_distribution_is_the_runs_in_order(result):
    part = frames.distribution(result, metric="steady_rmse", cell=1)
    runs = result.runs.query("cell == 1 and signal == 'position'")
    for observer, mine in part.groupby("observer"):
        values = np.sort(runs[runs.observer == observer].steady_rmse)
        np.testing.assert_array_equal(mine.value, values)
        np.testing.assert_allclose(mine.share, np.arange(1, 25) / 24)
    figure = plots.distributions(result, metric="steady_rmse", cell=1)
    (ax,) = figure.axes
    assert "rms error of position after the transient [m]" in outer_texts(figure)
    drawn = {line.get_label(): line.get_xdata() for line in ax.get_lines()}
    np.testing.assert_array_equal(drawn["kfbo"][1:], part[part.observer == "kfbo"].value)


@pytest.mark.ci
def test_a_curve_has_the_means_and_their_intervals(result):
    figure = plots.curves(result, "noise_std", metric="mae", at={"delay": 0.4})
    (ax,) = figure.axes
    assert {"noise std [m]", "mean |error| of position [m]"} <= set(outer_texts(figure))
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0.1", "2"], (
        "a tick at each value of the axis, and no other"
    )
    rows = result.stats.query("metric == 'mae' and signal == 'position' and delay == 0.4 and observer == 'kfbo'")
    np.testing.assert_allclose(dots(ax)["kfbo"].get_ydata(), rows["mean"])
    np.testing.assert_array_equal(dots(ax)["kfbo"].get_xdata(), [0.1, 2.0])
    bar = np.array(ax.collections[STUDY["observers"].index("kfbo")].get_segments())[:, :, 1]
    np.testing.assert_allclose(bar, rows[["ci_low", "ci_high"]])


@pytest.mark.ci
def test_an_interval_never_leaves_its_axis(result):
    """Also on a logarithmic one, which ends where the intervals end and not where the means do."""
    for metric in ("mae", "max_abs_error", "steady_rmse"):
        (ax,) = plots.curves(result, "delay", metric=metric).axes
        ends = np.concatenate([np.array(bar.get_segments())[:, :, 1].ravel() for bar in ax.collections])
        low, high = ax.get_ylim()
        assert low <= ends.min()
        assert ends.max() <= high


def test_an_axis_that_a_figure_does_not_show_stands_at_its_first_value(result):
    drawn = [
        {name: line.get_ydata() for name, line in dots(plots.curves(result, "noise_std", at=at).axes[0]).items()}
        for at in (None, {"delay": 0.2}, {"delay": 0.4})
    ]
    np.testing.assert_array_equal(drawn[0]["kfbo"], drawn[1]["kfbo"])
    assert (drawn[0]["kfbo"] != drawn[2]["kfbo"]).all()


def test_an_interval_of_more_seeds_is_that_of_the_table(result):
    part = frames.convergence(result, metric="steady_rmse", cell=3)
    row = result.stats.query(
        "metric == 'steady_rmse' and signal == 'position' and cell == 3 and observer == 'kfbo'"
    ).iloc[0]
    mine = part[part.observer == "kfbo"].set_index("seeds").half
    assert list(mine.index) == [4, 8, 16, 24]
    assert mine[24] == pytest.approx((row.ci_high - row.ci_low) / 2 / row["mean"], rel=1e-12)
    (ax,) = plots.convergence(result, metric="steady_rmse", cell=3).axes
    np.testing.assert_allclose(dots(ax)["kfbo"].get_ydata(), 100 * mine)


def test_the_cell_that_tells_most_is_the_one_where_a_sure_winner_is_farthest_ahead(result):
    found = frames.standings(result, metric="mae").set_index("cell")
    cell = frames.key_cell(result, metric="mae")
    assert found.winner[cell] != ""
    assert found.factor[cell] == found.factor[found.winner != ""].max()


def test_where_nobody_surely_wins_the_cell_that_tells_most_is_where_the_most_surely_lose(monkeypatch):
    """Of a family that is one filter to rounding nobody is surely ahead, and where all are equal a picture shows nothing."""
    alike = [("b", "c", "d"), ("b", "c"), ("b",), ("b",)]
    table = pd.DataFrame({"cell": [0, 1, 2, 3], "winner": "", "factor": 1.0, "alike": alike})
    monkeypatch.setattr(frames, "standings", lambda *_: table)
    assert frames.key_cell(None) == 2
    table["winner"], table["factor"] = ["a", "", "", "a"], [1.5, 9.0, 9.0, 1.2]
    assert frames.key_cell(None) == 0, "where somebody does, there"


def test_a_share_of_runs_is_of_all_of_them_and_ends_where_the_rest_diverged():
    rows = [
        {"observer": o, "signal": "x", "diverged": i < lost, "mae": 1.0 + i}
        for o, lost in (("a", 0), ("b", 3))
        for i in range(4)
    ]
    named = SimpleNamespace(scenarios=["s"], signals=lambda scenario: ["x"], study=SimpleNamespace(name="t"))
    named.runs_of = lambda scenario, metrics, cell: pd.DataFrame(rows)
    part = frames.distribution(named, "s", "x", "mae")
    assert part[part.observer == "a"].share.tolist() == [0.25, 0.5, 0.75, 1.0]
    assert part[part.observer == "b"][["value", "share"]].to_numpy().tolist() == [[4.0, 0.25]]


@pytest.mark.nightly
def test_a_tie_is_blank_and_a_win_is_what_a_paired_test_says(result):
    """Two observers alike to the bit never win; without the twin pccebo wins where the t-test on the same draws says so."""
    won = frames.standings(result, metric="steady_rmse").set_index("cell")
    runs = result.runs[result.runs.signal == "position"]
    for cell, row in won.iterrows():
        wide = runs[runs.cell == cell].pivot(index="seed", columns="observer", values="steady_rmse")
        means = wide.mean()
        if means.idxmin() == "kfbo":
            p = scipy_stats.ttest_rel(wide["kfbo"], wide["pccebo"]).pvalue
            assert row.winner == ("kfbo" if p < 1e-6 else row.winner)
        else:
            assert row.winner == "", "its twin is as good"
            assert row.text == "tie"
    alone = pcbench.run(STUDY | {"observers": ["pccebo", "kfbo"]})
    again = frames.standings(alone, metric="steady_rmse").set_index("cell")
    assert "pccebo" in set(again.winner)


@pytest.mark.nightly
def test_diverged_runs_lose_and_are_said_in_per_cent():
    unstable = {"sampled_innovation": True, "R": 1e-6}
    study = STUDY | {
        "scenarios": ["cart/slow"],
        "observers": ["pccebo", "kfbo"],
        "options": {"kfbo": unstable},
        "seeds": 4,
    }
    result = pcbench.run(study)
    assert set(frames.standings(result).winner) == {"pccebo"}
    figure = plots.divergence(result)
    (ax,) = figure.axes
    assert [t.get_text() for t in ax.texts] == ["100"] * 4
    drawn = frames.rows(result, None, None, "divergence_rate")
    assert captions.ranges(drawn.assign(mean=100 * drawn["mean"]), "%") == "Ranges [%]: pccebo 0 to 0, kfbo 100 to 100."
    assert any("diverged runs [%]" in text for text in outer_texts(figure))


def test_only_observers_that_diverge_have_a_map_of_diverged_runs(result):
    """Of seven maps six were white, without a frame."""
    some = copy(result)
    vars(some).pop("_by_signal", None)  # a cache
    of_kfbo = (result.stats.metric == "divergence_rate") & (result.stats.observer == "kfbo")
    some.stats = result.stats.assign(mean=result.stats["mean"].where(~of_kfbo, 0.5))
    (ax,) = plots.divergence(some).axes
    assert "kfbo" in ax.get_title("left")
    rates = frames.rows(some, None, None, "divergence_rate")
    others = [name for name in STUDY["observers"] if name != "kfbo"]
    assert captions.divergence_note(rates) == f"No run of {' and '.join(others)} diverges."
    assert captions.divergence_note(rates[rates.observer == "kfbo"]) == ""
    assert all(to_hex(patch.get_edgecolor()) != "#ffffff" for patch in ax.patches)


def test_observers_without_a_mean_are_named_with_curves_and_costs():
    """The legend had a line that was not in the figure."""
    part = pd.DataFrame({"observer": ["kf", "no-delay"] * 2, "mean": [1.0, np.nan] * 2, "diverged": [0, 8, 1, 8]})
    figure, counts = Figure(), pd.DataFrame({"sample": [3, 3]})
    assert captions.curves_note(figure, "Limit.", part) == "Limit. no-delay has no curve: every run diverges."
    assert captions.costs_note(figure, counts, part).endswith("no-delay is not shown: every run diverges.")
    assert captions.curves_note(figure, "", part.assign(diverged=0)) == ""
    both = part.assign(observer=["a", "b"] * 2, mean=np.nan, diverged=8)
    assert captions.curves_note(figure, "", both) == "a and b have no curves: every run diverges."


def test_maps_stand_on_one_scale_with_numbers_and_both_axes_named(result):
    figure = plots.heatmaps(result, metric="mae")
    small = figure.axes
    assert len(small) == 3
    assert {"delay [s]", "pccebo ↑ noise std [m]", "kfbo"} <= set(outer_texts(figure))
    for ax in small:
        assert [t.get_text() for t in ax.get_yticklabels()] == ["0.1", "2"]
    rows = result.stats.query("metric == 'mae' and signal == 'position'")
    shown = {}
    for ax, observer in zip(small, STUDY["observers"], strict=True):
        mine = rows[rows.observer == observer].sort_values(["delay", "noise_std"])
        texts = sorted((t.get_position(), t.get_text()) for t in ax.texts)
        assert [text for _, text in texts] == [layout.short(v) for v in mine["mean"]]
        for patch, value in zip(ax.patches, rows[rows.observer == observer]["mean"], strict=True):
            shown[value] = patch.get_facecolor()
    light = [sum(shown[value][:3]) for value in sorted(shown)]
    assert light == sorted(light, reverse=True), "the larger, the darker, whoever's it is"


def test_a_map_of_winners_says_who_and_by_how_much_and_is_pale_where_that_is_not_sure(result):
    figure = plots.winners(result, metric="steady_rmse")
    (ax,) = figure.axes
    texts = [t.get_text() for t in ax.texts]
    found = frames.standings(result, metric="steady_rmse")
    for row, text in zip(found.to_dict("records"), texts, strict=True):
        if row["winner"]:
            assert text == f"{row['winner']}\n{labels.times(row['factor'])}"
        else:
            assert text.startswith("tie")


@pytest.mark.ci
def test_one_run_in_time_is_the_trace(result):
    figure = plots.time(result, cell=2, seed=3)
    above, below = figure.axes
    assert {"position [m]", "t [s]", "pccebo", "plant", "measured, held"} <= set(outer_texts(figure))
    assert "cart/white, delay 0.4 s, noise std 0.1 m, seed 3" in outer_texts(figure)
    lines = {line.get_label(): line for line in above.get_lines()}
    assert set(lines) == {"plant", "pccebo", "kfbo", "pccebo-twin", "measured, held"}
    at = ["axes.delay=0.4", "axes.noise_std=0.1"]
    trace = pcbench.simulate("cart/white", ["kfbo"], seed=3, overrides=at)
    t = lines["kfbo"].get_xdata()
    k = np.round(t / 1e-3).astype(int)
    np.testing.assert_allclose(lines["kfbo"].get_ydata(), trace["kfbo.position"].to_numpy()[k], rtol=1e-9)
    np.testing.assert_allclose(lines["measured, held"].get_ydata(), trace["y1"].to_numpy()[k], rtol=1e-9)
    assert set(dots(below)) == {"pccebo", "kfbo", "pccebo-twin"}


MISTAKES = [
    (lambda r: plots.curves(r, "loss"), "expected one that varies"),
    (lambda r: plots.curves(r, "delay", at={"noise_std": 7.0}), "expected one of"),
    (lambda r: plots.curves(r, metric="beauty"), "'beauty' is no metric"),
    (lambda r: plots.time(r, signal="speed"), "'speed' is no signal"),
    (lambda r: plots.time(r, scenario="cart/nominal"), "'cart/nominal' is no scenario"),
    (lambda r: plots.time(r, cell=9), "--grid-point: got 9"),
    (lambda r: plots.save(None, "a.gif"), "expected a name that ends in"),
    (lambda r: plots.fair(r), "expected a study with several tunings"),
    (lambda r: plots.trade_off(pd.DataFrame({"decay": [1.0], "refused": [""]}), "noise"), "'noise' is no column"),
]


@pytest.mark.parametrize(("call", "sentence"), MISTAKES, ids=[s for _, s in MISTAKES])
def test_mistakes_are_one_sentence(call, sentence, result):
    with pytest.raises(UserError, match=sentence) as caught:
        call(result)
    assert "\n" not in str(caught.value)


@pytest.mark.nightly
def test_a_map_wants_two_axes():
    with pytest.raises(UserError, match="expected two"):
        plots.heatmaps(pcbench.run(STUDY | {"axes": {}, "seeds": 2}))
