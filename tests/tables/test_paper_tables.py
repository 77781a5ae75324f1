"""Tables for a paper say what the tables on disk say, to the right number of digits, and LaTeX takes them."""

import csv
import io
import re
import shutil
import subprocess
from itertools import pairwise, product
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.cli.options import Journal
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.plots.layout import JOURNALS, POINTS_PER_INCH
from pcbench.statistics import number_format
from pcbench.study import STUDIES, observers_of, scenarios_of
from pcbench.study.grid import cells
from pcbench.tables import latex, layout, text
from pcbench.tables.layout import Entry, Head, Table


@pytest.fixture(scope="module")
def result(whole):
    return pcbench.open_result(whole)


def row(mean, low, high, n=16, diverged=0, **more):
    return {"metric": "rmse", "mean": mean, "ci_low": low, "ci_high": high, "n": n, "diverged": diverged} | more


def alone(*entries):
    return Table(
        "a/b", "", "a/b: x_y", [Head("observer")], [Head("p", "rad/s^2"), Head("q", "1")], [(["o_1"], [*entries])]
    )


def test_along_an_axis_a_row_is_an_observer_and_a_column_a_value(result):
    (found,) = layout.tables(result, "steady_rmse")
    assert [h.text for h in found.heads] == ["0.1", "0.5"]
    assert (found.over.text, found.signal) == ("noise std", "position")
    assert [words for words, _ in found.rows] == [["pccebo"], ["kfbo"]]
    stats = result.stats.query("metric == 'steady_rmse' and signal == 'position'").set_index(["observer", "noise_std"])
    for (observer,), each in found.rows:
        for head, entry in zip(found.heads, each, strict=True):
            assert entry.text == number_format.interval(stats.loc[(observer, float(head.text))])


def test_all_that_are_not_significantly_worse_than_the_best_are_marked(result):
    (found,) = layout.tables(result, "steady_rmse")
    stats = result.stats.query("metric == 'steady_rmse' and signal == 'position'")
    for i, noise in enumerate((0.1, 0.5)):
        least = stats[stats.noise_std == noise].sort_values("mean").observer.iloc[0]
        marks = {words[0]: each[i].best for words, each in found.rows}
        assert marks.pop(least)
        p = result.pairs.query("metric == 'steady_rmse' and signal == 'position'")
        sure = p[p.noise_std == noise].p_holm.iloc[0] <= 0.05
        assert set(marks.values()) == {not sure}


def test_a_metric_that_is_not_compared_has_no_best(result):
    (found,) = layout.tables(result, "rms_efficiency")
    assert {e.best for e in found.entries} == {False}


def test_without_axes_a_column_is_a_signal_with_its_unit(result):
    stats, pairs = result.stats, result.pairs

    class One:
        study = result.study
        scenarios, signals = result.scenarios, result.signals
        ranks = staticmethod(lambda metric: metric)
        stats_of = staticmethod(lambda name, signal: One.stats[One.stats.signal == signal])
        pairs_of = staticmethod(lambda name, signal: One.pairs[One.pairs.signal == signal])

    One.stats, One.pairs = stats[stats.cell == 0], pairs[pairs.cell == 0]
    (found,) = layout.tables(One, "steady_rmse", [])
    assert found.heads == [Head("position", "m"), Head("velocity", "m/s")]
    assert "| observer | position [m] | velocity [m/s] |" in text.markdown([found])


