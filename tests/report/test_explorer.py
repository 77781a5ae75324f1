"""The interactive figure shows the numbers of the tables, keeps its choices in the address, and requests nothing."""

import http.server
import json
import threading
import time

import numpy as np
import pytest
from browser import CHROMIUM, POLICY, devtools, print_page
from scipy.stats import t as student

import pcbench
from pcbench.plots import frames
from pcbench.report import explorer, page

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("in_a_hurry")]
STUDY = {
    "name": "explored",
    "scenarios": ["cart/gaussian"],
    "observers": ["kf", "kf-ignore-delay", "model-only"],
    "seeds": 8,
    "axes": {"delay": [0.1, 0.4], "noise_std": [0.1, 0.5], "process_std": [[0.02, 0.0]]},
    "options": {"scenario": {"random_initial_state": True, "consistency": True}},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return pcbench.run(STUDY, out=tmp_path_factory.mktemp("explored") / "run")


@pytest.fixture(scope="module")
def report(result, tmp_path_factory):
    file = tmp_path_factory.mktemp("page") / "report.html"
    page.write(result.out, file)
    return file


def number_of(result):
    return json.loads(explorer.numbers(result, "steady_rmse").replace("\\u003c", "<"))


def test_numbers_of_figure_are_those_of_tables(result):
    """Five digits are kept: their rounding is at most 5e-5 of a number."""
    (scenario,) = number_of(result)["scenarios"]
    names = [STUDY["observers"][i] for i in scenario["observers"]]
    assert [axis["name"] for axis in scenario["axes"]] == ["delay", "noise_std"]
    assert len(scenario["cells"]) == 4
    for each in scenario["signals"]:
        for metric, series in each["series"].items():
            rows = result.stats_of("cart/gaussian", each["name"])
            rows = rows[rows.metric == metric].set_index(["observer", "cell"])
            for i, name in enumerate(names):
                for cell in range(4):
                    if (name, cell) not in rows.index or np.isnan(rows["mean"][name, cell]):
                        assert series["mean"][4 * i + cell] is None
                        continue
                    row = rows.loc[(name, cell)]
                    for key, column in (("mean", "mean"), ("low", "ci_low"), ("high", "ci_high")):
                        if key in series and np.isfinite(row[column]):
                            assert series[key][4 * i + cell] == pytest.approx(row[column], rel=5e-5, abs=1e-11)
                    a, b = scenario["cells"][cell]
                    assert (row.delay, row.noise_std) == tuple(
                        axis["values"][k] for axis, k in zip(scenario["axes"], (a, b), strict=True)
                    )


def test_first_signal_is_that_of_the_headline():
    """A figure of twelve signals began with one that nobody asks for."""
    named = {"name": "named", "scenario": {"base": "cart/gaussian", "headline": ["velocity"]}, "observers": ["kf"]}
    (scenario,) = number_of(pcbench.run(named, seeds=2))["scenarios"]
    assert [each["name"] for each in scenario["signals"]][:2] == ["velocity", "position"]


def test_best_and_verdicts_are_those_of_standings(result):
    (scenario,) = number_of(result)["scenarios"]
    names = [STUDY["observers"][i] for i in scenario["observers"]]
    verdicts = set()
    for signal in scenario["signals"]:
        for metric, series in signal["series"].items():
            if "best" not in series:
                continue
            for row in frames.standings(result, "cart/gaussian", signal["name"], metric).to_dict("records"):
                assert names[series["best"][row["cell"]]] == row["best"]
                for i, name in enumerate(names):
                    verdict = series["verdict"][4 * i + row["cell"]]
                    assert verdict == (name not in (*row["leaders"], row["best"])), (metric, row["cell"], name)
                    verdicts.add(verdict)
    assert verdicts == {0, 1}


def test_interval_of_ratio_is_that_of_runs(result, monkeypatch):
    """It is the delta method over paired runs. Rounding: the covariance is a difference of squares."""
    monkeypatch.setattr(explorer, "_rounded", lambda values, digits=0: np.asarray(values, float).ravel().tolist())
    grid = explorer.Grid(STUDY["observers"], [0, 1, 2, 3])
    series = explorer._signal(result, "cart/gaussian", "position", grid)["series"]["steady_rmse"]
    runs, compared = result.runs[result.runs.signal == "position"], 0
    for cell in range(4):
        wide = runs[runs.cell == cell].pivot(index="seed", columns="observer", values="steady_rmse")
        best = wide[STUDY["observers"][series["best"][cell]]].to_numpy()
        for i, name in enumerate(STUDY["observers"]):
            a = wide[name].to_numpy()
            if a is best or np.array_equal(a, best):
                continue
            se = np.std(a / a.mean() - best / best.mean(), ddof=1) / np.sqrt(len(a))
            expected = student.ppf(0.975, len(a) - 1) * se
            assert series["half"][4 * i + cell] == pytest.approx(expected, rel=1e-6)
            compared += 1
    assert compared == 8


needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no browser here: the figure is not drawn")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    opened = devtools(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.process.terminate()
    opened.process.wait()


def ask(browser, expression):
    return browser.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")


def visit(browser, address):
    browser.call("Page.navigate", url="about:blank")
    browser.open(address, "document.readyState == 'complete' && location.href != 'about:blank'", False)


def press(browser, key):
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)


