"""Observers that do not differ share the first place: the page, the terminal and the tables for papers name the same ones."""

import io
import re
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pcbench.cli.render import results
from pcbench.cli.render.tables import Screen
from pcbench.plots.labels import times
from pcbench.plots.paired_ratios import Ratios
from pcbench.plots.regret_matrix import regrets_of
from pcbench.report import captions, headline, summary
from pcbench.report.summary import _significance
from pcbench.statistics import ranking
from pcbench.study import STUDIES
from pcbench.tables import latex, layout, text

NONE = pd.Series(dtype=int)
NAN = float("nan")


def standings(*sets):
    rows = [
        {"winner": "", "best": each[0] if each else "", "alike": tuple(each[1:]), "leaders": each, "p": 0.5}
        | {"text": "tie" if each else "all diverge"}
        for each in sets
    ]
    return pd.DataFrame(rows)


def test_a_draw_in_every_cell_names_the_observers_that_are_as_good():
    found = standings(*[("kf", "kf-shifted-innovation")] * 4, ("kf-shifted-innovation", "kf"))
    assert (
        _significance(found, NONE, "", False, 64)
        == "as good as the best: kf, kf-shifted-innovation at 5 of 5 grid points"
    )


def test_an_observer_that_is_as_good_in_fewer_cells_is_not_named():
    found = standings(("kf", "pco"), ("kf", "ekf"), ("ekf", "kf"), ())
    assert _significance(found, NONE, "", False, 64) == "as good as the best: kf at 3 of 4 grid points"


def test_cells_in_which_all_diverge_have_no_best():
    assert _significance(standings((), ()), NONE, "", False, 64) == "all diverge"


def test_cells_of_one_run_have_no_winner_and_no_draw():
    found = standings((), ()).assign(best="kf")
    assert _significance(found, NONE, "", True, 1) == "one run: no significance"


def study_of(cells, runs=64, **means):
    """A result without runs: each observer's means by cell, of which a difference of 0.1 or more is significant."""
    cell = {"study": "t", "scenario": "cart/white", "plant": "cart"}
    signal = {"signal": "position", "unit": "m", "predicts_unknown_input": None}
    stats, pairs = [], []
    for i in range(cells):
        here = cell | {"cell": i, "delay": 0.1 * i} | signal
        for observer, each in means.items():
            interval = (
                {"ci_low": each[i] - 0.01, "ci_high": each[i] + 0.01} if runs > 1 else {"ci_low": NAN, "ci_high": NAN}
            )
            about = here | {
                "observer": observer,
                "method": "runs",
                "certified": None,
                "n": runs,
                "diverged": 0,
                "p50": each[i],
            }
            for metric in ("mae", "steady_rmse", "rmse"):
                stats.append(
                    about | {"metric": metric, "mean": each[i], "p05": 0.5 * each[i], "p95": 2 * each[i]} | interval
                )
            stats.append(about | {"metric": "divergence_rate", "mean": 0.0, "p05": NAN, "p95": NAN} | interval)
        for a, b in combinations(means, 2):
            p = NAN if runs == 1 else 0.5 if abs(means[a][i] - means[b][i]) < 0.1 else 1e-6
            said = {"observer_a": a, "observer_b": b, "n": runs, "p_value": p, "p_holm": p, "prob_a_better": 0.4}
            ends = {"mean_diff": means[a][i] - means[b][i], "ci_low": -1.0, "ci_high": 1.0}
            pairs.append(here | {"metric": "steady_rmse"} | said | ends)
    made = Result(study=STUDIES["quick"], stats=pd.DataFrame(stats), pairs=pd.DataFrame(pairs), exact=False)
    made.scenarios, made.signals = ["cart/white"], lambda scenario: ["position"]
    made.stats_of, made.pairs_of = lambda scenario, signal: made.stats, lambda scenario, signal: made.pairs
    made.ranks, made.unproven = lambda metric: metric, lambda scenario: ""
    return made


class Result(SimpleNamespace):
    __hash__ = object.__hash__


CASES = {
    "draw": {"kf": [1.0] * 4, "kf-shifted-innovation": [1.01] * 4, "pco": [1.5, 1.5, 1.0, 1.5]},
    "winner": {
        "kf": [1.0, 1.0, 1.0, 2.0],
        "kf-shifted-innovation": [1.5, 1.5, 1.01, 1.5],
        "pco": [2.0, 2.0, 3.0, 1.49],
    },
}


def leaders_of(means, cell):
    least = min(mean[cell] for mean in means.values())
    return {name for name, each in means.items() if each[cell] - least < 0.1}


def terminal(result):
    screen = Screen(file=io.StringIO(), width=120, force_terminal=True, color_system="standard")
    results.closing(result, screen, "steady_rmse")
    return screen.file.getvalue()


