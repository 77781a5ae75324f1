"""What SECURITY.md and the guide say that code is run by, and that no other place of the package could run any."""

import ast
import re
from pathlib import Path

import pytest
from documents import PAGES

import pcbench
from pcbench.cli.commands import ALL

PACKAGE = Path(pcbench.__file__).parent
ROOT = PACKAGE.parent
TEXT = (ROOT / "SECURITY.md").read_text()
PAGE = PAGES["your_own_observer.md"]
RUNS = {  # calls that run code of others, and where they may stand
    "exec": ("study/plugins/user_code",),
    "import_module": ("study/plugins/user_code", "__init__.py", "cli/runs.py"),  # of the package's own names
    "loads of pickle": ("dataset/serialize.py",),
    "load of pickle": (),
    "eval": (),
    "__import__": (),
    "loads of tomllib": ("toml_text",),  # one reader for every TOML: what is nested too deeply is a sentence
    "module_of": ("study/plugins/registry", "checking/targets", "external/entry"),  # what the user names in a command
    "_load_plugin": (
        "study/parse",
    ),  # the gate of a study that the user gives is handed in by name, and called nowhere else
}


def calls(path):
    """The names that a file calls, those of pickle with that."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            pickled = isinstance(node.func.value, ast.Name) and "pickle" in node.func.value.id
            tables = isinstance(node.func.value, ast.Name) and node.func.value.id == "tomllib"
            yield f"{node.func.attr} of {'pickle' if pickled else 'tomllib'}" if pickled or tables else node.func.attr


@pytest.mark.ci
def test_code_of_others_is_run_in_one_place_and_pickles_are_read_in_one():
    found = [(name, str(p.relative_to(PACKAGE))) for p in PACKAGE.rglob("*.py") for name in calls(p) if name in RUNS]
    assert [each for each in found if not each[1].startswith(RUNS[each[0]])] == []
    assert {"exec", "import_module", "loads of pickle", "loads of tomllib", "module_of"} == {name for name, _ in found}


def test_the_guide_says_the_same_and_names_the_page():
    paragraph = next(p for p in PAGE.split("\n\n") if p.startswith("**What code a study file can run.**"))
    assert "[Security](../../SECURITY.md)" in paragraph
    for text in (" ".join(paragraph.split()), " ".join(TEXT.split())):
        assert "any command given its `study.toml`" in text
        assert re.search("[Aa] name with a colon", text)
        assert "that an installed package offers" in text


def test_every_command_that_is_named_exists_and_a_problem_has_an_address():
    named = set(re.findall(r"`pcbench ((?:external )?[\w-]+)", TEXT)) | set(
        re.findall(r"`(run|show|check|design|simulate|tune)`", TEXT)
    )
    assert {"report", "status", "merge", "compare", "verify", "run"} <= named <= set(ALL)
    assert "private vulnerability reporting" in TEXT
    assert "## Supported versions" in TEXT
