"""The words of each figure say what is drawn: no band, bar, mark, test or number of runs that is not in the picture."""

import re

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.text import Text
from walked import STUDIES as SHORT

import pcbench
from pcbench.plots import layout, one_run
from pcbench.plots.regret_matrix import regrets_of
from pcbench.plots.time_series import SIGMA
from pcbench.report import captions, figures, page
from pcbench.report.figures import Picture
from pcbench.study import STUDIES

pytestmark = pytest.mark.usefixtures("in_a_hurry")

CONSISTENT = {"scenario": {"random_initial_state": True, "consistency": True}}
SMALL = {
    "white": {"scenarios": ["cart/nominal", "cart/white"], "observers": ["pccebo", "kf", "model-only"], "seeds": 6},
    "faults": {
        "scenarios": ["cart/gaussian"],
        "observers": ["kf", "pccebo", "model-only"],
        "seeds": 6,
        "vary": "one-at-a-time",
        "axes": {"process_std": [[0.02, 0.1]], "timestamp_offset": [0.0, -0.1, -0.4], "student_t_dof": [np.inf, 3.0]},
        "options": CONSISTENT,
    },
    "exact": {
        "scenarios": ["cart/gaussian"],
        "observers": ["kf", "pccebo", "kfbo"],
        "evaluation": "exact",
        "axes": {"delay": [0.0, 0.2], "sampling_period": [0.1, 0.2]},
    },
    "diverging": {
        "scenarios": ["cart/slow"],
        "observers": ["pccebo", "kfbo"],
        "seeds": 6,
        "axes": {"noise_std": [0.1, 0.5], "delay": [0.2, 0.4]},
        "options": {"kfbo": {"sampled_innovation": True, "R": 1e-6}},
    },
    "alone": {"scenarios": ["intermittent/scalar"], "observers": ["kf"], "seeds": 6},
}
SAID = {
    "white": "every other observer is significantly worse",
    "faults": "by the size of timestamp offset",
    "exact": "better than every other.",
    "diverging": "Bars",
}
OF_ONE_RUN = ("-time", "-bands", "-nees")  # figures of simulated runs, in an exact study too
TESTED = r"95 %|interval|Holm|t-test|signific|seed|\bruns?\b"


def pictures(result):
    for place in figures.scenario_data(result, result.scenarios, figures.DEFAULTS).values():
        for _, each in figures.of_scenario(place):
            yield from each
    yield from figures.of_study(result, figures.DEFAULTS)


def faults(picture, result, seeds):
    """What the words of a figure say that is not drawn, and what is drawn that they do not say."""
    figure, note = picture.figure, picture.note
    keys, title = captions.keys_of(figure), figure.legends[0].get_title().get_text().replace("\n", " ")
    words = " ".join([title, note, picture.text, *keys])
    shown = " ".join([words, *(text.get_text() for text in figure.findobj(Text))])
    collections = [c for ax in figure.axes for c in ax.collections]
    shaded = any(isinstance(c, PolyCollection) for c in collections)
    segments = [s for c in collections if isinstance(c, LineCollection) for s in c.get_segments() if len(s)]
    lines = [line for ax in figure.axes for line in ax.get_lines()]
    beyond = any(map(leaves, lines))
    patches = figure.findobj(lambda a: isinstance(a, Patch) and a.get_hatch() and a.axes)
    hollow = any(line.get_markerfacecolor() == "white" for line in lines)
    is_run, is_curve = picture.name.endswith("-time"), "-over-" in picture.name or picture.name.endswith("-cost")
    checks = {
        "bands of a run": not is_run or ("Bands:" in note) == shaded,
        "values outside": not is_run or ("cut off" in note) == beyond,
        "assumed deviations": not is_run or ("Thin lines" in note) == any(line.get_label() == SIGMA for line in lines),
        "assumed deviation of bands": "dashed" not in note or any(line.get_linestyle() == "--" for line in lines),
        "dashed line of bands": not picture.name.endswith("-bands") or ("assumed std" in keys) == ("dashed" in note),
        "bars": not is_curve or ("Bars" in note) == any(np.ptp(s[:, 1]) > 0 for s in segments),
        "hatched": ("hatched" in title) == ("hatched" in note) == bool(patches),
        "not significant": not {"not significant", "not worse", "equal"} & set(keys) or bool(patches) or hollow,
        "zone": "not distinguishable (95 %)" not in keys or any(np.ptp(s[:, 0]) > 0 for s in segments),
        "ranks": "bars below" not in note or len(figure.axes) == 2,
        "all maps": "all maps" not in note or len(figure.axes) > 1,
        "no unit": not re.search(r"\d 1(?:\.(?!\d)|[,;)]| at | \()", f"{note} {picture.text}"),
        "size of a fault": not re.search(r"up to -|not at -", words),
        "exact": not result.exact
        or picture.name.endswith(OF_ONE_RUN)
        or not re.search(TESTED, re.sub("pooled over runs|of one run", "", words)),
        "ratios": not picture.name.endswith("-bearing") or {ax.get_yscale() for ax in figure.axes} == {"log"},
        "infinity": "student_t_dof" not in result.study.axes or "∞" not in shown,
        "runs or seed": picture.name == "fair" or re.search(r"\bruns\b|seed \d|exact values", title),
        "number of runs": {int(n.replace(",", "")) for n in re.findall(r"(\d[\d,]*) runs", words)}
        <= {seeds, one_run.RUNS},
    }
    return [f"{picture.name}: {name}: {words}" for name, holds in checks.items() if not holds]


