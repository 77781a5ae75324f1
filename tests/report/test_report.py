"""The report is one page that needs no other, says the numbers of the tables, and what was run. How it looks: `test_layout`."""

import html
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import frames, labels, layout
from pcbench.report import captions, experiment, figures, page, summary
from pcbench.statistics import number_format
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

STUDY = {
    "name": "map",
    "scenarios": ["cart/white"],
    "observers": ["pccebo", "kfbo", "kf"],
    "seeds": 24,
    "axes": {"delay": [0.2, 0.4], "noise_std": [0.1, 0.5], "sampling_period": [0.1, 0.2]},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "map"
    pcbench.run(STUDY, out=out)
    return out


@pytest.fixture(scope="module")
def text(folder):
    size = page.write(folder, folder / "report.html")
    content = (folder / "report.html").read_text()
    assert size == len(content.encode())
    return content


def figure(text, name):
    """One picture of the page, with its words."""
    return re.search(rf'<figure id="{re.escape(name)}".*?</figure>', text, re.S).group(0)


@pytest.mark.ci
def test_it_is_one_file_that_needs_no_other(text):
    assert len(text.encode()) < 1e6
    assert not re.search(r'(src|href)="(?!#|data:)', text)
    assert "@import" not in text
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids)), "no picture's name is another's"


def test_experiment_shows_default_values_of_axes_in_words():
    axes = {
        "sampling_pattern": ["periodic", "sine"],
        "assumed_noise_scale": [1.0, 2.0],
        "student_t_dof": [float("inf"), 3.0],
    }
    axes |= {"actuator_delay": [0.1], "loss": [0.0, 0.2]}
    study = parse.grid_of({"name": "x", "scenarios": ["cart/white"], "observers": ["kf"], "axes": axes}, {}, []).study
    facts = {f.what: f.text for f in experiment.experiment(SimpleNamespace(study=study), "cart/white").facts}
    assert facts["sampling pattern"] == "periodic | sine"
    assert facts["assumed measurement noise (std)"] == "1 times the true one | 2 times the true one"
    assert facts["distribution of the measurement noise"] == "Gaussian | Student's t, 3 degrees of freedom"
    assert facts["lost samples"] == "none | 20 %"
    assert facts["actuator delay"] == "0.1 s"


def test_experiment_shows_wrong_assumptions():
    """Scenarios that differed by them only were described alike."""
    wrong = {"assumed_process_std": [0.0025, 0.025], "parameters": {"b": 390.5}}
    noise = {"base": "cart/white", "process_std": [0.01, 0.1]}
    scenarios = {"right": noise, "wrong": noise | wrong}
    raw = {"name": "x", "scenarios": scenarios, "observers": ["kf"]}
    study = parse.grid_of(raw, {}, []).study
    facts = {
        name: {f.what: f.text for f in experiment.experiment(SimpleNamespace(study=study), name).facts}
        for name in scenarios
    }
    assert facts["wrong"].pop("assumed process noise per tick (std)") == "position 0.0025 m, velocity 0.025 m/s"
    assert facts["wrong"].pop("true parameters, if not nominal") == "b 390.5"
    assert facts["wrong"] == facts["right"]
    raw = {"name": "x", "scenarios": ["cart/white"], "observers": ["kf"], "axes": {"process_std": [[0.01, 0.1]]}}
    study = parse.grid_of(raw, {}, []).study
    shown = [f.what for f in experiment.experiment(SimpleNamespace(study=study), "cart/white").facts]
    assert "process noise per tick (std)" in shown
    assert "assumed process noise per tick (std)" not in shown, "it is the true one"


def test_small_numbers_of_tables_are_powers_of_ten_as_everywhere_on_the_page():
    """A page had "(1.03 ± 0.13)e-05" in one table and "1.98·10⁻⁵" in another."""
    assert page._unbroken("(1.03 ± 0.13)e-05") == "(1.03 ±&nbsp;0.13)·10⁻⁵"
    assert page._unbroken("(+1.2 ± 0.3)e+12") == "(+1.2 ±&nbsp;0.3)·10¹²"
    assert page._unbroken("pose-05, 5.02 ± 0.1") == "pose-05, 5.02 ±&nbsp;0.1"
    row = {
        "cell": 0,
        "metric": "steady_rmse",
        "mean": 1.03e-5,
        "ci_low": 0.9e-5,
        "ci_high": 1.16e-5,
        "n": 9,
        "diverged": 0,
    }
    row |= {"se": 6.5e-7, "method": "t"}
    assert summary._value(pd.DataFrame([row]), "1/ft").endswith(")·10⁻⁵ 1/ft")


