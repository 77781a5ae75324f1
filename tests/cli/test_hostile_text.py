"""Text of a study is text wherever it is printed or written: no markup, mathematics, LaTeX, HTML, code or escape in it acts."""

import io
import re
import tomllib
import unicodedata
from html.parser import HTMLParser
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.text import Text
from rich.progress import Progress, TextColumn

import pcbench
from pcbench.cli import lists
from pcbench.cli.commands import app
from pcbench.cli.render.tables import Column, Screen
from pcbench.errors import UserError
from pcbench.plots.layout import PAPER, set_values, sheet
from pcbench.study import parse, scenario_template, scenarios_of
from pcbench.tables import latex, text
from pcbench.tables.layout import Entry, Head, Table

LABELS = [
    "kfbo-\\input{/etc/hostname}",
    "kfbo-<img src=x onerror=alert(1)>",
    "kfbo-../../../evil",
    "kfbo-[red]x[/red]",
    "kfbo-[/foo]",
    "kfbo-[link=//x/etc]click",
    "kfbo-$\\frac$",
    "kfbo-*/ x",
    "kfbo-a|b{0}%s#&~^_",
]
UNPRINTABLE = "ok\x1b]0;title\x07\x1b[2J\x1b[31mred\nline2\r\u202e\u200b\x9b31m"
SHOWN = r"ok\x1b]0;title\x07\x1b[2J\x1b[31mred\nline2\r\u202e\u200b\x9b31m"
STUDY = {
    "name": "hostile",
    "seeds": 2,
    "observers": ["kfbo", *LABELS],
    "options": {label: {"R": 0.1 + 0.1 * i} for i, label in enumerate(LABELS)},
    "scenario": {
        "base": "cart/white",
        "name": "s/../../x",
        "summary": UNPRINTABLE,
        "source": f"[/b] </pre><script>alert(2)</script> {UNPRINTABLE}",
        "duration": 2.0,
        "steady_start": 1.0,
        "options": {'kfbo-"]': {"R": 0.3}},
    },
}
# each special of LaTeX as it stands in a text, by the LaTeX book
TEX = {"\\": "\\textbackslash{}", "{": "\\{", "}": "\\}", "$": "\\$", "&": "\\&", "#": "\\#", "_": "\\_", "%": "\\%"}
TEX |= {"^": "\\textasciicircum{}", "~": "\\textasciitilde{}", "<": "\\textless{}", ">": "\\textgreater{}"}


ENTRY = Entry({"mean": 1.0, "ci_low": 0.9, "ci_high": 1.1, "n": 2, "diverged": 0}, "")


def is_plain(content):
    """Whether a terminal shows a text and does nothing else."""
    return all(c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf", "Zl", "Zp", "Cs") for c in content)


class Page(HTMLParser):
    """The elements of a page, and what is written in them."""

    def __init__(self, content):
        super().__init__()
        self.elements, self.words = [], []
        self.feed(content)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)


def test_a_table_prints_cells_heads_and_titles_as_text():
    out = io.StringIO()
    console = Screen(file=out, width=400)
    console.fit(
        "[bold]title", [Column("[u]head", [*LABELS, UNPRINTABLE, ":smile:"], is_text=True, bold=frozenset({1}))]
    )
    console.print("[/b]", style="bold")
    assert all(each in out.getvalue() for each in (*LABELS, "[bold]title", "[u]head", "[/b]", ":smile:"))
    assert is_plain(out.getvalue())


def test_a_table_for_a_terminal_has_no_codes_but_those_of_its_styles():
    out = io.StringIO()
    console = Screen(file=out, width=400, force_terminal=True)
    console.fit("title", [Column("observer", [*LABELS, UNPRINTABLE], is_text=True, bold=frozenset({0, 10}))])
    lists.print_in_full("name", {"summary": UNPRINTABLE, "source": "[link=//x]y"}, console)
    without = re.sub(r"\x1b\[[\d;]*m", "", out.getvalue())
    assert is_plain(without.replace("\n", ""))
    assert all(each in without for each in (*LABELS, "[link=//x]y"))


def test_progress_says_labels_as_text():
    from pcbench.cli.render.progress import draw_progress

    with Progress(TextColumn("{task.description}", markup=False), disable=True) as lines:
        progress = draw_progress(lines)
        progress.begin(UNPRINTABLE, 2)
        assert is_plain(lines.tasks[-1].description)
        progress.note(f"[/b] {UNPRINTABLE}")
        assert is_plain(lines.tasks[-1].description)


