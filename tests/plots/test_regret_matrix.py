"""Regret matrix: ratios to the mean of each situation's best, hatched where a paired test finds no difference."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import frames, labels, regret_matrix
from pcbench.report import captions

STUDY = {
    "name": "situations",
    "scenarios": ["cart/nominal", "cart/white", "cart/gaussian"],
    "observers": ["pccebo", "kfbo", "kf", "kf-ignore-delay"],
    "seeds": 6,
    "axes": {"delay": [0.0, 0.4]},
}


@pytest.fixture(scope="module")
def result():
    return pcbench.run(STUDY)


def by_hand(result):
    """Means by situation and observer, without those whose least mean is 0."""
    rows = result.runs[result.runs.signal == "position"]
    names = rows.scenario.astype(str) + ", delay " + np.where(rows.cell == 0, "0 s", "0.4 s")
    means = rows.groupby([names, rows.observer.astype(str)]).steady_rmse.mean().unstack()
    return means[means.min(axis=1) > 1e-11]


@pytest.mark.ci
def test_regret_is_error_over_least_error_of_situation(result):
    found, means = regret_matrix.regrets_of(result), by_hand(result)
    assert set(found.situations) == set(means.index)
    assert not [name for name in found.situations if "nominal" in name]
    ratios = means.div(means.min(axis=1), axis=0)
    wide = found.rows.pivot(index="situation", columns="observer", values="ratio")
    pd.testing.assert_frame_equal(wide, ratios.loc[wide.index, wide.columns], rtol=1e-10, check_names=False)
    assert found.observers == list(ratios.max().sort_values(kind="stable").index)
    assert found.runs == 6


@pytest.mark.ci
def test_matrix_shows_numbers_and_hatches_what_is_not_significant(result):
    found, (ax,) = regret_matrix.regrets_of(result), plots.regrets(result).axes
    assert [t.get_text() for t in ax.get_yticklabels()] == [*found.observers, "best [m]"]
    below = [t.get_text() for t in ax.texts if t.get_va() == "top"]
    assert below == ["delay [s]", "0", "0.4", "0", "0.4", "", "white", "gaussian"], (
        "what all have in common is in the title"
    )
    at = {tuple(map(int, t.get_position())): t for t in ax.texts if t.get_va() != "top"}
    hatched = {(round(p.get_x() + 0.5), round(p.get_y() + 0.5)) for p in ax.patches if p.get_hatch()}
    colours = {p.get_gid().partition(":")[2]: sum(p.get_facecolor()[:3]) for p in ax.patches if p.get_gid()}
    pairs = result.pairs.query("metric == 'steady_rmse' and signal == 'position'")
    ties = 0
    for x, situation in enumerate(found.situations):
        mine = found.rows[found.rows.situation == situation].set_index("observer")
        best = mine.ratio.idxmin()
        scenario, cell = situation.split(", delay ")[0], int(situation.endswith("0.4 s"))
        tests = pairs[(pairs.scenario == scenario) & (pairs.cell == cell)]
        for y, observer in enumerate(found.observers):
            assert at[x, y].get_text() == regret_matrix.format_ratio(mine.ratio[observer])
            assert (at[x, y].get_fontweight() == "bold") == (observer == best)
            both = tests[tests.observer_a.isin([observer, best]) & tests.observer_b.isin([observer, best])]
            tie = observer != best and (both.p_holm.iloc[0] > 0.05 or both.prob_a_better.iloc[0] == 0.5)
            assert ((x, y) in hatched) == tie
            ties += tie
    assert 0 < ties < len(found.rows) / 2
    ordered = found.rows.sort_values("ratio")
    shades = [
        colours[next(k for k in colours if k.startswith(f"{r.observer}, {r.situation}:"))] for r in ordered.itertuples()
    ]
    assert shades == sorted(shades, reverse=True), "larger is darker"
    assert shades[0] == 3.0, "white"
    said = " ".join(t.get_text().replace("\n", " ") for t in plots.regrets(result).findobj(Text))
    for part in ("6 runs", "not significant (paired t-test, Holm, 5 %)", "position", "situations, cart,"):
        assert part in said


@pytest.mark.ci
@pytest.mark.parametrize("paper", [plots.Paper(), plots.Paper(width=2.0, text=2.0)])
def test_last_row_is_the_error_of_the_best_so_that_columns_can_be_compared(result, paper):
    """A wrong assumption of all observers costs what the error of the best grows by: the ratios of its column begin at 1."""
    least = by_hand(result).min(axis=1)
    (ax,) = plots.regrets(result, paper=paper).axes
    found = regret_matrix.regrets_of(result)
    shown = {t.get_position()[0]: t.get_text() for t in ax.texts if t.get_position()[1] == len(found.observers)}
    assert [shown[x] for x in range(len(found.situations))] == [f"{least[name]:.2g}" for name in found.situations]
    assert (
        f"Errors of the best: {found.situations[0]} {least[found.situations[0]]:.3g} m, " in captions.regrets(found)[0]
    )


@pytest.mark.parametrize(
    ("least", "power", "words"),
    [
        ([0.314, 2.71], 0, ["0.31", "2.7"]),
        ([0.00031, 0.0145, 0.0249], -3, ["0.31", "14", "25"]),
        ([2.1e-7, 3.3e-7], -9, ["210", "330"]),
        ([45000.0, 120000.0], 3, ["45", "120"]),
        ([0.5, np.inf], 0, ["0.5", "∞"]),
    ],
)
def test_least_errors_are_short(least, power, words):
    assert regret_matrix._scale_errors(least) == (power, words)


@pytest.mark.ci
def test_least_errors_of_different_units_are_not_one_row(result):
    """A unit at the begin of the row would be that of some of its numbers."""
    found = regret_matrix.regrets_of(result)
    assert found.unit == "m"
    study = {
        "name": "units",
        "scenarios": ["cart/white", "csth/10s-noise"],
        "observers": ["kf", "model-only"],
        "seeds": 2,
    }
    mixed = pcbench.run(study)
    assert regret_matrix.regrets_of(mixed).unit == ""
    assert "Errors of the best" not in captions.regrets(regret_matrix.regrets_of(mixed))[0]
    names = [t.get_text() for t in plots.regrets(mixed).axes[0].get_yticklabels()]
    assert names == regret_matrix.regrets_of(mixed).observers


@pytest.mark.ci
def test_upright_labels_say_only_what_varies(result):
    """In a column so narrow that no label fits below its cell."""
    figure = plots.regrets(result, paper=plots.Paper(width=2.0, text=2.0))
    (ax,) = figure.axes
    assert [t.get_text() for t in ax.get_xticklabels()] == [
        f"{s} | {d}" for s in ("white", "gaussian") for d in ("0", "0.4")
    ]
    said = " ".join(t.get_text().replace("\n", " ") for t in figure.findobj(Text))
    assert "columns: delay [s]" in said.replace("\u00a0", " ")


def test_equal_neighbours_are_one_label():
    outer, inner = regret_matrix.Level("a", ["1", "1", "2", "2"]), regret_matrix.Level("b", ["x", "y", "y", "y"])
    assert outer.spans([], range(4)) == [("1", 0, 1), ("2", 2, 3)]
    assert inner.spans([outer], range(4)) == [("x", 0, 0), ("y", 1, 1), ("y", 2, 3)]
    assert inner.spans([outer], range(1, 4)) == [("y", 0, 0), ("y", 1, 2)]


@pytest.mark.ci
def test_caption_names_smallest_worst_case(result):
    found = regret_matrix.regrets_of(result)
    text, note = captions.regrets(found)
    assert note.startswith(
        "kf has the least error, or one as good, in all 4 situations (6 runs, hatched: not significant"
    )
    assert text.startswith("Largest ratios: kf 1×")
    _, note = captions.regrets(found._replace(observers=found.observers[1:]))
    worst = labels.times(found.largest[found.observers[1]])
    assert f"{found.observers[1]} has the smallest worst case: its error is at most {worst} that of the best" in note


@pytest.fixture(scope="module")
def losing():
    """kf has the least error with a delay of 0.4 s, but 40 of its 80 runs diverge, and 2 of kfbo with white noise."""
    result = pcbench.run(STUDY)
    stats = result.stats
    runs_of_kf = (stats.observer == "kf") & (stats.cell == 1)
    runs_of_kfbo = (stats.observer == "kfbo") & (stats.cell == 0) & (stats.scenario == "cart/white")
    stats.loc[runs_of_kf, ["n", "diverged"]] = 40, 40
    stats.loc[runs_of_kfbo, ["n", "diverged"]] = 78, 2
    return result


@pytest.mark.ci
def test_observer_that_diverges_more_often_is_not_the_reference(losing):
    """Of a falling body: "1" of ukf, of which 34 % of the runs diverge, was in one column with a bold "1.8" of ekf."""
    found, means = regret_matrix.regrets_of(losing), by_hand(losing)
    wide = found.rows.pivot(index="situation", columns="observer", values="ratio")
    late = [name for name in found.situations if name.endswith("0.4 s")]
    assert late
    for name in late:
        standing = frames.standings(losing, name.split(", ")[0], "position")
        best = standing.best[standing.cell == 1].iloc[0]
        assert best != "kf"
        assert wide.loc[name, best] == 1.0
        assert wide.loc[name, "kf"] == pytest.approx(means.loc[name, "kf"] / means.loc[name, best])
        assert wide.loc[name, "kf"] < 1
        assert found.least[name] == pytest.approx(means.loc[name, best])
    more = found.rows[found.rows.more]
    assert set(zip(more.situation, more.observer, strict=True)) == {(name, "kf") for name in late}
    assert found.observers[-1] == "kf", "its worst case is the last"
    assert found.largest["kf"] == 1.0


@pytest.mark.ci
def test_cells_show_the_share_of_diverged_runs(losing):
    found, (ax,) = regret_matrix.regrets_of(losing), plots.regrets(losing).axes
    shown = {tuple(map(round, t.get_position())): t.get_text() for t in ax.texts if "%" in t.get_text()}
    expected = {}
    for x, name in enumerate(found.situations):
        if name.endswith("0.4 s"):
            expected[x, found.observers.index("kf")] = "50 % diverged"
    expected[found.situations.index("cart/white, delay 0 s"), found.observers.index("kfbo")] = "2.5 % diverged"
    assert shown == expected
    dark = {(round(p.get_x() + 0.5), round(p.get_y() + 0.5)) for p in ax.patches
            if to_hex(p.get_facecolor()) == regret_matrix.DIVERGING}  # fmt: skip
    assert dark == {place for place, text in expected.items() if text.startswith("50")}
    said = " ".join(t.get_text().replace("\n", " ") for t in plots.regrets(losing).findobj(Text))
    assert "below a ratio: diverged runs" in said
    assert "diverges significantly more often" in said
    tips = [p.get_gid() for p in ax.patches if p.get_gid()]
    assert sum("50 % diverged" in tip for tip in tips) == len(expected) - 1
    narrow = plots.regrets(losing, paper=plots.Paper(width=2.0, text=2.0)).axes[0]
    assert {t.get_text() for t in narrow.texts if "%" in t.get_text()} == {"50 %", "2.5 %"}


@pytest.mark.ci
def test_caption_prefers_who_diverges_less_often(result, losing):
    found = regret_matrix.regrets_of(losing)
    text, note = captions.regrets(found)
    assert note.startswith(f"{found.observers[0]} has the smallest worst case")
    assert "kf has the least error" not in note
    assert "Bold: the best, which has the fewest diverged runs. Errors are of runs that do not diverge." in note
    assert note.endswith("kf has less error in 2 of the situations, but diverges significantly more often.")
    assert "Largest shares of diverged runs: kfbo 2.5 %, kf 50 %." in text
    assert "diverge" not in "".join(captions.regrets(regret_matrix.regrets_of(result)))


@pytest.mark.ci
def test_observer_of_few_situations_has_no_smallest_worst_case(result):
    """Of all scenarios, mhe-bounded had "the least error in all 32 situations", of which it ran in one."""
    found = regret_matrix.regrets_of(result)
    one, three = found.situations[0], found.situations[:3]
    only = {"pccebo": [one], "kf": three}
    keep = [s in only.get(o, found.situations) for o, s in zip(found.rows.observer, found.rows.situation, strict=True)]
    rows = found.rows[keep]
    few = found._replace(rows=rows)
    assert few.counts == {"kf": 3, "pccebo": 1, "kfbo": 4, "kf-ignore-delay": 4}
    few = few._replace(observers=["kfbo", "kf-ignore-delay", "kf", "pccebo"])
    _, note = captions.regrets(few)
    assert note.startswith("kfbo has the smallest worst case")
    rows = rows[rows.observer.isin(["kf", "pccebo"])]
    _, note = captions.regrets(few._replace(rows=rows, observers=["kf", "pccebo"]))
    assert note.startswith("No observer runs in all 4 situations, so worst cases are not compared; kf runs in most, 3")
    figure = plots.profiles(result)
    assert "Not every observer runs in every situation" in captions.profiles_note(figure, few)
    assert "Not every observer runs in every situation" not in captions.profiles_note(figure, found)


@pytest.mark.ci
def test_observers_of_all_situations_are_first():
    result = pcbench.run(STUDY)
    stats = result.stats
    stats.drop(stats.index[(stats.observer == "kf") & (stats.cell == 1)], inplace=True)
    found = regret_matrix.regrets_of(result)
    assert found.observers[-1] == "kf", "it is the best where it runs"
    assert list(found.counts.values()) == [4, 4, 4, 2]


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (1.0, "1"),
        (1.004, "1"),
        (1.04, "1.04"),
        (1.4, "1.4"),
        (64.2, "64"),
        (213.0, "210"),
        (99_400.0, "99000"),
        (9.2e16, "10¹⁷"),
        (0.57, "0.57"),
        (0.999, "1"),
        (np.inf, "∞"),
    ],
)
def test_ratio_has_two_digits(ratio, text):
    assert regret_matrix.format_ratio(ratio) == text


def test_one_situation_has_no_matrix():
    result = pcbench.run(
        STUDY | {"scenarios": ["cart/nominal", "cart/slow"], "axes": {}, "seeds": 2, "observers": ["kf", "kfbo"]}
    )
    assert regret_matrix.regrets_of(result) is None
    with pytest.raises(UserError, match="expected two"):
        plots.regrets(result)