def test_options_by_name_are_words():
    """They were in the braces and quotes of Python."""
    raw = {"name": "x", "scenarios": ["flexible-joint/sampled"], "observers": ["lmi-sampled"]}
    raw |= {"options": {"lmi-sampled": {"parameter_range": {"gravity": [-3.33, 3.33]}, "max_interval": 0.28}}}
    result = SimpleNamespace(study=parse.grid_of(raw, {}, []).study)
    facts = {f.what: f.text for f in experiment.experiment(result, "flexible-joint/sampled").facts}
    assert "parameter_range gravity [-3.33, 3.33]" in facts["observers"]
    assert {o.name: o.value for o in experiment.rows(result)}["parameter_range"] == "gravity [-3.33, 3.33]"


def test_noise_of_a_nonlinear_sensor_has_the_unit_of_its_output():
    """The report of a radar had "10, 0.003162", and an axis in the "unit of the output"."""
    study = parse.grid_of({"name": "x", "scenarios": ["coordinated-turn/radar"], "observers": ["ekf"]}, {}, []).study
    facts = {
        f.what: f.text for f in experiment.experiment(SimpleNamespace(study=study), "coordinated-turn/radar").facts
    }
    assert facts["measurement noise (std)"] == "y1: 10 m, y2: 0.003162 rad"
    assert re.fullmatch(
        r"position x 0.1826 m, velocity x 0.3162 m/s, position y 0.1826 m, velocity y 0.3162 m/s, turn rate .* rad/s, "
        "correlated by a matrix 5 x 5",
        facts["process noise per tick (std)"],
    )


def test_options_that_differ_from_their_defaults_are_listed_with_their_origin():
    tuned = {"scenario": "cart/slow", "cell": {"delay": 0.2}, "metric": "rmse", "signal": "position"}
    study = {
        "name": "set",
        "scenarios": ["cart/slow"],
        "observers": ["kf-push", "pccebo", "model-only"],
        "axes": {"delay": [0.2, 0.4]},
        "options": {"kf-push": {"bias_variance": 0.25}, "pccebo": {"L": [[0.5], [0.125]], "gain": "lmi"}},
        "tuned": tuned | {"options": {"pccebo": {"L": [[0.5], [0.125]]}, "kf-push": {"bias_variance": 9.0}}},
    }
    read_study = parse.grid_of(study, {}, []).study
    rows = experiment.rows(SimpleNamespace(study=read_study))
    assert [(o.value, o.tuned) for o in rows if (o.observer, o.name) == ("pccebo", "L")] == [("[[0.5], [0.125]]", True)]
    (push,) = [o for o in rows if o.observer == "kf-push"]
    assert push[1:] == ("bias_variance", "0.25", "none", False, "the study"), (
        "no bias is estimated by default; 0.25 is not the tuned value"
    )
    assert not [o for o in rows if o.observer == "model-only"]
    assert read_study.tuning_sentence == (
        "The gains of pccebo, kf-push were tuned for rmse of position in cart/slow at delay = 0.2. "
        "The other grid points use the same gains."
    )


@pytest.mark.ci
def test_every_option_that_is_not_a_default_is_in_the_report(folder, text):
    section = re.search(r'<section id="options">.*?</section>', text, re.S).group(0)
    assert len(re.findall(r"<tr><td>", section)) == len(experiment.rows(pcbench.open_result(folder)))
    assert "the scenario" in section


