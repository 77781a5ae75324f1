"""The report opens offline in a browser, draws every chart, and says the numbers of the tables."""

import html
import json
import re
import shutil
import subprocess

import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.plots import palette
from pcbench.report import figures, lines, page
from pcbench.statistics import wording

pytestmark = pytest.mark.usefixtures("in_a_hurry")

STUDY = {
    "name": "map",
    "scenarios": ["cart/white"],
    "observers": ["pccebo", "kfbo", "dkf"],
    "seeds": 24,
    "axes": {"delay": [0.2, 0.4], "noise_std": [0.1, 0.5], "sampling_period": [0.1, 0.2]},
}
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)


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


def specs(text):
    return json.loads(re.search(r"^const SPECS = (.*);$", text, re.M).group(1))


def test_it_is_one_file_that_needs_no_other(text):
    assert len(text.encode()) < 3e6
    own = text.partition("<script>")[0]
    assert not re.search(r'(src|href)="(?!#|data:)', own)
    assert "@import" not in own


def test_every_chart_has_its_place_a_text_and_units(text):
    found = specs(text)
    assert len(found) == 7, "distribution, winners, map, three curves, time"
    for key, spec in found.items():
        label = re.search(rf'id="{key}" role="img" aria-label="([^"]+)"', text).group(1)
        assert len(html.unescape(label)) > 40
        titles = re.findall(r'"title": ?"([^"]*)"', json.dumps({k: v for k, v in spec.items() if k != "datasets"}))
        assert any("[m]" in t or "[s]" in t for t in titles), titles


def test_its_table_has_the_numbers_of_the_tables(folder, text):
    result = pcbench.opened(folder)
    mine = result.stats.query("metric == 'tail_rmse' and signal == 'position'")
    for observer, median in mine.groupby("observer")["mean"].median().items():
        assert re.search(rf"</span>{observer}</td><td>\d+</td><td>{median:.4g}</td>", text), observer
    rows = re.findall(r"</span>(\S+)</td><td>(\d+)</td><td>([^<]+)</td>", text)
    order = [(-int(wins), float(median)) for _, wins, median in rows]
    assert order == sorted(order), "who wins most stands first"
    assert order[0][0] < order[-1][0] <= 0
    assert "8 combinations of axis values" in text
    assert result.provenance["study_sha256"] in text
    assert "pcbench run study.toml" in text


@pytest.mark.slow
def test_few_cells_stand_in_full_with_significance_against_the_best(tmp_path):
    result = pcbench.run(STUDY | {"axes": {}}, out=tmp_path / "one")
    text = page.page(pcbench.opened(tmp_path / "one"))
    (best,) = re.findall(r'<tr class="best"><td>.*?</span>(\S+)</td>', text)
    assert best == "dkf"
    assert "less the best [m]" in text
    for metric in ("tail_rmse", "efficiency"):
        (row,) = result.stats.query(f"metric == '{metric}' and signal == 'position' and observer == 'dkf'").to_dict(
            "records"
        )
        assert f">{wording.interval(row)}<" in text


@pytest.mark.skipif(CHROMIUM is None, reason="no browser here")
def test_a_browser_draws_every_chart_and_complains_of_nothing(folder, text):
    probe = folder / "probe.html"
    tail = "<script>setTimeout(() => { document.title = 'drawn ' + window.drawn + ' of ' + window.wanted; }, 6000);</script>"
    before, _, after = text.rpartition("</body>")
    probe.write_text(before + tail + "</body>" + after)
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000"]
    words += ["--enable-logging=stderr", "--v=0", "--dump-dom", probe.as_uri()]
    done = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    many = len(specs(text))
    assert f"<title>drawn {many} of {many}</title>" in done.stdout
    assert done.stdout.count('class="marks"') == many
    assert "CONSOLE" not in done.stderr, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def test_pictures_for_papers_are_written_whole(folder, tmp_path):
    names = figures.write(pcbench.opened(folder), tmp_path / "figures")
    assert len(names) == len(set(names)) == 7
    for name in names:
        svg, png = ((tmp_path / "figures" / f"{name}.{kind}").read_bytes() for kind in figures.KINDS)
        assert svg.rstrip().endswith(b"</svg>")
        assert png.startswith(b"\x89PNG")