def leaves(line):
    """Whether a line goes beyond its axis, up or down."""
    low, high = line.axes.get_ylim()
    values = np.asarray(line.get_ydata(), float)
    return bool((values < low).any() or (values > high).any())


@pytest.fixture(scope="module")
def results():
    made = {}

    def result(name):
        if name not in made:
            made[name] = pcbench.run({"name": name} | SMALL[name])
        return made[name]

    return result


@pytest.mark.ci
@pytest.mark.parametrize("name", SMALL)
def test_words_of_a_figure_are_those_of_what_is_drawn(results, name):
    every = list(pictures(results(name)))
    assert [fault for picture in every for fault in faults(picture, results(name), SMALL[name].get("seeds", 0))] == []
    assert SAID.get(name, "") in " ".join(picture.note for picture in every)


@pytest.mark.nightly
@pytest.mark.parametrize("name", [n for n in STUDIES if n != "all"])
def test_words_of_figures_of_a_built_in_study_are_those_of_what_is_drawn(name):
    short = [word for word in SHORT.get(name, []) if "=" in word]
    result = pcbench.run(name, seeds=4, overrides=short)
    assert [fault for picture in pictures(result) for fault in faults(picture, result, 4)] == []
    assert len(page.page(result).encode()) < 1.2e6


@pytest.mark.ci
def test_consistency_over_scenarios_has_a_row_for_each(monkeypatch):
    """Each scenario had its own figure, so that wrong assumptions could not be compared."""
    noise = {"base": "cart/gaussian"}
    scenarios = {"right": noise, "wrong": noise | {"assumed_noise_scale": 0.25}}
    extra = {"options": CONSISTENT}
    result = pcbench.run({"name": "nees", "scenarios": scenarios, "observers": ["kf", "pccebo"], "seeds": 6} | extra)
    (picture,) = [p for p in figures.of_study(result, figures.DEFAULTS) if p.name == "scenarios-nees"]
    labels = [text.get_text() for text in picture.figure.axes[0].get_yticklabels()]
    assert labels == ["right", "wrong"]
    stats = result.stats[result.stats.metric == "nees"].drop_duplicates(["scenario", "observer"])
    for row in stats.itertuples():
        assert f"{row.scenario} {row.mean:.3g}" in picture.text or f"{row.observer} {row.mean:.3g}" in picture.text
    assert faults(picture, result, 6) == []

    def without_one(*given):
        matrix = regrets_of(*given)
        rows = matrix.rows[(matrix.rows.observer != "pccebo") | (matrix.rows.situation != matrix.situations[0])]
        return matrix._replace(rows=rows)

    monkeypatch.setattr(figures, "regrets_of", without_one)  # observers of different scenarios
    assert [p.name for p in figures.of_study(result, figures.DEFAULTS)] == ["regrets", "scenarios-nees"]


@pytest.mark.nightly
def test_page_of_many_scenarios_and_observers_is_small():
    text = page.page(pcbench.run("model-mismatch", seeds=4))
    assert len(text.encode()) < 1.2e6
    assert text.count("Figures of the other scenarios") == text.count("<h4>Size of the error over time</h4>") == 1


@pytest.mark.ci
def test_observers_of_different_scenarios_have_no_performance_profile():
    """A profile counts all situations, also those in which an observer does not run."""
    result = pcbench.run({"name": "different", "scenarios": ["cart/white", "intermittent/scalar"], "seeds": 4})
    assert set(result.stats_of("intermittent/scalar", "x").observer) == {"kf"}
    assert [p.name for p in figures.of_study(result, figures.DEFAULTS)] == ["regrets"]


@pytest.mark.ci
def test_page_of_very_many_scenarios_has_details_of_the_first_only(results, monkeypatch):
    """The page of `all` was twice as large as a page may be, and took ten minutes, most of them for runs over time."""
    result = results("white")
    assert len(result.scenarios) == 2
    whole = page.page(result)
    monkeypatch.setattr(page, "MAX_DETAILED", 1)
    brief = page.page(result)
    assert whole.count("<h4>One run over time</h4>") == 2 * brief.count("<h4>One run over time</h4>") > 0
    assert brief.count(" relative to the best</h4>") == whole.count(" relative to the best</h4>")
    assert brief.count("More figures of this scenario: <code>pcbench report RESULTS --figures FOLDER</code>.") == 1
    assert "More figures" not in whole