def test_labels_and_units_in_latex_are_text():
    heads = [Head("position", unit) for unit in ("m^-12", "%", "kg*m^2", "m}\\input{x}", "m^^5cinput", "m$&#_~")]
    (first, *_), rows = heads, [([label], [ENTRY] * 6) for label in LABELS]
    table = Table("s", "", LABELS[0], [Head("observer")], heads, rows, over=first)
    for plain in (True, False):
        lines = latex.latex([table], plain)
        for label in LABELS:
            assert "".join(TEX.get(c, c) for c in label) in lines
        assert not re.search(r"\\input|\^\^|[^\\]\$\\frac|\\mathrm\{m\}", lines)
        assert "m^{-12}" in lines
        assert "kg m^{2}" in lines


def test_labels_in_markdown_keep_to_their_column():
    rows = [([label], [ENTRY]) for label in LABELS]
    lines = text.markdown([Table("s", "", "about", [Head("observer")], [Head("x")], rows)]).splitlines()
    assert all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in lines[2:-1])
    assert not re.search(r"(?<!\\)[<>\[`]", "".join(lines[4:]))


def test_no_text_of_a_picture_is_mathematics():
    with sheet(PAPER, "$\\frac$") as (figure, (ax,)):
        set_values(ax, "x", ["$\\frac$", "$x$"])
        ax.set(title="$\\a$", xlabel="$b$")
        ax.plot([0, 1], [0, 1], label="$\\frac$")
    figure.canvas.draw()
    assert {"$\\frac$", "$x$", "$\\a$", "$b$"} < {t.get_text() for t in figure.findobj(Text)}
    assert [t.get_text() for t in figure.findobj(Text) if t.get_parse_math()] == []


def test_a_study_is_printed_as_toml_that_is_the_same_study():
    found = parse.parse(STUDY, "hostile")
    scenario = scenarios_of(found)["s/../../x"]
    assert scenario.summary == SHOWN
    again = parse.parse(tomllib.loads(scenario_template.as_study(scenario)), "again")
    (own,) = (s for name, s in scenarios_of(again).items() if name == again.scenarios[0])
    assert own.options == scenario.options
    assert own.source == scenario.source


@pytest.mark.ci
def test_hostile_text_passes_every_command_as_text(tmp_path, capsys, monkeypatch):
    """No traceback, no code of a terminal, and every label is printed as it is."""
    import tomli_w

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "study.toml").write_text(tomli_w.dumps(STUDY), encoding="utf-8")
    (tmp_path / "one.toml").write_text(tomli_w.dumps(STUDY | {"observers": LABELS[:1]}), encoding="utf-8")
    all_of_them = {
        "show": ["show", "study.toml"],
        "show --toml": ["show", "study.toml", "--toml"],
        "show --json": ["show", "study.toml", "--json"],
        "run": ["run", "study.toml", "--out", "a"],
        "run again": ["run", "study.toml", "--out", "b", "--set", "root_seed=1", "--operations"],
        "status": ["status", "a"],
        "status --json": ["status", "a", "--json"],
        "verify": ["verify", "a", "--sample", "1"],
        "compare": ["compare", "a", "b"],
        "report": ["report", "a"],
        "tables": ["tables", "a", "--signal", "all"],
        "tables --latex": ["tables", "a", "--latex", "--signal", "all"],
        "tables --latex --plain": ["tables", "a", "--latex", "--plain", "--signal", "all"],
        "tables --csv": ["tables", "a", "--csv"],
        "cite": ["cite", "a"],
        "cite study": ["cite", "study.toml"],
        "trace": ["simulate", "one.toml", "--observer", LABELS[0], "--out", "t.csv"],
        "design": ["design", "one.toml", LABELS[0]],
        "export": ["export", "one.toml", LABELS[7], "--out", "c"],
        "check": ["check", "one.toml"],
        "list": ["list"],
    }
    said = {}
    for name, words in all_of_them.items():
        app(words, standalone_mode=False)
        out, err = capsys.readouterr()
        assert is_plain(out), name
        assert is_plain(err), name
        said[name] = out
    for name in ("run", "status"):
        assert all(label in said[name] for label in LABELS), name
    assert "".join(TEX.get(c, c) for c in LABELS[0]) in said["tables --latex"]
    assert "\\input" not in said["tables --latex"] + said["tables --latex --plain"]
    page = (tmp_path / "a" / "report.html").read_text(encoding="utf-8")
    assert is_plain(page)
    found = Page(page)
    words = "".join(found.words)
    assert all(label in words for label in LABELS)
    assert SHOWN in words
    loading = ("script", "img", "iframe", "object", "embed")
    assert [tag for tag, _ in found.elements if tag in loading] == [
        "script",
        "script",
    ]  # the numbers, and the page's own
    assert not [a for _, attrs in found.elements for a in attrs if a.startswith("on")]
    for file in [p for p in tmp_path.rglob("*") if p.suffix in (".c", ".h", ".toml", ".md", ".csv")]:
        if file.name not in ("study.toml", "one.toml") or file.parent != tmp_path:
            assert is_plain(file.read_text(encoding="utf-8")), file
    assert not re.search(r"(?<!scenario )kfbo-\*/", (tmp_path / "c" / "vector.h").read_text())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "c", "one.toml", "study.toml", "t.csv"]


