"""Of every page of the guide: it is short, is found, its links lead somewhere, its command lines and studies are taken."""

import re
import shlex
import subprocess
import sys
import tomllib

import pytest
import typer
from commands import call
from documents import GUIDE, PAGES, README, ROOT, RUN, TEXTS, blocks, code_blocks, commands, prose
from logged import plain, rows
from reference_pages import PAGES as REFERENCE

from pcbench.cli.commands import app
from pcbench.cli.new import pages, title
from pcbench.study import parse

LONGEST = 150  # lines beside code
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
MENTIONED = ("[controller]", "scenarios = ", "[lti.plant]", "log = ")  # first lines of what is no study, or part of one


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_short_and_has_a_title(name):
    made = name.removesuffix(".md") in REFERENCE  # from the code, as long as it has records
    assert made or len(prose(PAGES[name]).splitlines()) <= LONGEST
    assert PAGES[name].startswith(f"# {title(PAGES[name])}\n")


@pytest.mark.parametrize("name", TEXTS)
def test_an_inner_list_has_four_spaces(name):
    """The site takes the entries of one with fewer for those of the outer list."""
    assert re.findall(r"^ {1,3}(?:[-*]|\d+\.) .*", prose(TEXTS[name]), re.M) == []


@pytest.mark.parametrize("name", TEXTS)
def test_every_link_leads_to_a_file(name):
    here = ROOT if name == "README.md" else (GUIDE / name).parent
    for link in LINK.findall(prose(TEXTS[name])):
        if not link.startswith(("http://", "https://", "#")):
            path, _, anchor = link.partition("#")
            assert (here / path).exists(), link
            assert not anchor or anchor in anchors((here / path).read_text()), link
        elif link.startswith("#"):
            assert link[1:] in anchors(TEXTS[name]), link


def anchors(text):
    heads = re.findall(r"^#+ (.*)$", prose(text), re.M)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}


def test_every_page_is_in_the_readme_or_one_step_from_it():
    linked = set(LINK.findall(README)) | {
        f"pcbench/guide/decisions/{n}" for n in LINK.findall(PAGES["decisions/README.md"])
    }
    assert {f"pcbench/guide/{name}" for name in PAGES} <= linked


@pytest.mark.parametrize("name", TEXTS)
def test_every_command_line_is_one_that_is_taken(name):
    group = typer.main.get_command(app)
    for line in commands(name):
        _, command, *words = shlex.split(line)
        assert command in group.commands, line
        group.commands[command].make_context(command, words)  # reads every option, runs nothing


def test_command_lines_are_found():
    assert len([line for name in TEXTS for line in commands(name)]) > 60


def test_every_study_is_whole_or_part_of_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the logs are that a study names
    for log in ("lab", "field"):
        rows(tmp_path / log, plain())
    for block in [b for name in RUN for b in code_blocks(name) if b.language == "python" and b.title]:
        (tmp_path / block.title).write_text(block.text)
    for block in blocks("toml"):
        raw = tomllib.loads(block)
        if not block.startswith(MENTIONED):
            assert parse.grid_of(raw, {}, []).cells


def test_the_guide_is_listed_and_shown_in_the_terminal():
    assert {path.relative_to(GUIDE).as_posix() for path in pages().values()} == set(PAGES)
    listed = call("guide").stdout
    listed_topics = {line.split()[0] for line in listed.splitlines() if line.startswith("  ")}
    assert listed_topics == {topic for topic, path in pages().items() if path.parent == GUIDE} | {"decisions"}
    shown = call("guide", "Choose_An_Observer").stdout
    assert "Choose an observer" in shown
    assert "what each observer needs to know" in shown.lower()
    wrong = call("guide", "closed-lops")
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("pcbench: guide: 'closed-lops' is no page; did you mean 'closed-loops'?")


def test_the_list_of_pages_imports_nothing_heavy():
    code = "import sys; from pcbench.cli import new; new.guide(None); "
    code += "print({'jax', 'rich.markdown', 'pandas'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.endswith(
        "set()\n"
    )
