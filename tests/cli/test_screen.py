"""Tables in the terminal: no number is cut at any width, a value and its interval end at one digit, a head has one meaning."""

import io
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commands import call
from hypothesis import given
from hypothesis import strategies as st
from small_study import STUDY

import pcbench
from pcbench.cli import lists, shared
from pcbench.cli.render import recordings, results
from pcbench.cli.render.tables import Column, Screen, align_intervals
from pcbench.controllers import CONTROLLERS
from pcbench.export.files import SignalDifference
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.report import headline
from pcbench.scenarios import SCENARIOS
from pcbench.statistics import number_format
from pcbench.study.builtin import STUDIES

OWN = Path(__file__).parents[1] / "support" / "own_observer.py"
MANY = {
    "name": "many",
    "scenarios": ["cart/slow"],
    "observers": ["pccebo", "kfbo", "kf", "model-only"],
    "seeds": 5,
    "axes": {"noise_std": [0.1, 0.5], "delay": [0.2, 0.6], "assumed_delay_error": [0.0, 0.05]},
}


@pytest.fixture(scope="module")
def many():
    return pcbench.run(MANY)


def render(result, width=80, metric="steady_rmse", signals=None):
    console = Screen(file=io.StringIO(), width=width)
    results.closing(result, console, metric, signals)
    return console.file.getvalue()


def number(row):
    return number_format.interval(row)


@pytest.mark.ci
@pytest.mark.parametrize("width", [60, 80, 100, 160])
def test_no_number_is_cut_at_any_width(many, width):
    text = render(many, width)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    rows = many.stats[(many.stats.metric == "steady_rmse") & (many.stats.signal == "position")]
    flat = " ".join(text.split())
    assert len(rows) == 32
    for row in rows.to_dict("records"):
        value, sign, half = number(row).partition(" ± ")
        assert re.search(
            rf"{re.escape(row['observer'])} +{re.escape(value)}{' ± +' if sign else ''}{re.escape(half)}", flat
        )
    assert ("Left out for lack of space: " in text) == (width < 160)
    assert ("delay = 0.2, noise_std = 0.1, assumed_delay_error = 0.0" in flat) == (width < 100), "axes stand above then"


@pytest.mark.ci
def test_an_axis_column_stands_where_there_is_room(many):
    text = render(many, 200)
    assert re.search(r"delay +noise_std +assumed_delay_error +observer +steady_rmse +diff. to best", text)
    assert "Left out" not in text


@pytest.mark.ci
@pytest.mark.parametrize("metric", ["steady_rmse", "mae", "rmse", "settling_time", "steady_mse", "max_abs_error"])
def test_a_head_is_the_name_of_one_metric(whole, metric):
    """The column that ranks bears the metric's name, and no other column does."""
    result = pcbench.open_result(whole)
    text = render(result, 160, metric)
    head = next(line for line in text.splitlines() if "observer" in line and metric in line)
    words = [w for w in re.split(r"  +", head.strip()) if w]
    assert "settling_time [s]" not in words or metric == "settling_time" or "median" in text
    assert len(set(words)) == len(words)
    assert words.count(metric) + sum(w.startswith(f"{metric} [") for w in words) == 1
    assert set(words) <= {
        "noise_std",
        "observer",
        metric,
        f"{metric} [s]",
        f"{metric} [(m)^2]",
        "diff. to best",
        "rms_efficiency",
        "settling_time [s]",
        "rmse",
    }
    means = result.stats[(result.stats.metric == metric) & (result.stats.signal == "position")]
    for row in means.to_dict("records"):
        assert number(row).split(" ± ")[0] in text


@pytest.mark.ci
def test_the_best_by_the_metric_stands_first_and_the_others_say_by_how_much(whole):
    result = pcbench.open_result(whole)
    for metric in ("steady_rmse", "max_abs_error"):
        mine = result.stats[
            (result.stats.metric == metric) & (result.stats.signal == "position") & (result.stats.cell == 1)
        ]
        best, worse = mine.sort_values("mean").observer
        lines = [line.split() for line in render(result, 160, metric).splitlines()]
        order = [w for line in lines for w in line if w in ("pccebo", "kfbo")][-2:]
        assert order == [best, worse]
        pairs = result.pairs[
            (result.pairs.metric == metric) & (result.pairs.signal == "position") & (result.pairs.cell == 1)
        ]
        said = number_format.difference(pairs, worse, best)
        assert said.startswith("+") or said == "="
        assert said.split(" ± ")[0] in render(result, 160, metric)