@pytest.mark.ci
def test_every_picture_has_its_place_a_text_and_a_unit(text):
    names = re.findall(r'<figure id="([^"]+)"', text)
    parts = [
        "ratios",
        "time",
        "bands",
        "winners",
        "map",
        "over-sampling_period",
        "over-delay",
        "over-noise_std",
        "distribution",
        "convergence",
        "cost",
    ]
    assert names == [
        f"cart-white-position-{parts[0]}",
        "regrets",
        "profiles",
        *(f"cart-white-position-{part}" for part in parts[1:]),
    ]
    for name in names:
        mine = figure(text, name)
        assert len(html.unescape(re.search(r'aria-label="([^"]+)"', mine).group(1))) > 40
        said = " ".join(
            html.unescape(t) for t in re.findall(r"<text[^>]*>([^<]*)</text>", mine)
        )  # a title may be folded
        assert re.search(r"\[(m|s|-|%\sof\sit)\]", said), said


def test_its_tables_and_its_summary_have_the_numbers_of_the_tables(folder, text):
    result = pcbench.open_result(folder)
    mine = result.stats.query("metric == 'steady_rmse' and signal == 'position'")
    for observer, median in mine.groupby("observer")["mean"].median().items():
        assert re.search(
            rf"</span>{observer}</td><td>\d+</td><td>\d+</td><td>{layout.number(float(f'{median:.4g}'))}</td>", text
        )
    counted = text.partition("<h4>Operations</h4>")[0]
    rows = re.findall(r"</span>(\S+)</td><td>(\d+)</td><td>\d+</td><td>([^<]+)</td>", counted)
    order = [(-int(wins), float(median)) for _, wins, median in rows]
    assert order == sorted(order), "who wins most stands first"
    won = frames.standings(result, "cart/white", "position", "steady_rmse").winner.value_counts()
    for observer, wins, _ in rows:
        assert int(wins) == won.get(observer, 0)
        assert re.search(rf"{observer} {wins}(</strong>)? of 8", text), "and so says the summary"
    assert f"{won.max()} of 8 grid points" in text
    cell = frames.key_cell(result, "cart/white", "position", "steady_rmse")
    for row in mine[mine.cell == cell].to_dict("records"):
        assert f">{number_format.interval(row)}</td>" in text.replace("&nbsp;", " ")
    assert "8 combinations of axis values" in text
    assert result.provenance["study_sha256"] in text
    assert "pcbench run study.toml" in text


def test_its_pictures_have_the_means_the_intervals_and_the_winners_of_the_tables(folder, text):
    result = pcbench.open_result(folder)
    found = frames.standings(result, "cart/white", "position", "steady_rmse")
    said = html.unescape(figure(text, "cart-white-position-winners"))
    tips = re.findall(r"<title>(.*?), sampling|<title>(.*?), delay", said)
    assert len(tips) == len(found) == 8
    assert sum("significantly" in a + b for a, b in tips) == (found.winner != "").sum()
    cell = frames.key_cell(result, "cart/white", "position", "steady_rmse")
    at = frames.values_at(found.assign(cell=found.cell), cell)
    drawn = [
        p
        for p in figures.of_signal(
            figures.scenario_data(result, ["cart/white"], figures.DEFAULTS)["cart/white"], "position"
        )
        if "over-delay" in p.name
    ]
    (ax,) = drawn[0].figure.axes
    rows = result.stats.query("metric == 'steady_rmse' and signal == 'position' and observer == 'kfbo'")
    rows = rows[(rows.noise_std == at["noise_std"]) & (rows.sampling_period == at["sampling_period"])].sort_values(
        "delay"
    )
    (dots,) = [line for line in ax.get_lines() if line.get_label() == "kfbo"]
    np.testing.assert_allclose(dots.get_ydata(), rows["mean"])
    bars = [np.array(c.get_segments())[:, :, 1] for c in ax.collections]
    assert any(np.allclose(bar, rows[["ci_low", "ci_high"]]) for bar in bars)


def test_it_says_the_experiment_that_was_run_not_the_one_that_was_published(text):
    said = re.sub(r"<[^>]+>", " ", html.unescape(text))
    assert "This study changes: sampling period, delay, noise std (see below)." in said
    for fact in ("0.1 s | 0.2 s", "0.2 s | 0.4 s", "0.1 m | 0.5 m", "10 s, in ticks of 0.001 s"):
        assert fact in said, fact
    model = re.search(r"A =<table>(.*?)</table>", text, re.S).group(1)
    assert re.findall(r"<td>([^<]+)</td>", model) == ["0", "1", "0", "-122"]


