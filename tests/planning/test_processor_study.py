"""The study `processor`: the numbers of its page come out, and its crossings are those of an independent calculation."""

import re
from math import inf

import numpy as np
import pytest
from documents import PAGES, tables
from scipy import stats

import pcbench
from pcbench import plots
from pcbench.plots import crossings
from pcbench.report import captions

PAGE = PAGES["network_findings.md"]
PAIRS = [("ekf", "ukf"), ("ekf", "particle"), ("ukf", "particle")]
pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def result(as_users_have_it):  # it computes for longer than it compiles
    return pcbench.run("processor")


def by_hand(runs, below, above):
    """Where the log ratio of the means is 0, and where the ends of its Student's interval are."""
    speeds, ends = sorted(set(runs.processor_speed) - {inf}), []
    for speed in speeds:
        at = runs[runs.processor_speed == speed].pivot(index="seed", columns="observer", values="steady_rmse")
        a, b = at[below].to_numpy(), at[above].to_numpy()
        off = a / a.mean() - b / b.mean()
        half = stats.t.ppf(0.975, len(a) - 1) * off.std(ddof=1) / np.sqrt(len(a))
        ends.append(np.log(a.mean() / b.mean()) + np.array([0.0, half, -half]))
    out = []
    for line in np.array(ends).T:
        i = max(k for k in range(len(speeds) - 1) if line[k] < 0 < line[k + 1])
        share = line[i] / (line[i] - line[i + 1])
        out.append(speeds[i] * (speeds[i + 1] / speeds[i]) ** share)
    return out


@pytest.mark.parametrize("pair", PAIRS)
def test_a_crossing_is_the_one_calculated_by_hand(result, pair):
    found = crossings.crossing(result, "processor_speed", *pair)
    np.testing.assert_allclose(found[2:], by_hand(result.runs, *pair), rtol=1e-10)
    assert found.low < found.value < found.high


def test_observers_do_not_cross_the_other_way(result):
    assert crossings.crossing(result, "processor_speed", "particle", "ekf") is None


def test_errors_of_the_page_come_out(result):
    table = result.stats[result.stats.metric == "steady_rmse"].set_index(["processor_speed", "observer"])
    shown = tables(PAGE, "multiplications/s")
    assert len(shown) == 6
    for speed, *errors in shown:
        for observer, text in zip(("ekf", "ukf", "particle"), errors, strict=True):
            row = table.loc[(float(speed.replace(",", "")), observer)]
            assert float(text) == pytest.approx(row["mean"], abs=0.002)
            assert row.ci_high - row["mean"] <= 0.12 * row["mean"]


def test_crossings_of_the_page_come_out(result):
    shown = tables(PAGE, "better | than")
    assert len(shown) == 3
    for above, below, value, interval in shown:
        found = crossings.crossing(result, "processor_speed", below, above)
        ends = [float(text.replace(",", "")) for text in re.findall(r"[\d,]+", interval)]
        np.testing.assert_allclose([float(value.replace(",", "")), *ends], found[2:], rtol=0.01)


def test_the_figure_marks_where_the_best_changes_and_has_a_tick_for_no_limit(result):
    (ax,) = plots.curves(result, "processor_speed").axes
    assert [t.get_text() for t in ax.get_xticklabels()] == ["10000", "10⁵", "10⁶", "no limit"]
    changes = crossings.changes(result, "processor_speed")
    assert [(c.below, c.above) for c in changes] == [("ekf", "ukf"), ("ukf", "particle")]
    dotted = [
        line.get_xdata()[0] for line in ax.lines if len(set(line.get_xdata())) == 1 and line.get_linestyle() == ":"
    ]
    np.testing.assert_allclose([x for x in dotted if x in [c.value for c in changes]], [c.value for c in changes])
    assert "ukf is better than ekf above 15800" in captions.crossings(changes)


def test_a_particle_filter_is_better_without_a_limit_and_worse_on_a_slow_processor(result):
    pairs = result.pairs[result.pairs.metric == "steady_rmse"]
    for kalman in ("ekf", "ukf"):
        mine = pairs[(pairs.observer_a == kalman) & (pairs.observer_b == "particle")].set_index("processor_speed")
        assert mine.ci_low[inf] > 0, "its error is larger"
        assert mine.ci_high[2e5] < 0