@pytest.mark.ci
def test_signals_can_be_chosen(whole):
    result = pcbench.open_result(whole)
    assert render(result).count("error of ") == 1
    assert render(result, signals=[]).count("error of ") == 2
    assert "error of velocity [m/s]" in render(result, signals=["velocity"])
    assert "error of position" not in render(result, signals=["velocity"])


@pytest.mark.nightly  # what it prints is tested above, and what it refuses in test_cli
def test_the_command_takes_signals_and_a_metric(tmp_path):
    """And another name is one sentence, before anything runs."""
    words = ["run", "cart/slow", "--seeds", "3", "--observers", "kf,model-only", "--out", tmp_path / "out"]
    done = call(*words, "--signal", "all", "--metric", "max_abs_error")
    assert done.returncode == 0, done.stderr
    assert "error of velocity [m/s], 3 seeds" in done.stdout
    assert re.search(r"observer +max_abs_error +diff. to best", done.stdout)
    assert done.stdout.rstrip().endswith(f"View the results: pcbench report {tmp_path / 'out'}")
    done = call("run", "cart/slow", "--signal", "speed", "--out", tmp_path / "no")
    assert done.returncode == 2
    assert "--signal: 'speed' is no signal of cart/slow; valid: position, velocity." in done.stderr
    assert not (tmp_path / "no").exists()
    page = tmp_path / "page.html"
    assert (
        call("report", tmp_path / "out", "--signal", "velocity", "--metric", "max_abs_error", "--out", page).returncode
        == 0
    )
    text = page.read_text()
    assert "max_abs_error [m/s]" in text
    assert "Error of velocity [m/s]" in text
    assert "Error of position" not in text
    assert "of position" not in text
    done = call("report", tmp_path / "out", "--signal", "speed")
    assert "--signal: 'speed' is no signal of the study" in done.stderr


@pytest.mark.ci
def test_of_many_cells_wins_are_counted_where_they_are_sure(many, monkeypatch):
    monkeypatch.setattr(results, "LONGEST", 8)
    text = render(many)
    assert "least steady_rmse of position, over 8 grid points" in text
    assert "median steady_rmse [m]" in text
    assert "diff. to best" not in text, "a footnote of columns that are not there"
    order = [line.split()[0] for line in text.splitlines() if line.split()[:1] and line.split()[0] in MANY["observers"]]
    won = {
        line.split()[0]: int(line.split()[1])
        for line in text.splitlines()
        if line.split()[:1] and line.split()[0] in order
    }
    stats = many.stats[(many.stats.metric == "steady_rmse") & (many.stats.signal == "position")]
    medians = stats.groupby("observer")["mean"].median()
    assert order == sorted(order, key=lambda o: (-won[o], medians[o])), "ties by the median, not by the alphabet"


def digits(text):
    """Where a number's last digit stands."""
    body, _, power = text.partition("e")
    return -len(body.partition(".")[2]) + int(power or 0)


@given(st.floats(1e-9, 1e9), st.floats(1e-5, 0.2), st.floats(0.9, 1.1))
def test_value_and_interval_end_at_one_digit(value, part, lean):
    """Two digits of the half interval, and the value is the nearest with as many."""
    half = value * part
    text = number_format.estimate(value, value - half * lean, value + half / lean)
    whole = text.startswith("(")
    mean, sign, width = text.strip("()").partition(" ± ")
    power = "e" + text.rpartition("e")[2] if whole else ""
    mean, width = mean + power, width.partition(")")[0] + power
    assert sign
    assert digits(mean) == digits(width)
    assert 1 <= len(width.partition("e")[0].replace(".", "").lstrip("0")) <= max(2, len(str(int(float(width)))))
    assert abs(float(mean) - value) <= 0.51 * 10.0 ** max(digits(mean), np.floor(np.log10(half * 1.01)) - 1)


def test_what_an_interval_cannot_say_is_said_otherwise():
    nan = float("nan")
    assert number_format.estimate(nan, nan, nan) == "-"
    assert number_format.estimate(3e-12, 1e-12, 9e-12) == "0"
    assert number_format.estimate(0.5, nan, nan) == "0.5 ± ?"
    assert number_format.estimate(5.082, 5.082, 5.082) == "5.082"
    assert number_format.estimate(0.0047, 0.0011, 0.0203) == "0.0047 (0.0011 .. 0.02)", "it leans to one side"
    assert number_format.estimate(36000, 34800, 37200) == "36000 ± 1200"
    assert number_format.estimate(3.9e-10, 3.8e-10, 4.0e-10) == "(3.90 ± 0.10)e-10"
    assert number_format.estimate(0.337, 0.328, 0.346, "+") == "+0.3370 ± 0.0090"