@pytest.mark.parametrize("means", CASES.values(), ids=CASES)
def test_every_output_marks_the_same_observers_in_every_cell(means, monkeypatch):
    result, wanted = study_of(4, **means), [leaders_of(means, cell) for cell in range(4)]
    (table,) = layout.tables(result, "steady_rmse")
    for cell, names in enumerate(wanted):
        assert {words[0] for words, each in table.rows if each[cell].best} == names
    marks = sum(map(len, wanted))
    assert (text.markdown([table]).count("**"), latex.latex([table]).count("bfseries")) == (2 * marks, marks)
    shown = headline.headlines(result, "cart/white", "position", "steady_rmse")
    assert [{row.cells[0] for row in h.rows if row.is_leader} for h in shown] == wanted
    bold = [n for n in re.findall(r"\x1b\[1m([\w-]+)\x1b\[0m", terminal(result).replace(" ", "")) if n in means]
    assert [set(each) for each in _split(bold, wanted)] == wanted
    led = {name: sum(name in each for each in wanted) for name in means}
    monkeypatch.setattr(results, "LONGEST", 1)
    monkeypatch.setattr(headline, "MOST", 1)
    counted = headline.headlines(result, "cart/white", "position", "steady_rmse")[0]
    assert {row.cells[0]: int(row.cells[2]) for row in counted.rows} == led
    lines = [line.split() for line in re.sub(r"\x1b\[\d*m", "", terminal(result)).splitlines()]
    assert {line[0]: int(line[2]) for line in lines if line[:1] and line[0] in means} == led
    tally = summary.tally(summary.rankings(result, "steady_rmse", None))
    assert {t.observer: t.leads for t in tally} == led


def _split(names, wanted):
    """Names in groups as long as those that are wanted."""
    ends = np.cumsum([len(each) for each in wanted])
    assert len(names) == ends[-1]
    return [names[end - len(each) : end] for end, each in zip(ends, wanted, strict=True)]