def test_along_more_axes_rows_are_groups_of_observers(result):
    again = result.stats.assign(delay=0.5, cell=result.stats.cell + 2)
    stats = pd.concat([result.stats.assign(delay=0.0), again, again.assign(delay=1.0, cell=again.cell + 2)])

    class Two:
        study, pairs = result.study, result.pairs
        scenarios, signals = result.scenarios, result.signals
        ranks = staticmethod(lambda metric: metric)
        stats_of = staticmethod(lambda name, signal: Two.stats[Two.stats.signal == signal])
        pairs_of = staticmethod(lambda name, signal: Two.pairs[Two.pairs.signal == signal])

    Two.stats = stats
    (found,) = layout.tables(Two, "steady_rmse")
    assert (found.over, [h.text for h in found.heads]) == (Head("delay", "s"), ["0", "0.5", "1"])
    assert found.stub == [Head("noise std", "m"), Head("observer")]
    assert [words for words, _ in found.rows] == [[n, o] for n in ("0.1", "0.5") for o in ("pccebo", "kfbo")]
    by_cell = stats.query(
        "metric == 'steady_rmse' and observer == 'kfbo' and noise_std == 0.5 and signal == 'position'"
    )
    assert [e.row["cell"] for e in found.rows[-1][1]] == by_cell.sort_values("delay").cell.to_list()
    made = latex.latex([found], plain=True)
    assert made.index("noise std 0.1") < made.index("kfbo") < made.index("noise std 0.5")


LATEX = {
    (0.12345, 0.1201, 0.1268): (r"\num{0.1235 \pm 0.0033}", r"$0.1235 \pm 0.0033$"),
    (0.0047, 0.0011, 0.02): (r"\num{0.0047} (\num{0.0011} to \num{0.02})", r"$0.0047$ ($0.0011$ to $0.02$)"),
    (123456789.0, 123400000.0, 123513578.0): (
        r"\num{1.23457 \pm 0.00057 e8}",
        r"$(1.23457 \pm 0.00057) \times 10^{8}$",
    ),
    (2e-7, 2e-7, 2e-7): (r"\num{2e-07}", r"$2 \times 10^{-7}$"),
    (0.0, 0.0, 0.0): (r"\num{0}", "$0$"),
    (1.5, float("nan"), float("nan")): (r"\num{1.5}", "$1.5$"),
    (float("nan"),) * 3: ("--", "--"),
}


@pytest.mark.parametrize("numbers", LATEX)
def test_an_estimate_in_latex_is_the_one_of_the_terminal(numbers):
    with_siunitx, plain = LATEX[numbers]
    entry = Entry(row(*numbers), False)
    assert latex._entry(entry, False) == with_siunitx
    assert latex._entry(entry, True) == plain


def test_marks_units_and_special_letters_in_latex_and_markdown():
    best, lost = Entry(row(1.0, 0.9, 1.1), True), Entry(row(2.0, 1.9, 2.1, diverged=3), False)
    made = latex.latex([alone(best, lost)])
    assert r"o\_1 & {\boldmath\bfseries \num{1.00 \pm 0.10}}" in made
    assert r"\num{2.00 \pm 0.10}\textsuperscript{\dag}" in made
    assert r"p [\unit{rad/s^{2}}] & q \\" in made
    assert r"x\_y" in made
    assert "Dagger: some runs diverged" in made
    assert "An observer that diverges significantly more often than the best is not bold." in made
    assert "16 to 19 runs" in made
    assert "| o_1 | **1.00 ± 0.10** | 2.00 ± 0.10 † |" in text.markdown([alone(best, lost)])
    assert "siunitx" not in latex.latex([alone(best, best)], plain=True)
    assert "unit" not in latex.latex([alone(best, best)], plain=True)


def test_notes_name_the_runs_and_no_test_of_exact_values():
    rate = row(0.25, 0.1, 0.5, n=8, diverged=2, metric="divergence_rate")
    (note,) = alone(Entry(rate, False), Entry(rate, False)).notes
    assert note == "Means over 8 runs; skewed intervals by their ends.", "a rate of diverged runs is over all of them"
    notes = alone(*[Entry(row(0.25, 0.25, 0.25, n=0), True)] * 2).notes
    assert notes == ["Exact expected values.", "Bold: the best, and each that is equal to it."]