@given(st.lists(st.sampled_from(["0.22 ± 0.01", "1.2600 ± 0.0068", "5", "", "never", "0.5 (0.1 .. 2)"]), min_size=1))
def test_signs_stand_below_one_another(cells):
    out = align_intervals(cells)
    places = {text.index("±") for text in out if "±" in text}
    assert len(places) <= 1
    assert [" ".join(text.split()) for text in out] == cells


def test_what_stands_before_a_sign_ends_there_and_what_stands_behind_it_begins_there():
    assert align_intervals(["0.22 ± 0.01", "11.26 ± 0.0068", "5"]) == [
        " 0.22 ± 0.01  ",
        "11.26 ± 0.0068",
        "    5         ",
    ]


@pytest.mark.parametrize(("width", "left_out"), [(90, []), (55, ["least"]), (40, ["less", "least"])])
def test_where_room_is_scarce_the_least_goes_first(width, left_out):
    columns = [Column("name", ["n" * 20]), Column("less", ["1" * 20], spare=1), Column("least", ["2" * 20], spare=2)]
    console = Screen(file=io.StringIO(), width=width)
    assert console.fit("title", columns) == left_out
    text = console.file.getvalue()
    assert [c.head for c in columns if c.cells[0] not in text] == left_out


@pytest.mark.parametrize(("said", "width"), [("", 100), ("60", 60), ("0", 100), ("wide", 100)])
def test_a_table_in_a_file_is_as_wide_as_columns_says(said, width, monkeypatch):
    monkeypatch.setenv("COLUMNS", said)
    assert shared.console().width == width


def test_signals_are_a_list_with_commas_or_all():
    assert shared.parse_signals("position, velocity") == ["position", "velocity"]
    assert shared.parse_signals(" all ") == []
    assert shared.parse_signals(None) is None


@pytest.mark.nightly
def test_a_narrow_terminal_shows_the_readmes_motor_whole(tmp_path):
    """What a newcomer sees first fits 80 columns, even where more are free."""
    done = call("run", "cart/white", "--seeds", "8", "--out", tmp_path / "out")
    assert "…" not in done.stdout
    tables = [line for line in done.stdout.splitlines() if "±" in line or "observer" in line]
    assert max(map(len, tables)) <= 80


@pytest.mark.parametrize("kind", ["observers", "scenarios", "plants", "studies", "axes", "metrics", "choices"])
def test_everything_there_is_can_be_told_whole(kind):
    from pcbench.cli.catalogue import list_catalogue

    for name, said in list_catalogue(kind).items():
        console = Screen(file=io.StringIO(), width=80)
        lists.print_in_full(name, said, console)
        text = console.file.getvalue()
        assert max(map(len, text.splitlines())) <= 80
        for option, record in said.get("options", {}).items():
            assert f"  {option}: " in text
            assert record["description"].split()[0] in text


@pytest.mark.ci
def test_options_have_type_default_and_range():
    import json

    said = json.loads(call("list", "observers", "pccebo", "--json").stdout)["observers"]["pccebo"]["options"]
    assert said["q"] == {
        "type": "number",
        "range": "> 0",
        "default": 0.002,
        "description": said["q"]["description"],
        "tunable": False,
    }
    assert said["gain"]["choices"] == ["lmi", "riccati", "decay", "h2", "hinf"]
    assert said["L"]["type"] == "matrix"
    text = call("list", "observers", "pccebo").stdout
    assert "q: number > 0, default 0.002" in text
    done = call("list", "observers", "pcebo")
    assert done.returncode == 2
    assert "did you mean 'pccebo'" in done.stderr


def test_a_list_fits_a_screen_line_each():
    text = call("list").stdout
    entries = sum(map(len, (OBSERVERS, SCENARIOS, PLANTS, CONTROLLERS, STUDIES)))
    assert 3 * entries > 2 * len(text.splitlines()), "a line each, titles, and a few that take two"
    each = [line[1:].split(" ")[0] for line in text.splitlines()]
    first = each.index("pccebo")
    assert each[first : first + len(OBSERVERS)] == list(OBSERVERS), "no summary goes on in another line"
    assert pd.Series(text.splitlines()).str.len().max() <= 100
    assert STUDY["scenarios"][0] in text