def table(browser):
    """The rows of the table of values, by observer."""
    rows = json.loads(
        ask(
            browser,
            "JSON.stringify([...document.querySelectorAll('#values tbody tr')]"
            ".map(row => [...row.children].map(cell => cell.textContent)))",
        )
    )
    return {row[0]: row[1:] for row in rows}


@needs_browser
def test_choices_in_address_select_values_of_tables(browser, report, result):
    visit(browser, f"{report.as_uri()}#metric=max_abs_error&signal=velocity&noise_std=0.5&x=delay&scale=linear&hide=kf")
    shown = table(browser)
    assert set(shown) == {"kf-ignore-delay", "model-only"}
    assert ask(browser, "document.getElementById('where').textContent") == (
        "cart/gaussian, delay 0.4 s, noise std 0.5 m, 8 runs each"
    )
    rows = result.stats_of("cart/gaussian", "velocity").query(
        "metric == 'max_abs_error' and delay == 0.4 and noise_std == 0.5"
    )
    rows = rows.set_index("observer")
    for name, cells in shown.items():
        value, low, high = (float(rows[c][name]) for c in ("mean", "ci_low", "ci_high"))
        assert cells[0] == f"{value:.4g} ({low:.3g} to {high:.3g}) m/s"
        ratio = value / rows["mean"].min()
        assert cells[1] == "1" if ratio == 1 else cells[1].startswith(f"{ratio:.{3 if ratio > 1.1 else 4}g} (")
    assert ask(browser, "[...document.querySelectorAll('#controls select')].map(s => s.value).join()") == (
        "velocity,max_abs_error,delay,0.5,value,linear"
    )
    assert ask(browser, "document.querySelectorAll('#plot .series polyline').length") == 2


@needs_browser
def test_keys_move_point_and_address_restores_it(browser, report):
    visit(browser, report.as_uri())
    before = table(browser)
    ask(browser, "document.getElementById('plot').focus()")
    press(browser, "ArrowLeft")
    assert "delay 0.1" in ask(browser, "document.getElementById('where').textContent")
    assert "delay 0.1" in ask(browser, "document.getElementById('tip').textContent"), "screen readers hear the value"
    moved, chosen = table(browser), ask(browser, "location.href")
    assert moved != before
    assert "point=0.1" in chosen
    press(browser, "ArrowUp")
    assert ask(browser, "location.href") != chosen, "another observer"
    visit(browser, chosen)
    assert table(browser) == moved


@needs_browser
def test_controls_change_figure_and_address(browser, report):
    visit(browser, report.as_uri())
    ask(
        browser,
        "(() => { const box = document.querySelector('#controls [name=metric]'); box.value = 'nees';"
        " box.dispatchEvent(new Event('change')); })()",
    )
    assert "metric=nees" in ask(browser, "location.hash")
    shown = table(browser)
    assert shown["kf-ignore-delay"][-1] == "optimistic"
    ask(browser, "document.querySelector('#observers [name=kf-ignore-delay]').click()")
    assert "kf-ignore-delay" not in table(browser)
    assert "hide=kf-ignore-delay" in ask(browser, "location.hash")
    ask(browser, "document.getElementById('reset').click()")
    assert "kf-ignore-delay" in table(browser)
    assert ask(browser, "document.querySelector('#controls [name=metric]').value") == "steady_rmse"


