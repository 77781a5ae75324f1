"""Regret matrix: ratios to the least mean of each situation, hatched where a paired test finds no difference."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import labels, regret_matrix
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
    assert [t.get_text() for t in ax.get_yticklabels()] == [*found.observers, "least [m]"]
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
def test_last_row_is_the_least_error_so_that_columns_can_be_compared(result, paper):
    """A wrong assumption of all observers costs what the least error grows by: the ratios of its column begin at 1."""
    least = by_hand(result).min(axis=1)
    (ax,) = plots.regrets(result, paper=paper).axes
    found = regret_matrix.regrets_of(result)
    shown = {t.get_position()[0]: t.get_text() for t in ax.texts if t.get_position()[1] == len(found.observers)}
    assert [shown[x] for x in range(len(found.situations))] == [f"{least[name]:.2g}" for name in found.situations]
    assert f"Least errors: {found.situations[0]} {least[found.situations[0]]:.3g} m, " in captions.regrets(found)[0]


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
    assert "Least errors" not in captions.regrets(regret_matrix.regrets_of(mixed))[0]
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
    assert f"{found.observers[1]} has the smallest worst case: its error is at most {worst} the least" in note


@pytest.mark.ci
def test_the_caption_names_who_has_the_least_error_because_lost_runs_are_left_out(result):
    found = regret_matrix.regrets_of(result)
    rows, first = found.rows.copy(), found.observers[0]
    rows.loc[(rows.observer == first) & (rows.situation == found.situations[0]), ["ratio", "best", "worse"]] = [
        1.0,
        False,
        True,
    ]
    _, note = captions.regrets(found._replace(rows=rows))
    expected = f"of runs that do not diverge: {first} diverges significantly more often in 1 of the situations."
    assert note.endswith(expected)
    assert "diverge" not in captions.regrets(found)[1]


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(1.0, "1"), (1.004, "1"), (1.04, "1.04"), (1.4, "1.4"), (64.2, "64"), (213.0, "210"), (np.inf, "∞")],
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
