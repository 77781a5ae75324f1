"""Figures are readable: labels do not touch, plants of loops are no pale lines, and an estimate far from its plant is seen."""

from copy import copy
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex, to_rgb

import pcbench
from pcbench import plots
from pcbench.plots import errors_over_time, frames, layout, lines, one_run, palette, time_series
from pcbench.report import captions, figures, summary
from pcbench.study import STUDIES

LOOP = {
    "name": "loop",
    "scenarios": ["ncs-two-state/held"],
    "observers": ["kf"],
    "seeds": 2,
    "axes": {"noise_std": [0.01, 0.02]},
    "options": {"scenario": {"consistency": True, "random_initial_state": True}},
}


def touching(ax, side):
    """The labels of an axis that touch the next one."""
    ticks = [t for t in getattr(ax, f"{side}axis").get_major_ticks() if t.label1.get_text() and t.label1.get_visible()]
    boxes = [t.label1.get_window_extent() for t in ticks]
    ends = sorted((getattr(b, f"{side}0"), getattr(b, f"{side}1")) for b in boxes)
    return [(a, b) for a, b in pairwise(ends) if a[1] > b[0]]


@pytest.mark.parametrize("high", [4.0, 30.0, 99.0, 500.0])
def test_labels_of_a_low_panel_do_not_touch(high):
    with layout.sheet(plots.Paper(), "", 2, 2, height=0.6) as (_, axes):
        layout.set_range(axes[0], "y", [2e-4, 2e-4 * high], log=True)
        layout.set_range(axes[1], "y", [0.0, high], log=False)
    for ax in axes:
        assert touching(ax, "y") == []
        assert len([t for t in ax.get_yticklabels() if t.get_text()]) > 1


def test_only_labels_that_touch_are_left_out_of_uneven_ticks():
    with layout.sheet(plots.Paper(), "") as (_, (ax,)):
        layout.set_values(ax, "x", [0.0, 0.05, 0.1, 0.2, 0.4, 0.8])
        ax.set_xlim(-0.05, 1.2)
    assert [t.get_text() for t in ax.get_xticklabels() if t.get_text()] == ["0", "0.1", "0.2", "0.4", "0.8"]


@pytest.mark.parametrize("high", [3.2, 4.0, 6.0, 9.0])
def test_axis_of_less_than_a_decade_has_more_than_two_ticks(high):
    with layout.sheet(plots.Paper(), "") as (_, (ax,)):
        layout.set_range(ax, "y", [0.25, 0.25 * high], log=True)
        low, top = ax.get_ylim()
        assert len([t for t in ax.get_yticks() if low <= t <= top]) > 2


def test_best_estimate_stays_in_the_picture():
    """Of an estimate far from its plant only vertical lines were left; one that runs away leaves the picture."""
    t = np.linspace(0.0, 1.0, 5)
    series = {"far": 0.01 * t - 1.0, "farther": 0.01 * t - 1.5, "lost": 1e6 * t}
    rows = [pd.DataFrame({"series": "plant", "kind": "truth", "t": t, "value": 0.2 * t})]
    for name, estimate in series.items():
        rows.append(pd.DataFrame({"series": name, "kind": "estimate", "t": t, "value": estimate}))
        rows.append(pd.DataFrame({"series": name, "kind": "error", "t": t, "value": 0.2 * t - estimate}))
    low, high = time_series._range(pd.concat(rows, ignore_index=True))
    assert -1.2 < low < -1.0
    assert 0.2 < high < 0.5


@pytest.mark.parametrize("far", [500.0, 1e200])
def test_plant_stays_in_the_picture_if_every_estimate_is_far(far):
    """The limits were NaN, and no page could be made."""
    t = np.linspace(0.0, 1.0, 5)
    values = {"truth": 0.0 * t, "estimate": 0.0 * t + far, "error": 0.0 * t - far}
    rows = [pd.DataFrame({"series": "kf", "kind": kind, "t": t, "value": v}) for kind, v in values.items()]
    low, high = time_series._range(pd.concat(rows, ignore_index=True))
    assert -5.0 < low < 0.0 < high < 5.0


def test_best_estimate_is_not_one_that_ends_in_nan():
    t = np.linspace(0.0, 1.0, 3)
    errors = {"lost": [0.0, np.nan, np.nan], "best": [1.0, 1.0, 1.0]}
    rows = [pd.DataFrame({"series": s, "kind": "error", "t": t, "value": e}) for s, e in errors.items()]
    rows += [pd.DataFrame({"series": s, "kind": "estimate", "t": t, "value": e}) for s, e in errors.items()]
    assert time_series._best_estimate(pd.concat(rows)).tolist() == errors["best"]


def test_errors_stay_in_the_picture_beside_an_observer_without_errors():
    """Their axis ended at a hundred times its largest error, so theirs were all beyond."""
    sizes = {"exact": [0.0, 1e-17, 0.0], "kf": [0.1, 0.2, 0.3]}
    part = pd.concat([pd.DataFrame({"series": s, "kind": one_run.MEDIAN, "value": e}) for s, e in sizes.items()])
    assert errors_over_time.sizes_in_picture(part).max() == 0.3