@pytest.mark.nightly
def test_signals_the_metric_and_the_cell_can_be_chosen(folder, tmp_path):
    done = call(
        "report",
        str(folder),
        "-o",
        str(tmp_path / "p.html"),
        "--signal",
        "all",
        "--metric",
        "max_abs_error",
        "--grid-point",
        "5",
    )
    text = (tmp_path / "p.html").read_text()
    assert done.returncode == 0, done.stderr
    assert re.findall(r"<h3>Error of (\w+)", text) == ["position", "velocity"]
    assert "Ranked by <code>max_abs_error</code>: largest |e|" in html.unescape(text)
    cell = pcbench.open_result(folder).stats.query("cell == 5").iloc[0]
    assert f"delay {cell.delay:g} s, noise std {cell.noise_std:g}" in re.sub(r"<[^>]+>", "", text)
    for words, sentence in (
        (["--grid-point", "99"], "--grid-point: got 99"),
        (["--metric", "recovery_time"], "no signal shown has"),
    ):
        assert sentence in call("report", str(folder), "-o", str(tmp_path / "q.html"), *words).stderr


@pytest.mark.nightly
def test_few_cells_stand_in_full_with_significance_against_the_best(tmp_path):
    result = pcbench.run(STUDY | {"axes": {}}, out=tmp_path / "one")
    text = page.page(pcbench.open_result(tmp_path / "one"))
    (best,) = re.findall(r'<tr class="best"><td>.*?</span>(\S+)</td>', text)
    assert best == "kf"
    assert "diff. to best [m]" in text
    assert "significant, p &lt; 0.001" in text
    for metric in ("steady_rmse", "rms_efficiency"):
        (row,) = result.stats.query(f"metric == '{metric}' and signal == 'position' and observer == 'kf'").to_dict(
            "records"
        )
        assert f">{number_format.interval(row)}<" in text.replace("&nbsp;", " ")


@pytest.mark.ci
def test_pictures_for_papers_are_those_of_the_page_with_text_as_text(folder, text, tmp_path):
    names = figures.write(
        pcbench.open_result(folder), tmp_path, options=figures.FigureOptions(paper=plots.Paper(3.3, 8.0))
    )
    assert sorted(names) == sorted(re.findall(r'<figure id="([^"]+)"', text))
    for name in names:
        svg, pdf, png = ((tmp_path / f"{name}.{kind}").read_bytes() for kind in figures.KINDS)
        assert re.findall(rb"<text[^>]*>([^<]+)<", svg)
        assert re.search(rb'width="(237.6|475.2|\d+(\.\d+)?)pt"', svg)
        assert pdf.startswith(b"%PDF")
        assert b"/FontFile2" in pdf, "letters, not outlines"
        assert png.startswith(b"\x89PNG")


@pytest.mark.ci
def test_the_command_says_where_the_page_is_and_refuses_what_is_none(folder, tmp_path):
    done = call("report", str(folder), "--out", str(tmp_path / "a" / "page.html"))
    assert "which opens in any browser" in done.stdout, done.stderr
    assert (tmp_path / "a" / "page.html").exists()
    for words, sentence in (
        (["--formats", "svg,gif"], "'gif' is no file format"),
        (["--width", "0.5"], "--width: got 0.5"),
        (["--size", "99"], "--size: got 99"),
        (["--out", "page.html"], "--out: got page.html together with --figures"),
    ):
        done = call("report", str(folder), "--figures", str(tmp_path / "f"), *words)
        assert done.returncode == 2
        assert sentence in done.stderr


@pytest.mark.ci
def test_a_folder_without_results_is_one_sentence(tmp_path):
    done = call("report", str(tmp_path))
    assert done.returncode == 2
    assert "contains no study.toml" in done.stderr
    with pytest.raises(UserError, match="contains no study"):
        pcbench.open_result(tmp_path)