def test_the_command_says_where_the_page_is(folder, tmp_path):
    done = call("report", str(folder), "--out", str(tmp_path / "a" / "page.html"))
    assert "which opens in any browser" in done.stdout, done.stderr
    assert (tmp_path / "a" / "page.html").exists()


def test_a_folder_without_results_is_one_sentence(tmp_path):
    done = call("report", str(tmp_path))
    assert done.returncode == 2
    assert "holds no study.toml" in done.stderr
    with pytest.raises(UserError, match="holds no study"):
        pcbench.opened(tmp_path)


def contrast(a, b):
    """WCAG's ratio of two colours."""

    def light(c):
        parts = [int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((light(a), light(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_every_observer_has_a_colour_of_its_own_that_is_seen_on_white():
    assert set(palette.COLOURS) == set(OBSERVERS)
    assert len(set(palette.COLOURS.values())) == len(palette.COLOURS)
    for colour in palette.COLOURS.values():
        assert contrast(colour, "#FFFFFF") > 2.0, colour


def test_a_label_keeps_its_colour_whatever_stands_beside_it():
    alone = palette.styles(["dkf"])["dkf"]
    assert palette.styles(["kfbo", "dkf", "dkf-bias"])["dkf"] == alone
    three = palette.styles(["pccebo-paper", "pccebo-design", "pccebo-tuned"])
    assert len({s.colour for s in three.values()}) == 3
    assert len({s.dash for s in three.values()}) == 3


def test_a_label_has_its_bases_colour_where_that_stands_not_beside_it():
    assert palette.styles(["kfbo", "dkf-bias"])["dkf-bias"].colour == palette.COLOURS["dkf"]
    both = palette.styles(["dkf", "dkf-bias"])
    assert both["dkf"].colour == palette.COLOURS["dkf"] != both["dkf-bias"].colour


def test_a_run_in_time_says_in_words_where_it_ends():
    rows = [("plant", "truth", t, float(t)) for t in range(3)]
    rows += [("kfbo", "estimate", t, 0.5 * t) for t in range(3)] + [("measured", "measured", 2, 9.0)]
    drawn = lines.time(pd.DataFrame(rows, columns=["series", "kind", "t", "value"]), ["kfbo"], "position", "m", 3)
    assert drawn.text == "At the end: plant 2, kfbo 1 m."
    assert drawn.title == "One run in time (seed 3)"


GROWING = {"name": "grow", "scenarios": ["cart/white"], "observers": ["pccebo"], "seeds": 2}


def series(out):
    found = specs(page.page(pcbench.opened(out)))["chart-0-1"]
    return json.dumps(found["datasets"])


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
    pcbench.run(GROWING | {"observers": ["pccebo", "kfbo"], "root_seed": 9}, out=out, fresh=True)
    assert series(out) != second


def test_one_run_is_sure_of_nothing_and_divergence_is_said(tmp_path):
    unstable = {"sampled_innovation": True, "R": 1e-6}
    study = {"name": "lost", "scenarios": ["cart/slow"], "observers": ["pccebo", "kfbo"], "options": {"kfbo": unstable}}
    pcbench.run(study | {"seeds": 16}, out=tmp_path / "lost")
    text = html.unescape(page.page(pcbench.opened(tmp_path / "lost")))
    assert "diverges more often" in text
    assert "kfbo (diverged in every run)" in text
    assert "nan" not in text.partition("<script>")[0].replace("nan-", "")
    pcbench.run(GROWING | {"observers": ["pccebo", "kfbo"], "seeds": 1}, out=tmp_path / "one")
    text = page.page(pcbench.opened(tmp_path / "one"))
    assert "One run each" in text
    assert " ± ?" in text


def test_what_a_user_names_cannot_end_the_script(folder, text):
    result, unit = pcbench.opened(folder), "</script><script>m"
    result.stats["unit"] = unit
    named = page.page(result)
    assert unit not in named
    assert f"[{unit}]" in json.dumps(specs(named)), "it stands there, as a text"
    for each in (text, named):
        assert "<" not in re.search(r"^const SPECS = (.*);$", each, re.M).group(1)