def test_a_draw_is_the_same_sentence_everywhere(monkeypatch):
    monkeypatch.setattr(results, "LONGEST", 1)
    result, draw = study_of(4, **CASES["draw"]), "as good as the best: kf, kf-shifted-innovation at 4 of 4 grid points"
    assert f"cart/white: {draw}." in re.sub(r"\x1b\[\d*m", "", terminal(result))
    (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    names = [name for name, _ in row.best]
    assert (row.significance, names, row.is_leader) == (draw, ["kf", "kf-shifted-innovation"], True)
    found = summary.rankings(result, "steady_rmse", None)[0].standings
    assert (
        captions.winners(found)
        == "Of 4 grid points: tie 4. No observer is significantly better than kf and kf-shifted-innovation at 4 of them."
    )
    assert row.value == "1 to 1.01 m", "the errors of those that share the first place"
    (one,) = summary.rows(*(lambda r: (r, summary.rankings(r, "steady_rmse", None)))(study_of(1, **CASES["draw"])))
    assert one.significance == "as good as the best: kf, kf-shifted-innovation"


def test_of_one_run_each_nothing_is_marked():
    result = study_of(2, runs=1, **CASES["draw"])
    assert not [e for table in layout.tables(result, "steady_rmse") for e in table.entries if e.best]
    assert not [
        row
        for h in headline.headlines(result, "cart/white", "position", "steady_rmse")
        for row in h.rows
        if row.is_leader
    ]
    (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    assert (row.significance, row.is_leader) == ("one run: no significance", False)


def test_a_metric_without_tests_has_no_leaders():
    result = study_of(1, **CASES["draw"])
    rows = result.stats[result.stats.metric == "rmse"]
    assert ranking.standing(rows, result.pairs[:0]).leaders == ()
    assert ranking.most_often([(), ()]) == ([], 0)


def test_equal_observers_have_the_same_ratio():
    """In one row were "kf-larsen 1×" and "kf 1.000×"; ratios of 340 and 375 were 300 and 400."""
    assert [times(ratio) for ratio in (1.0, 1.0002, 1.004, 1.04)] == ["1×", "1×", "1.004×", "1.04×"]
    assert [times(ratio) for ratio in (1.94, 47.2, 340.0, 374.0)] == ["1.9×", "47×", "340×", "370×"]


def test_all_observers_that_are_nowhere_worse_are_named():
    result = study_of(4, **CASES["draw"])
    result.stats["mean"] = result.stats["mean"].replace(1.01, 1.0002)
    _, note = captions.regrets(regrets_of(result, "steady_rmse", None))
    assert note.startswith("kf and kf-shifted-innovation have the least error, or one as good, in all 4 situations")


def test_observers_without_an_answer_have_not_diverged():
    """Exact moments may have none: captions and tables said that every run diverged."""
    rows = pd.DataFrame({"observer": "kf", "delay": [0.1, 0.2], "mean": [NAN, 1.0], "p50": NAN, "diverged": 0})
    lost = rows.assign(diverged=[8, 0])
    assert captions.curve(rows, "delay", "m") == "kf: (no value) at 0.1 to 1 m at 0.2."
    assert captions.curve(lost, "delay", "m") == "kf: (diverged in every run) at 0.1 to 1 m at 0.2."
    assert captions.curve(rows.assign(mean=np.inf), "delay", "m") == "kf: infinite at 0.1 to infinite at 0.2."
    assert captions.medians(rows[:1], "m") == "Medians: kf (no value)."
    assert captions.ranges(rows[:1], "m") == "Ranges [m]: kf no value."
    assert captions.ranges(lost[:1], "m") == "Ranges [m]: kf diverged in every run."
    result = study_of(2, kf=[NAN, NAN], pco=[NAN, NAN])
    (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    assert (row.significance, row.best, row.value) == ("no value", [], "-")


def test_less_error_with_more_diverged_runs_is_explained():
    """Of a falling body: ekf was called best, with "the least error", and ukf a tie, though its error is half."""
    result = study_of(1, ekf=[1.0], ukf=[0.5], kf=[2.0])
    stats, pairs = result.stats, result.pairs
    stats.loc[stats.observer == "ukf", "diverged"] = 2
    pairs.loc[pairs.observer_b == "ukf", ["ci_low", "ci_high"]] = 0.4, 0.6
    (table,) = headline.headlines(result, "cart/white", "position", "steady_rmse")
    assert [row.cells[0] for row in table.rows if row.is_leader] == ["ekf", "ukf"]
    assert (
        "ekf is first because fewer of its runs diverged, though not significantly fewer. The error of ukf is significantly "
        "less, so there is no winner." in table.note
    )
    rows = pd.DataFrame({"observer": ["ekf", "ukf", "kf"], "ratio": [1.0, 0.5, 2.0], "worse": [False, False, True]})
    rows = rows.assign(n=64, ci_low=NAN, ci_high=NAN, p=1e-6, diverged=[0.0, 0.02, 0.0], more=False)
    said = captions.best(Ratios(rows, "ekf", 1.0, None, False))
    assert said.startswith(
        "ekf has the fewest diverged runs, and kf is significantly worse, ukf is not; ukf has less error"
    )
    two = study_of(2, ekf=[1.0, 1.0], ukf=[0.5, 2.0])
    two.stats.loc[two.stats.observer == "ukf", "diverged"] = 2
    _, note = captions.regrets(regrets_of(two, "steady_rmse", None))
    assert note.startswith("ekf is the best, or as good as the best, in all 2 situations"), "ukf has less error in one"
    assert "Bold: the best, which has the fewest diverged runs." in note


def test_summary_divides_by_the_error_of_the_best():
    """Of a falling body, the row of the best, ekf, had "ukf 1x, ekf 1.9x": 34 % of the runs of ukf diverge."""
    result = study_of(1, ekf=[1.0], ukf=[0.5], kf=[2.0])
    of_ukf = result.stats.observer == "ukf"
    result.stats.loc[of_ukf, ["n", "diverged"]] = 40, 24
    (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    assert [name for name, _ in row.best] == ["ekf"]
    assert [(name, words) for name, _, words in row.ratios] == [("kf", "2×"), ("ukf", "diverges more often")]
    result = study_of(1, ekf=[1.0], ukf=[0.5], kf=[2.0])
    result.stats.loc[result.stats.observer == "ukf", "diverged"] = 2
    (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    assert [words for name, _, words in row.ratios if name == "ukf"] == ["0.5×"], "not significantly more often"


def test_summary_says_how_many_ratios_it_leaves_out():
    names = ("kf", "ekf", "ukf", "pco", "kfbo", "mhe", "eso", "pio", "smo", "chain")
    for many, n_more in ((8, 0), (9, 1), (10, 2)):
        result = study_of(1, **{name: [1.0 + 0.2 * i] for i, name in enumerate(names[:many])})
        (row,) = summary.rows(result, summary.rankings(result, "steady_rmse", None))
        assert (len(row.ratios), row.n_more) == (7, n_more)


def test_equal_errors_without_noise_have_no_test():
    """Under a table of runs that do not vary, "=" was explained by a paired t-test."""
    for spread in (True, False):
        result = study_of(1, **{"kf": [1.0], "kf-shifted-innovation": [1.0], "pco": [2.0]})
        if not spread:
            result.stats[["p05", "p95"]] = 1.0
        (table,) = headline.headlines(result, "cart/white", "position", "steady_rmse")
        assert "=" in table.rows[1].cells
        assert ("t-test" in table.note) is spread