@pytest.mark.nightly
def test_gains_that_nothing_proves_are_named_with_the_reason(tmp_path, monkeypatch):
    proof = 'Certificate("none: for tests", 1.0, "none", "none")'
    text = OWN.read_text()
    assert proof in text
    (tmp_path / "mine.py").write_text(text.replace(proof, 'pcbench.no_certificate("by hand")'))
    monkeypatch.chdir(tmp_path)
    result = pcbench.run("cart/slow", observers=["mine.py:nudge", "kfbo"], seeds=4)
    screen = Screen(record=True, width=100)
    results.closing(result, screen, "steady_rmse")
    sentence = "No certificate for the gains of nudge (by hand)."
    assert sentence in screen.export_text()
    (table,) = headline.headlines(result, "cart/slow", "position", "steady_rmse")
    assert table.note.endswith(sentence), "and so says the report"


SQUARES = {"nees": (0.7, 0.8, 1.2), "nis": (1.02, 0.95, 1.05)}


def stats_rows(cells, squares=SQUARES):
    """Rows of stats of an observer that is pessimistic of its error and right about its samples, in some cells."""
    rows = []
    for cell in range(cells):
        for metric, (mean, low, high) in squares.items():
            rows.append((cell, "kf", metric, mean, mean, mean))
            rows.append((cell, "kf", f"{metric}_band", 1.0, low, high))
    return pd.DataFrame(rows, columns=["cell", "observer", "metric", "mean", "ci_low", "ci_high"])


@pytest.mark.parametrize(("cells", "exact"), [(1, False), (2, False), (1, True), (30, False)])
def test_who_knows_how_wrong_it_is_stands_in_a_table_with_its_verdict(cells, exact):
    console, stats = Screen(file=io.StringIO(), width=100), stats_rows(cells)
    stats = stats[~stats.metric.str.endswith("band")] if exact else stats
    assert results.print_consistency("cart/slow", stats, console) == [results.MEANS]
    text = console.file.getvalue()
    if cells == 30:
        assert "pessimistic 30" in text
        assert "consistent 30" in text
        return
    assert text.count("0.7 pessimistic" + ("" if exact else " (0.8 .. 1.2)")) == cells
    assert text.count("1.02 optimistic" if exact else "1.02 consistent (0.95 .. 1.05)") == cells
    assert ("grid point" in text.split("observer")[0]) == (cells > 1)


def test_of_who_believes_nothing_nothing_is_said():
    console = Screen(file=io.StringIO(), width=100)
    nothing, refused = stats_rows(1).iloc[:0], stats_rows(1).assign(mean=np.nan)
    for stats in (nothing, refused):
        assert results.print_consistency("cart/slow", stats, console) == []
    assert console.file.getvalue() == ""


@pytest.mark.parametrize(
    ("method", "n", "words"),
    [("runs", 64, "64 seeds"), ("exact", 64, "exact, 64 schedules"), ("exact", 0, "exact")],
)
def test_a_title_says_what_was_averaged_over(method, n, words):
    """Schedules that exact numbers are averaged over had been called seeds."""
    rows = [{"metric": m, "signal": "a", "unit": "m", "n": n, "diverged": 0, "method": method} for m in ("mae", "mse")]
    view = results.View(SimpleNamespace(name="s"), pd.DataFrame(rows), pd.DataFrame(), "mse")
    assert view.title == f"s: error of a [m], {words}"


def test_c_tested_on_a_recording_without_the_truth_has_no_column_of_errors():
    about = SimpleNamespace(signals=[("x", "m")], oldest=3, dt=0.1, newer=0, observer="kf", scenario="lti")
    for error, shown in ((0.5, True), (float("nan"), False)):
        found = {"x": SignalDifference(most=1e-16, differs=1e-17, error=error)}
        console = shared.console()
        console.file = io.StringIO()
        recordings.export_table(SimpleNamespace(about=about), found, found, "the recording", console)
        assert ("rms error" in console.file.getvalue()) == shown
        assert "nan" not in console.file.getvalue()


@pytest.mark.parametrize("width", [30, 60, 80, 200])
def test_a_table_without_room_goes_on_below_and_cuts_no_number(width):
    """Every cell is printed whole; the first columns of text are in each part, and no line is wider than the terminal."""
    names = ["kf", "ekf-iterated"]
    columns = [Column("observer", names, is_text=True)]
    columns += [Column(f"head {i}", [f"{i}.{i}{row}25" for row in (1, 2)]) for i in range(8)]
    screen = Screen(width=width, file=io.StringIO())
    assert screen.fit("a title", columns, [1, 1]) == []
    lines = screen.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for column in columns[1:]:
        assert sum(cell in line.split() for line in lines for cell in column.cells) == 2
        assert sum(column.head in line for line in lines) == 1
    parts = sum("head" in line for line in lines)
    assert [sum(line.strip().startswith(name) for line in lines) for name in names] == [parts, parts]
    assert (parts == 1) == (width == 200)