@pytest.fixture(scope="module")
def loop():
    return pcbench.run(LOOP)


@pytest.mark.ci
def test_plants_of_a_closed_loop_are_no_pale_lines(loop):
    figure = plots.time(loop)
    thick = [line for line in figure.axes[0].get_lines() if line.get_linewidth() >= 2]
    assert thick
    assert all(np.mean(to_rgb(line.get_color())) < 0.6 for line in thick)
    assert time_series.LOOPED in captions.keys_of(figure)
    run = pd.DataFrame({"signal": [], "series": [], "kind": [], "t": [], "value": []})
    assert "Thick lines" in captions.time(run, "m", figure)[1]


def test_plants_of_a_closed_loop_have_the_dashes_of_their_observers():
    """The paler shade of an observer is that of its first variant, which the plant seemed to belong to."""
    look = lines.lines(["high-gain", "high-gain-robust"])
    part = [pd.DataFrame({"series": one_run.UNDER + o, "kind": "truth", "t": [0.0], "value": [0.0]}) for o in look]
    drawn = []
    ax = SimpleNamespace(get_ylim=lambda: (0.0, 1.0), plot=lambda *_, **line: drawn.append(line))
    time_series._draw_states(ax, pd.concat(part), look)
    assert [line["linestyle"] for line in drawn] == [look[o]["linestyle"] for o in look]


@pytest.mark.ci
def test_the_words_of_a_closed_loop_say_which_diverges(loop):
    """Its last value stood for the end of the run."""
    values = {"plant under kf": ("truth", 1.0), "kf": ("estimate", 2.0), "lost": ("estimate", np.nan)}
    rows = [pd.DataFrame({"series": s, "kind": k, "t": [0.0, 1.0], "value": [1.0, v]}) for s, (k, v) in values.items()]
    text, note = captions.time(pd.concat(rows), "m", plots.time(loop))
    assert text == "At the end: plant under kf 1 m, kf 2 m, lost (diverged)."
    assert "The lines of lost end where the loop diverges." in note
    assert "diverges" not in captions.time(pd.concat(rows[:2]), "m", plots.time(loop))[1]


@pytest.mark.ci
def test_numbers_of_runs_on_an_axis_do_not_touch(loop, monkeypatch):
    """Where an observer lost runs, their number stood in the place of the last one."""
    seeds = {"kf": [4, 8, 16, 32, 64, 128, 256], "pccebo": [4, 8, 16, 32, 64, 128, 236]}
    rows = [pd.DataFrame({"observer": o, "seeds": n, "half": 0.1}) for o, n in seeds.items()]
    monkeypatch.setattr(lines.frames, "convergence", lambda *_: pd.concat(rows))
    (ax,) = plots.convergence(loop).axes
    assert ax.get_xticks().tolist() == seeds["kf"]


@pytest.mark.ci
def test_gains_have_the_number_of_runs_and_the_colours_of_the_other_figures(loop):
    result = copy(loop)
    names = ["kf-published", "kf-tuned"]
    result.stats = pd.concat([loop.stats.assign(observer=name) for name in names])
    row = loop.stats.iloc[0][["scenario", "signal", "unit"]].to_dict() | {"metric": "steady_rmse", "cell": 0}
    row |= {"observer": "kf", "held_out": 1.0, "held_out_se": 0.1, "training": 1.0, "training_se": 0.1}
    result.fair = pd.DataFrame([row | {"label": name, "tuning": name.removeprefix("kf-")} for name in names])
    figure = plots.fair(result)
    assert "2 held-out runs" in figure.legends[0].get_title().get_text()
    drawn = {to_hex(c).upper() for marks in figure.axes[0].collections for c in marks.get_facecolors()}
    assert {style.colour for style in palette.styles(names).values()} <= drawn


@pytest.mark.ci
def test_consistency_is_shown_over_each_axis(loop):
    """Which filter is optimistic at a grid point that the other figures do not show."""
    place = figures.ScenarioData(loop, "ncs-two-state/held", 0, None, None, figures.DEFAULTS)
    pictures = {p.name: p for p in figures.of_all_signals(place)}
    picture = pictures["ncs-two-state-held-nees-over-noise_std"]
    (ax,) = picture.figure.axes
    stats = loop.stats[(loop.stats.metric == "nees")]
    drawn = next(line for line in ax.get_lines() if line.get_label() == "kf")
    np.testing.assert_allclose(drawn.get_ydata(), stats["mean"])
    assert any(np.all(np.asarray(line.get_ydata()) == 1.0) for line in ax.get_lines())
    assert "NEES" in ax.get_title("left")
    assert "optimistic" in picture.note