RECORDED = {
    "name": "recorded", "observers": ["kf"],
    "lti": {"A": [[0.0]], "B": [[1.0]], "C": [[1.0]], "tick": 0.05, "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.1,
            "x0": [0.0], "prior_std": [1.0], "duration": 5.0, "input": "zero"},
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("name", [*LABELS, UNPRINTABLE])
def test_text_of_a_recording_is_text(name, tmp_path, capsys, monkeypatch):
    """Names of channels, inputs and files that were recorded elsewhere, in every command that reads a recording."""
    import tomli_w

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "study.toml").write_text(tomli_w.dumps(RECORDED))
    replay = ["replay", "--plant", "study.toml", "--observers", "kf"]
    (tmp_path / "log").mkdir()
    t = np.arange(40) * 0.1
    channel = pa.table({"channel": [name] * 40, "sampled": t, "arrived": t + 0.1, "value": np.sin(t)})
    pq.write_table(channel, tmp_path / "log" / "measurements.parquet")
    pq.write_table(pa.table({"t": t, name: 0.0 * t}), tmp_path / "log" / "inputs.parquet")
    for file, field in ((name, "x"), ("flight.csv", name)):
        mapping = {"log": file, "channels": {name: {"field": field, "unit": "m", "delay": 0.1}}}
        (tmp_path / "mapping.toml").write_text(tomli_w.dumps(mapping), encoding="utf-8")
        (tmp_path / "flight.csv").write_text("t,x\n0,0\n0.1,1\n")
        for words in (["info", "mapping.toml"], [*replay, "mapping.toml", "--out", "none"]):
            with pytest.raises(UserError) as refused:
                app(words, standalone_mode=False)
            assert is_plain(str(refused.value)), words
    for words in (["info", "log", "--out", "d.svg"], [*replay, "log", "--out", "r"]):
        app(words, standalone_mode=False)
        assert all(map(is_plain, capsys.readouterr())), words
    for file in (tmp_path / "d.svg", tmp_path / "r" / "replay.json"):
        content = file.read_text(encoding="utf-8")
        assert is_plain(content), file
        assert file.suffix != ".svg" or "<img" not in content
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "d.svg",
        "flight.csv",
        "log",
        "mapping.toml",
        "r",
        "study.toml",
    ]


@pytest.mark.parametrize("name", [*LABELS, UNPRINTABLE])
def test_text_of_a_plant_of_ones_own_is_refused_or_text(name, capsys):
    """Of what stands here only a path is a unit, of an odd kind: it has no other letters than m/s."""
    for state in (name, f"{name} [m]", *([] if name.endswith("evil") else [f"x [{name}]"])):
        with pytest.raises(UserError) as refused:
            pcbench.make_plant(step=lambda p, now, x: x, output=lambda p, now, x: x[:1], states=[state], numbers=Numbers(),
                          operating_point=([0.0], [0.0]), tick=0.1)  # fmt: skip
        assert is_plain(str(refused.value))


class Numbers(NamedTuple):
    """The numbers of a plant of one's own."""

    gain: float = 1.0
