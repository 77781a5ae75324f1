"""Figures of a result: they show its numbers, with units, and say who wins only where that is sure."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats as scipy_stats

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.report import maps

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


def axes_of(figure):
    return [ax for ax in figure.axes if ax.get_visible() and ax.get_xlabel()]


def test_a_distribution_is_the_runs_in_order(result):
    part = frames.distribution(result, metric="tail_rmse", cell=1)
    runs = result.runs.query("cell == 1 and signal == 'position'")
    for observer, mine in part.groupby("observer"):
        values = np.sort(runs[runs.observer == observer].tail_rmse)
        np.testing.assert_array_equal(mine.value, values)
        np.testing.assert_allclose(mine.share, np.arange(1, 25) / 24)
    figure = plots.distributions(result, metric="tail_rmse", cell=1)
    (ax,) = axes_of(figure)
    assert ax.get_xlabel() == "rms error of position in the tail [m]"
    drawn = {line.get_label(): line.get_xdata() for line in ax.get_lines()}
    np.testing.assert_array_equal(drawn["kfbo"], part[part.observer == "kfbo"].value)


def test_a_curve_has_the_means_and_their_intervals(result):
    figure = plots.curves(result, "noise_std", metric="mae", at={"delay": 0.4})
    (ax,) = axes_of(figure)
    assert ax.get_xlabel() == "noise std [unit of the output]"
    rows = result.stats.query("metric == 'mae' and signal == 'position' and delay == 0.4 and observer == 'kfbo'")
    (line,) = [line for line in ax.get_lines() if line.get_label() == "kfbo"]
    np.testing.assert_allclose(line.get_ydata(), rows["mean"])
    np.testing.assert_allclose(line.get_xdata(), [0.1, 2.0])
    band = ax.collections[STUDY["observers"].index("kfbo")].get_paths()[0].vertices[:, 1]
    np.testing.assert_allclose([band.min(), band.max()], [rows.ci_low.min(), rows.ci_high.max()])


def test_an_axis_that_a_figure_does_not_show_stands_at_its_first_value(result):
    drawn = [
        {
            line.get_label(): line.get_ydata()
            for line in axes_of(plots.curves(result, "noise_std", at=at))[0].get_lines()
        }
        for at in (None, {"delay": 0.2}, {"delay": 0.4})
    ]
    np.testing.assert_array_equal(drawn[0]["kfbo"], drawn[1]["kfbo"])
    assert (drawn[0]["kfbo"] != drawn[2]["kfbo"]).all()


def test_a_share_of_runs_is_of_all_of_them_and_ends_where_the_rest_diverged():
    rows = [
        {"observer": o, "signal": "x", "diverged": i < lost, "mae": 1.0 + i}
        for o, lost in (("a", 0), ("b", 3))
        for i in range(4)
    ]
    named = SimpleNamespace(stats=pd.DataFrame({"scenario": ["s"], "signal": ["x"]}), study=SimpleNamespace(name="t"))
    named.runs_of = lambda scenario, metrics, cell: pd.DataFrame(rows)
    part = frames.distribution(named, "s", "x", "mae")
    assert part[part.observer == "a"].share.tolist() == [0.25, 0.5, 0.75, 1.0]
    assert part[part.observer == "b"][["value", "share"]].to_numpy().tolist() == [[4.0, 0.25]]


@pytest.mark.slow
def test_a_tie_is_blank_and_a_win_is_what_a_paired_test_says(result):
    """Two observers alike to the bit never win; without the twin pccebo wins where the t-test on the same draws says so."""
    won = frames.winners(result, metric="tail_rmse").set_index("cell")
    runs = result.runs[result.runs.signal == "position"]
    for cell, row in won.iterrows():
        wide = runs[runs.cell == cell].pivot(index="seed", columns="observer", values="tail_rmse")
        means = wide.mean()
        if means.idxmin() == "kfbo":
            p = scipy_stats.ttest_rel(wide["kfbo"], wide["pccebo"]).pvalue
            assert row.winner == ("kfbo" if p < 1e-6 else row.winner)
        else:
            assert row.winner == "", "its twin is as good"
            assert row.text == "tie"
    alone = pcbench.run(STUDY | {"observers": ["pccebo", "kfbo"]})
    again = frames.winners(alone, metric="tail_rmse").set_index("cell")
    assert "pccebo" in set(again.winner)


@pytest.mark.slow
def test_diverged_runs_lose_and_are_said_in_per_cent():
    unstable = {"sampled_innovation": True, "R": 1e-6}
    study = STUDY | {
        "scenarios": ["cart/slow"],
        "observers": ["pccebo", "kfbo"],
        "options": {"kfbo": unstable},
        "seeds": 4,
    }
    result = pcbench.run(study)
    assert set(frames.winners(result).winner) == {"pccebo"}
    figure = plots.divergence(result)
    texts = [t.get_text() for ax in axes_of(figure) for t in ax.texts]
    assert "100" in texts
    drawn = maps.heatmap(frames.rows(result, None, None, "divergence"), "delay", "noise_std", "divergence")
    assert drawn.text == "Ranges [%]: pccebo 0 to 0, kfbo 100 to 100."
    assert "diverged runs [%]" in figure.get_suptitle()


def test_maps_stand_on_one_scale_with_both_axes_named(result):
    figure = plots.heatmaps(result, metric="mae")
    small = axes_of(figure)
    assert len(small) == 3
    for ax in small:
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("delay [s]", "noise std [unit of the output]")
    assert len({ax.images[0].get_clim() for ax in small}) == 1
    grid = small[1].images[0].get_array()
    rows = result.stats.query("metric == 'mae' and signal == 'position' and observer == 'kfbo'")
    assert grid[1, 0] == rows.query("delay == 0.2 and noise_std == 2.0")["mean"].item()


def test_one_run_in_time_is_the_trace(result):
    figure = plots.time(result)
    (ax,) = axes_of(figure)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("t [s]", "position [m]")
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert set(lines) == {"plant", "pccebo", "kfbo", "pccebo-twin", "measured, held"}
    trace = pcbench.trace("cart/white", ["kfbo"], overrides=["axes.delay=0.2", "axes.noise_std=0.1"])
    t = lines["kfbo"].get_xdata()
    at = np.round(t / 1e-3).astype(int)
    np.testing.assert_allclose(lines["kfbo"].get_ydata(), trace["kfbo.position"].to_numpy()[at], rtol=1e-12)
    np.testing.assert_allclose(lines["measured, held"].get_ydata(), trace["y1"].to_numpy()[at], rtol=1e-12)


MISTAKES = [
    (lambda r: plots.curves(r, "loss"), "expected one that varies"),
    (lambda r: plots.curves(r, "delay", at={"noise_std": 7.0}), "expected one of"),
    (lambda r: plots.curves(r, metric="beauty"), "'beauty' is no metric"),
    (lambda r: plots.time(r, signal="speed"), "'speed' is no signal"),
    (lambda r: plots.time(r, scenario="cart/nominal"), "'cart/nominal' is no scenario"),
    (lambda r: plots.fair(r), "expected a study with several tunings"),
    (lambda r: plots.trade_off(pd.DataFrame({"decay": [1.0], "refused": [""]}), "noise"), "'noise' is no column"),
]


@pytest.mark.parametrize(("call", "sentence"), MISTAKES, ids=[s for _, s in MISTAKES])
def test_mistakes_are_one_sentence(call, sentence, result):
    with pytest.raises(UserError, match=sentence) as caught:
        call(result)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_map_wants_two_axes():
    with pytest.raises(UserError, match="expected two"):
        plots.heatmaps(pcbench.run(STUDY | {"axes": {}, "seeds": 2}))