@pytest.mark.ci
def test_without_numbers_no_consistency_is_shown_and_one_observer_is_compared_with_none(loop):
    """As of exact moments that have no answer: the axes were empty, and the observer was infinitely worse than none."""
    lost = copy(loop)
    lost.stats = loop.stats.assign(mean=np.nan)
    place = figures.ScenarioData(lost, "ncs-two-state/held", 0, None, None, figures.DEFAULTS)
    assert [p.name for p in figures.of_all_signals(place) if "nees" in p.name] == []
    assert [row.ratios for row in summary.rows(lost, summary.rankings(lost, "steady_rmse", ["position"]))] == [[]]


@pytest.mark.ci
def test_figures_of_one_observer_show_its_largest_error(loop):
    assert frames.key_cell(loop, "ncs-two-state/held", "position") == 1


def test_model_mismatch_has_consistency_and_begins_with_the_correct_model():
    study = STUDIES["model-mismatch"]
    assert study.options["scenario"]["consistency"]
    assert study.scenarios[0] == "as-assumed"
    assert set(study.scenarios) <= set(study.tables)


@pytest.mark.ci
def test_scenarios_of_a_study_keep_its_order():
    """Changes of one scenario are as values of an axis: the first figure is not that of the largest lead."""
    wrong = {"base": "cart/white", "assumed_delay_error": 0.04}
    study = {"name": "own", "observers": ["kf", "model-only"], "seeds": 2}
    own = study | {"scenarios": {"true": {"base": "cart/white"}, "wrong": wrong}}
    for names in (["wrong", "true"], ["true", "wrong"]):
        result = pcbench.run(own | {"scenarios": {name: own["scenarios"][name] for name in names}})
        assert [row.scenario for row in summary.rows(result, summary.rankings(result, "steady_rmse", None))] == names


@pytest.mark.ci
def test_titles_of_axes_that_vary_alone_name_those_that_differ_from_the_first_value():
    axes = {"loss": [0.0, 0.5], "delay": [0.2, 0.4], "sampling_jitter": [0.0, 0.02]}
    study = {"name": "alone", "scenarios": ["cart/white"], "observers": ["kf", "model-only"], "seeds": 2}
    result = pcbench.run(study | {"vary": "one-at-a-time", "axes": axes})
    assert plots.curves(result, "delay").legends[0].get_title().get_text() == "cart/white, 2 runs"
    rows = frames.rows(result, "cart/white", "position", "steady_rmse")
    assert captions.describe_grid_point(result, rows, 0) == captions.FIRST_VALUES
    assert captions.describe_grid_point(result, rows, 1) in ("loss 0.5", "delay 0.4 s", "sampling jitter 0.02 s")
    figure = plots.bearing(result)
    assert "divided by that of model-only [-]" in figure.legends[0].get_title().get_text().replace("\n", " ")
    assert all("\n" not in ax.get_title("left") for ax in figure.axes)


@pytest.mark.ci
def test_values_with_an_infinite_one_have_the_same_order_in_all_figures():
    """The error relative to model-only had the Gaussian noise on the right, the error itself on the left."""
    study = {"name": "alone", "scenarios": ["cart/white"], "observers": ["kf", "model-only"], "seeds": 2}
    result = pcbench.run(study | {"vary": "one-at-a-time", "axes": {"student_t_dof": [np.inf, 4.0, 2.5]}})
    (ax,), (other,) = plots.bearing(result).axes, plots.curves(result, "student_t_dof").axes
    assert [t.get_text() for t in ax.get_xticklabels()] == [t.get_text() for t in other.get_xticklabels()]
    drawn, stats = ax.get_lines()[1], frames.rows(result, "cart/white", "position", "steady_rmse")
    means = stats.pivot(index="cell", columns="observer", values="mean")
    np.testing.assert_allclose(drawn.get_ydata(), means["kf"] / means["model-only"])


def test_an_observer_that_diverges_hides_no_other():
    """On an axis up to 10^13 the errors of all others lay on its lower edge."""
    t = np.linspace(0.0, 1.0, 5)
    rows = []
    for name, size in (("kf", 0.1), ("lost", 1e13)):
        for share, kind in enumerate(one_run.SIZES, 1):
            rows.append(
                pd.DataFrame({"signal": "position", "series": name, "kind": kind, "t": t, "value": size * share})
            )
    look = {"kf": palette.LOOKS["kf"], "lost": palette.LOOKS["pco"]}
    part = pd.concat(rows, ignore_index=True)
    spread = errors_over_time.sizes_in_picture(part)
    with layout.sheet(plots.Paper(), "", len(look)) as (_, axes):
        for ax, name in zip(axes, look, strict=True):
            mine = {str(kind): each for kind, each in part[part.series == name].groupby("kind")}
            errors_over_time._draw_panel(ax, mine, look[name].colour, spread, np.array([]))
    low, high = axes[0].get_ylim()
    assert low < 0.1
    assert high < 1e3
    assert min(axes[0].get_lines()[0].get_ydata()) == pytest.approx(0.3), "the median, not the lower edge"