@pytest.mark.ci
def test_page_of_one_run_of_one_observer_has_no_tests():
    result = pcbench.run({"name": "once"} | SMALL["alone"] | {"seeds": 1})
    said = re.sub(r"<script.*?</script>|<style.*?</style>|<pre>.*?</pre>", "", page.page(result), flags=re.S)
    assert "One run each: no intervals." in said
    assert "significan" not in said


@pytest.mark.ci
def test_pages_of_exact_values_and_of_one_observer_have_no_tests(results):
    exact, alone = (
        re.sub(r"<script.*?</script>|<style.*?</style>", "", page.page(results(name)), flags=re.S)
        for name in ("exact", "alone")
    )
    section = exact.partition('<section id="repeat">')[0]
    assert "The values are exact over all noise." in section
    assert "Intervals are 95 %" not in section
    assert "Holm" not in section
    assert "1 observer (kf)" in alone
    assert "<h2>Errors of kf</h2>" in alone
    said = re.sub("<[^>]*>", "", re.sub("<pre>.*?</pre>", "", alone, flags=re.S))
    assert not re.search("[Ww]inner|[Bb]est|Ranked|significan|same random", said)
    assert "<dt>significant</dt>" not in exact
    assert "diff. to best" not in alone
    assert "6 runs each; (a .. b) is a 95 % interval. None of them diverged." in alone
    assert "steady_rmse [-]" in alone
    assert not re.search(r"[\d.]+ 1<|\[1\]", alone.partition('<section id="repeat">')[0])


@pytest.mark.ci
def test_words_that_are_not_drawn_are_seen(results):
    """The measure itself."""
    with layout.sheet(layout.PAPER, "cart/white, 6 runs") as (figure, (ax,)):
        layout.set_range(ax, "y", [0.0, 1.0])
        ax.plot([0, 1], [0, 1], label="kf")
    for name, note in (
        ("x-time", "Bands: 90 % of the errors over 32 runs."),
        ("x-time", "Values outside the range are cut off."),
        ("x-bands", "the assumed standard deviation (dashed)"),
        ("x-over-delay", "Bars: 95 % intervals of the mean."),
        ("x-over-delay", "up to -0.1"),
        ("x-over-delay", "below 2.39 1 (twice the least mean)"),
        ("regrets", "hatched: not significant"),
        ("x-cost", "11 runs"),
    ):
        assert faults(Picture(name, "", figure, "", note), results("white"), 6), note
    assert faults(Picture("x-time", "", figure, "", ""), results("white"), 6) == []
    assert faults(Picture("x-cost", "", figure, "", ""), results("exact"), 6), "it names runs"


def test_gains_of_each_kind_have_the_ratio_of_the_largest_to_the_smallest():
    values = {
        "published": {"pccebo": 0.6, "kf": 0.2, "model-only": 2.0},
        "design": {"pccebo": 0.4},
        "tuned": {"pccebo": 0.3, "kf": 0.2},
    }
    rows = [
        {"cell": 0, "unit": "m", "observer": observer, "tuning": tuning, "held_out": value}
        for tuning, group in values.items()
        for observer, value in group.items()
    ]
    found = captions.fair(pd.DataFrame(rows))
    assert found.startswith("The values of 2 observers differ by up to 3× with published and 1.5× with tuned gains: ")
    assert found.endswith("pccebo tuned 0.3 m, kf tuned 0.2 m.")
    alone = captions.fair(pd.DataFrame([row for row in rows if row["observer"] == "pccebo"]))
    assert alone == "pccebo published 0.6 m, pccebo designed 0.4 m, pccebo tuned 0.3 m."


def test_a_winner_that_is_hardly_better_is_explained():
    """Significant over the same runs, but a ratio of 1× of a winner seemed to be an error."""
    standings = pd.DataFrame({"winner": ["pio", "pio"], "best": ["pio", "pio"]})
    for lead, is_said in (("1×", True), ("1.1×", False), ("1.002×", False), ("11×", False)):
        figure = Figure()
        figure.subplots().text(0, 0, f"pio\n{lead}")
        assert (
            "1×: their errors differ by less than 0.05 %." in captions.winners_note(standings, figure, 8)
        ) is is_said


def test_a_distribution_says_which_curves_have_no_diverged_runs():
    """Their curves end below 100 %."""
    part = pd.DataFrame({"observer": ["kf", "high-gain", "pco"], "diverged": [0, 20, 0]})
    assert captions.distribution_note(part) == (
        "Left is better. Runs that diverge are missing from the curve of high-gain."
    )
    assert captions.distribution_note(part.assign(diverged=[0, 1, 2])).endswith("the curves of high-gain and pco.")
    assert captions.distribution_note(part.assign(diverged=0)) == "Left is better."