def test_csv_holds_the_numbers_in_full(result):
    found = pd.read_csv(io.StringIO(text.values(layout.tables(result, "steady_rmse", []))), keep_default_na=False)
    want = result.stats.query("metric == 'steady_rmse'")
    assert len(found) == len(want)
    key = ["signal", "noise_std", "observer"]
    for name in ("mean", "ci_low", "ci_high", "n"):
        a, b = (frame.sort_values(key)[name].to_numpy(float) for frame in (found, want))
        assert (abs(a - b) <= 1e-11).all(), "zero but for rounding stands as that"
    assert next(csv.reader(io.StringIO(text.values([]))))[-1] == "best"


def test_a_metric_that_is_none_is_one_sentence(result):
    with pytest.raises(UserError, match="did you mean 'rmse'"):
        layout.tables(result, "rmsd")


@pytest.mark.ci
def test_the_command_writes_the_form_that_its_file_says(whole, tmp_path):
    for name, begins in (("t.tex", "% needs"), ("t.md", "cart/slow: steady_rmse"), ("t.csv", "scenario,signal,metric")):
        done = call("tables", whole, "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / name).read_text().startswith(begins)
    assert call("tables", whole, "--plain").stdout.startswith("% for ieee: tables are at most 252 pt")
    assert "384 pt" in call("tables", whole, "--latex", "--journal", "elsevier-1p").stdout
    assert [*JOURNALS] == [*get_args(Journal)]
    for words, said in (
        (["--csv", "--latex"], "expected one form"),
        (["--out", tmp_path / "t.doc"], "no form by its name"),
        (["--markdown", "--journal", "ieee"], "--journal has no effect with markdown"),
    ):
        done = call("tables", whole, *words)
        assert done.returncode == 2
        assert said in done.stderr


def has_latex():
    """Whether LaTeX with both packages and the journals' classes is there."""
    if not shutil.which("pdflatex") or not shutil.which("kpsewhich"):
        return False
    files = ["siunitx.sty", "booktabs.sty", "IEEEtran.cls", "elsarticle.cls"]
    found = subprocess.run(["kpsewhich", *files], capture_output=True, text=True, check=False)
    return len(found.stdout.split()) == len(files)


class Made:
    """A result of a built-in study without runs: estimates of any size at each of its grid points, with their intervals."""

    def __init__(self, name):
        self.study = STUDIES[name]
        known, rng, rows = scenarios_of(self.study), np.random.default_rng(7), []
        self.scenarios = [*self.study.scenarios]
        for scenario in self.scenarios:
            for cell in cells(self.study, scenario):
                for observer, (signal, unit) in product(
                    observers_of(self.study, scenario), signals_of(known[scenario])
                ):
                    about = {"scenario": scenario, "cell": cell.number, **cell.values, "observer": observer}
                    mean, half = 10.0 ** rng.uniform(-7, 7), rng.choice([0.0, 1e-4, 0.02, 0.3])
                    interval = {"ci_low": mean * (1 - half), "ci_high": mean * (1 + half * rng.choice([1.0, 1.5]))}
                    about |= {"signal": signal, "unit": unit, "metric": "steady_rmse", "mean": mean, "p50": mean}
                    rows.append(about | interval | {"n": 250, "diverged": int(rng.integers(2))})
        self.stats = pd.DataFrame(rows)
        self.pairs = pd.DataFrame(columns=["scenario", "signal", "metric", "cell"])

    def signals(self, scenario):
        return list(self.stats_of(scenario).signal.unique())

    def stats_of(self, scenario, signal=None):
        mine = self.stats[self.stats.scenario == scenario]
        return mine if signal is None else mine[mine.signal == signal]

    def ranks(self, metric):
        return metric


@pytest.fixture
def made(monkeypatch):
    """Results of built-in studies by name; every second observer is in bold, which is wider."""
    monkeypatch.setattr(layout, "standing", lambda cell, met: SimpleNamespace(leaders=[*cell.observer][::2]))
    return Made


@pytest.mark.parametrize("journal", JOURNALS)
@pytest.mark.parametrize("study", STUDIES)
def test_parts_of_a_split_table_are_the_whole(made, study, journal):
    for table in layout.tables(made(study), "steady_rmse"):
        column, both = (width * POINTS_PER_INCH for width in (JOURNALS[journal].width, JOURNALS[journal].full))
        parts = [part for part, _ in latex.split(table, column, both)]
        each = [
            (*words, h.text, e and e.text)
            for p in parts
            for words, es in p.rows
            for h, e in zip(p.heads, es, strict=True)
        ]
        whole = [
            (*words, h.text, e and e.text) for words, es in table.rows for h, e in zip(table.heads, es, strict=True)
        ]
        assert sorted(each, key=str) == sorted(whole, key=str)
        said = [f", part {i} of {len(parts)}" for i in range(1, len(parts) + 1)] if parts[1:] else [""]
        assert [p.about for p in parts] == [table.about + text for text in said]
        assert len(parts) > 1 or study != "period-delay-map"


MEASURED = r"""
\usepackage{etoolbox}
\newsavebox\measured
\BeforeBeginEnvironment{tabular}{\begin{lrbox}{\measured}}
\AfterEndEnvironment{tabular}{\end{lrbox}\typeout{WIDTH \the\wd\measured\space OF \the\linewidth}\usebox\measured}
"""
CLASSES = {
    "ieee": r"\documentclass[journal]{IEEEtran}",
    "elsevier": r"\documentclass[final,5p,twocolumn]{elsarticle}",
    "elsevier-1p": r"\documentclass[final,1p]{elsarticle}",
}


def compile_tables(body, folder, begin):
    """What TeX says of a document with these tables, each on pages of its own."""
    body = re.sub(r"(\\end\{table\*?\})", r"\1\\clearpage", body)
    begin += r"\usepackage[T1]{fontenc}\setlength\textheight{690pt}\setlength\topmargin{-60pt}"
    (folder / "t.tex").write_text(f"{begin}\n\\begin{{document}}\n{body}\\end{{document}}\n")
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    return re.sub(r"(?<=.{79})\n", "", (folder / "t.log").read_text(errors="replace"))


@pytest.mark.ci
@pytest.mark.skipif(not has_latex(), reason="there is no LaTeX with booktabs, siunitx, IEEEtran and elsarticle")
@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("journal", CLASSES)
def test_tables_of_every_study_fit_their_journal(made, tmp_path, journal, plain):
    every = [table for study in STUDIES for table in layout.tables(made(study), "steady_rmse")]
    every += layout.tables(made("helicopter"), "steady_rmse", [])
    body = latex.latex(every, plain, journal)
    log = compile_tables(
        body, tmp_path, CLASSES[journal] + MEASURED + ("" if plain else re.sub("% needs ", "", latex.NEEDS))
    )
    measured = [(float(a), float(b)) for a, b in re.findall(r"WIDTH ([\d.]+)pt OF ([\d.]+)pt", log)]
    assert len(measured) == body.count(r"\begin{tabular}") > 100
    assert [pair for pair in measured if pair[0] > pair[1]] == []
    assert {round(b) for _, b in measured} == {
        round(JOURNALS[journal].width * 72.27),
        round(JOURNALS[journal].full * 72.27),
    }
    assert max(a / b for a, b in measured) > 0.85, "no table is split that could be whole"
    assert not re.findall(r"Overfull \\hbox.*|Float too large.*", log)


@pytest.mark.ci
@pytest.mark.skipif(not has_latex(), reason="there is no LaTeX with booktabs, siunitx, IEEEtran and elsarticle")
@pytest.mark.parametrize("plain", [False, True])
def test_latex_takes_it(result, tmp_path, plain):
    odd = [Entry(row(*numbers, diverged=1), mark) for numbers, mark in zip(LATEX, [True, False] * 4, strict=False)]
    every = [*layout.tables(result, "steady_rmse", []), *(alone(a, b) for a, b in pairwise(odd))]
    packages = "" if plain else re.sub("% needs ", "", latex.NEEDS)
    compile_tables(latex.latex(every, plain), tmp_path, rf"\documentclass{{article}}{packages}")