@needs_browser
def test_address_with_unknown_choices_shows_default(browser, report):
    visit(browser, report.as_uri())
    default = table(browser)
    visit(browser, f"{report.as_uri()}#metric=%3Cb%3E&signal=x&noise_std=7&x=y&scale=z&point=q&hide=nobody")
    assert table(browser) == default


@needs_browser
def test_page_requests_nothing_and_policy_blocks_what_is_added(browser, report, tmp_path):
    """Without the policy the same additions reach the server, so the test can fail."""
    asked = []

    class Server(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_error(404)

        def log_message(self, *words):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    host = f"http://127.0.0.1:{server.server_port}"
    added = f"<img src='{host}/img'><link rel=stylesheet href='{host}/css'><script>fetch('{host}/js')</script>"
    text = report.read_text()
    for policy in (True, False):
        changed = text.replace("</body>", f"{added}</body>")
        (tmp_path / "changed.html").write_text(changed if policy else POLICY.sub("", changed))
        visit(browser, (tmp_path / "changed.html").as_uri())
        time.sleep(0.3)
        assert {"/img", "/css", "/js"}.isdisjoint(asked) if policy else {"/img", "/css", "/js"} <= set(asked)
    server.shutdown()
    browser.requests.clear()
    visit(browser, f"{report.as_uri()}#metric=nees")
    press(browser, "Tab")
    assert [url for url in browser.requests if not url.startswith((report.as_uri(), "about:", "data:"))] == []


@needs_browser
def test_contents_stay_visible_on_a_wide_page(browser, report):
    size = {"width": 1500, "height": 700, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    visit(browser, report.as_uri())
    ask(browser, "scrollTo(0, document.body.scrollHeight)")
    assert ask(browser, "scrollY") > 1000
    boxes = json.loads(
        ask(
            browser,
            "JSON.stringify([...document.querySelectorAll('nav a, main')].map(each => each.getBoundingClientRect()))",
        )
    )
    assert len(boxes) > 3
    *links, main = boxes
    assert all(0 < box["top"] < box["bottom"] < 700 for box in links)
    assert max(box["right"] for box in links) < main["left"], "they do not overlap the page"
    browser.call("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_page_is_complete_without_script(browser, report):
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    visit_without_script = "document.readyState == 'complete'"
    browser.open(report.as_uri(), visit_without_script, False)
    assert ask(browser, "getComputedStyle(document.getElementById('explore')).display") == "none"
    figures = report.read_text().count("<figure") - 1
    assert (
        ask(browser, "[...document.querySelectorAll('.picture svg')].filter(s => s.clientWidth > 99).length") == figures
    )
    browser.call("Emulation.setScriptExecutionDisabled", value=False)


@needs_browser
def test_print_has_no_controls(report, tmp_path):
    """The PDF has the same texts with and without the script that draws the figure."""
    plain = tmp_path / "plain.html"
    text = report.read_text()
    plain.write_text(text.partition("<script>")[0] + text.rpartition("</script>")[2])
    for folder in ("with", "without"):
        (tmp_path / folder).mkdir()
    assert len(print_page(report, tmp_path / "with")) == len(print_page(plain, tmp_path / "without")) > 300


@needs_browser
def test_dark_mode_changes_page_and_keeps_figures_light(browser, report):
    visit(browser, report.as_uri())
    colours = []
    for scheme in ("light", "dark"):
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        colours.append(
            [
                ask(browser, f"getComputedStyle(document.querySelector('{where}')).backgroundColor")
                for where in ("body", "#explore figure")
            ]
        )
    browser.call("Emulation.setEmulatedMedia", features=[])
    assert colours[0] == ["rgb(255, 255, 255)"] * 2
    assert colours[1] == ["rgb(22, 24, 26)", "rgb(255, 255, 255)"]


@needs_browser
def test_dark_figures_are_as_broad_as_light_ones(browser, report):
    """The white edge of a figure took some of its width: of three in a row each was cut on the right."""
    cut = "document.querySelectorAll('.picture.scrolls').length"
    for scheme in ("light", "dark"):
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        for width in (390, 768, 1024, 1440, 1600):
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            browser.call("Emulation.setDeviceMetricsOverride", **size)
            visit(browser, report.as_uri())
            assert ask(browser, cut) == 0 or width == 390, (scheme, width)
    browser.call("Emulation.clearDeviceMetricsOverride")
    browser.call("Emulation.setEmulatedMedia", features=[])


@needs_browser
def test_a_summary_wider_than_the_page_scrolls_in_its_own_frame(browser, report):
    """At 1024 pixels the summary of 36 scenarios made its page 44 pixels wider than the window."""
    size = {"width": 1024, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    visit(browser, report.as_uri())
    ask(browser, "document.querySelectorAll('#summary td').forEach(cell => cell.textContent = 'x'.repeat(40))")
    assert ask(browser, "document.querySelector('#summary table').scrollWidth") > 1024
    assert ask(browser, "document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0
    browser.call("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_figures_take_the_width_of_the_page(browser, report):
    """At 1024 pixels two figures stood on the left, and a quarter of the page was empty."""
    script = """JSON.stringify([...document.querySelectorAll('.pictures')].filter(box => box.children.length > 1).map(box =>
        [Math.max(...[...box.children].map(each => each.getBoundingClientRect().right)), box.getBoundingClientRect().right]))"""
    for width in (1024, 1600):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        visit(browser, report.as_uri())
        ends = json.loads(ask(browser, script))
        assert ends
        assert all(0.93 * page < right <= page + 1 for right, page in ends)
    browser.call("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_figures_at_the_head_leave_no_half_of_a_row_empty(browser, report):
    """At 1024 pixels the third of three figures had a row of its own; a single one has its caption at its right."""
    script = """JSON.stringify([...document.querySelectorAll('#summary figure')].map(each => {
        const box = each.getBoundingClientRect(); return [box.left, box.top, box.bottom]; }))"""
    for width, columns in ((390, 1), (1024, 2), (1600, 3)):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        visit(browser, report.as_uri())
        places = json.loads(ask(browser, script))
        assert len(places) == 3
        assert len({left for left, *_ in places}) == columns
        assert sum(top < places[0][2] for _, top, _ in places) == columns, "as many begin above the end of the first"
    alone = """(() => { const [first, ...others] = document.querySelectorAll('#summary figure');
        others.forEach(each => each.remove()); first.parentElement.classList.remove('columns');
        const [picture, caption] = first.querySelectorAll('.picture, figcaption');
        return caption.getBoundingClientRect().left - picture.getBoundingClientRect().right; })()"""
    assert 0 < ask(browser, alone) < 100
    browser.call("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_significance_is_read_without_scrolling(browser, report):
    """In the table of the interactive figure, "not significantly worse, p = 0.06" was cut off at 1024 pixels."""
    size = {"width": 1024, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    visit(browser, report.as_uri())
    cells = ["high-gain-predictor", "0.004695 (0.00371 to 0.00594) rad", "16", "2 of 16 runs", "1.91 (1.31 to 2.79)"]
    row = "".join(f"<td>{cell}</td>" for cell in [*cells, "not significantly worse, p = 0.066"])
    table = "document.querySelector('#values')"
    ask(browser, f"{table}.innerHTML = '<tr>{row}</tr>'")
    wide = f"{table}.parentElement.scrollWidth - {table}.parentElement.clientWidth"
    assert ask(browser, wide) <= 0
    browser.call("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_long_names_of_rows_are_whole(browser, report):
    """At the left of the interactive figure the first letter of mhe-bounded-published was cut off."""
    visit(browser, report.as_uri())
    out = ask(
        browser,
        """(() => {
        data.observers[0].name = "MMMMMMMMMM-WWWWWWWWWW"; change({x: OBSERVER});
        const edge = byId("plot").getBoundingClientRect().left;
        return Math.min(...[...byId("plot").querySelectorAll("text")].map(t => t.getBoundingClientRect().left - edge)); })()""",
    )
    assert out >= 0


@needs_browser
def test_two_errors_of_zero_are_equal(browser, report):
    """They have no ratio, and "not tested" contradicted the tables."""
    visit(browser, report.as_uri())
    said = {}
    for ratio, value in ((1, 0.2), (1.5, 0.3), ("null", 0), ("null", 0.3)):
        point = f"{{best: {{}}, isBest: false, verdict: 0, p: null, ratio: {ratio}, value: {value}}}"
        said[ratio, value] = ask(browser, f"verdict({point})")
    assert [pair for pair, words in said.items() if words == "equal"] == [(1, 0.2), ("null", 0)]


@needs_browser
def test_text_below_figures_keeps_a_distance(browser, report):
    """In dark mode the text touched the white edge of a single figure."""
    visit(browser, report.as_uri())
    script = """(() => { const box = document.querySelector('#summary .pictures'), [first, ...others] = box.children;
        others.forEach(each => each.remove()); box.classList.remove('columns');
        return box.nextElementSibling.getBoundingClientRect().top - first.getBoundingClientRect().bottom; })()"""
    assert ask(browser, script) > 8


@needs_browser
def test_two_figures_stand_side_by_side_on_paper(browser, report):
    """Of figures that did not fit side by side, each had a page of its own."""
    size = {
        "width": 718,
        "height": 1000,
        "deviceScaleFactor": 1,
        "mobile": False,
    }  # A4 without margins, and a scroll bar
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    browser.call("Emulation.setEmulatedMedia", media="print")
    visit(browser, report.as_uri())
    script = """JSON.stringify([...document.querySelectorAll('section[id^=scenario] .pictures')].map(box =>
        [...box.children].map(each => each.getBoundingClientRect().top)))"""
    tops = json.loads(ask(browser, script))
    browser.call("Emulation.setEmulatedMedia", media="")
    browser.call("Emulation.clearDeviceMetricsOverride")
    assert any(len(set(top)) < len(top) for top in tops)


@needs_browser
def test_notes_are_not_larger_than_the_text_on_paper(browser, report):
    """Their size was relative to that of a screen, and the text had its own size."""
    browser.call("Emulation.setEmulatedMedia", media="print")
    visit(browser, report.as_uri())
    script = """JSON.stringify(['#summary > p', 'p.soft', 'figcaption', 'dl', 'table'].map(each =>
        parseFloat(getComputedStyle(document.querySelector(each)).fontSize)))"""
    text, *others = json.loads(ask(browser, script))
    browser.call("Emulation.setEmulatedMedia", media="")
    assert text == pytest.approx(10 * 96 / 72, abs=0.01)
    assert max(others) < text


@needs_browser
def test_notes_stay_with_their_tables_on_paper(browser, report):
    """A note began the page after that of its table, and tables of three rows were on two pages."""
    browser.call("Emulation.setEmulatedMedia", media="print")
    visit(browser, report.as_uri())
    note = ask(browser, "getComputedStyle(document.querySelector('.data').closest('.wide').parentNode"
                        ".querySelector('p.soft')).breakBefore")  # fmt: skip
    tables = """JSON.stringify([...document.querySelectorAll('.data')].map(table =>
        [table.tBodies[0].rows.length, getComputedStyle(table).breakInside]))"""
    shapes = json.loads(ask(browser, tables))
    long = "document.querySelector('.data').tBodies[0].innerHTML = '<tr><td>x</td></tr>'.repeat(9), getComputedStyle("
    inside = ask(browser, f"({long}document.querySelector('.data')).breakInside)")
    browser.call("Emulation.setEmulatedMedia", media="")
    assert note == "avoid"
    assert {inside for rows, inside in shapes if rows < 9} == {"avoid"}
    assert inside == "auto", "a long table may go on"


@needs_browser
def test_axis_of_the_interactive_figure_has_more_than_one_tick(browser, report):
    visit(browser, report.as_uri())
    assert all(ask(browser, f"ticks({low}, {3.5 * low}, true).length") > 2 for low in (0.024, 1.1, 1.9, 2.6, 4.2))


@needs_browser
def test_units_of_an_axis_are_those_of_numbers_not_of_words(browser, report):
    visit(browser, report.as_uri())
    said = {
        "0.1": "0.1 s",
        "∞": "∞ s",
        "none": "none",
        "0, 0.1, lost": "0, 0.1, lost",
        "y1: 0, y2: 1": "y1: 0 s, y2: 1 s",
    }
    assert {word: ask(browser, f"withUnit({json.dumps(word)}, 's')") for word in said} == said