def test_every_picture_says_its_numbers_whole(folder, text):
    """Digits are left out of where things stand, not of what is said: a delay of 0.0125 s is not one of 0.01 s."""
    ticks = ["0.0125", "0.0375"]
    with layout.sheet(plots.Paper(), "") as (drawn, (ax,)):
        for side in "xy":
            layout.set_values(ax, side, [0.0125, 0.0375])
    written = labels.inline(drawn, "x")
    assert all(written.count(f">{tick}<") == 2 for tick in ticks)
    assert not re.search(r'd="[^"]*\d\.\d{3}', written)


def test_a_run_in_time_says_in_words_where_it_ends():
    rows = [("plant", "truth", t, float(t)) for t in range(3)]
    rows += [("kfbo", "estimate", t, 0.5 * t) for t in range(3)] + [("measured", "measured", 2, 9.0)]
    run = pd.DataFrame(rows, columns=["series", "kind", "t", "value"])
    with layout.sheet(plots.Paper(), "") as (drawn, _):
        pass
    assert captions.time(run, "m", drawn)[0] == "At the end: plant 2 m, kfbo 1 m."


GROWING = {"name": "grow", "scenarios": ["cart/white"], "observers": ["pccebo"], "seeds": 2}


def series(out):
    return figure(page.page(pcbench.open_result(out)), "cart-white-position-time")


@pytest.mark.nightly
def test_a_run_in_time_is_of_the_study_as_it_stands(tmp_path):
    """A study that has grown, or was started over with other draws, is not shown with the run of before."""
    out = tmp_path / "grow"
    pcbench.run(GROWING, out=out)
    first = series(out)
    assert series(out) == first
    pcbench.run(GROWING | {"observers": ["pccebo", "kfbo"]}, out=out)
    second = series(out)
    assert "kfbo" in second
    assert "kfbo" not in first
    pcbench.run(GROWING | {"observers": ["pccebo", "kfbo"], "root_seed": 9}, out=out, overwrite=True)
    assert series(out) != second


@pytest.mark.nightly
def test_one_run_is_sure_of_nothing_and_divergence_is_said(tmp_path):
    unstable = {"sampled_innovation": True, "R": 1e-6}
    study = {"name": "lost", "scenarios": ["cart/slow"], "observers": ["pccebo", "kfbo"], "options": {"kfbo": unstable}}
    pcbench.run(study | {"seeds": 16}, out=tmp_path / "lost")
    text = html.unescape(page.page(pcbench.open_result(tmp_path / "lost")))
    assert "diverges more often" in text
    assert "kfbo ∞" in text
    assert "nan" not in text.partition("<script>")[0].replace("nan-", "")
    pcbench.run(GROWING | {"observers": ["pccebo", "kfbo"], "seeds": 1}, out=tmp_path / "one")
    text = page.page(pcbench.open_result(tmp_path / "one"))
    assert "One run each" in text
    assert " ± ?" in text


@pytest.mark.ci
def test_what_a_user_names_stays_text(folder, text):
    result, unit = pcbench.open_result(folder), "</svg><script>m"
    result.stats["unit"] = unit
    named = page.page(result)
    assert "<script>m" not in named
    assert html.escape(f"[{unit}]", quote=False) in named, "it stands there, as a text"
    assert named.count("<script>") == text.count("<script>") == 1


@pytest.mark.ci
def test_a_closed_loop_shows_whether_it_settles():
    """Errors of the estimates say nothing of it: a loop that oscillates has the same ones."""
    result = pcbench.run(
        {"name": "loop", "scenarios": ["ncs-two-state/held", "cart/white"], "observers": ["kf"], "seeds": 3}
    )
    held, cart = summary.rows(result, summary.rankings(result, "steady_rmse", None))
    mine = result.stats_of("ncs-two-state/held", "position")
    (row,) = mine[mine.metric == "steady_tracking_rmse"].to_dict("records")
    assert held.loop == f"{number_format.interval(row)} m"
    assert cart.loop == "", "it follows no set point"
    text = page.page(result)
    assert f'<td data-of="steady_tracking_rmse">{held.loop}</td>' in text
    assert '<td data-of="steady_tracking_rmse">-</td>' in text
    open_loop = pcbench.run({"name": "open", "scenarios": ["cart/white"], "observers": ["kf"], "seeds": 3})
    assert "tracking" not in page.page(open_loop).partition('<script id="numbers"')[0]
