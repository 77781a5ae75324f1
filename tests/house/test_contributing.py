"""What CONTRIBUTING.md names exists: files, layers, commands, words."""

import importlib
import re
import sys
import tomllib
from pathlib import Path

import counts
import numpy as np
import pytest
from commands import call

import pcbench
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.observers.parts import options
from pcbench.protocols import Observer

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PATHS = sorted(set(re.findall(r"`((?:pcbench|tests|\.ci)/[\w./-]+|[A-Z]+\.md)`", TEXT)))


@pytest.mark.parametrize("path", PATHS)
def test_every_file_that_is_named_exists(path):
    assert (ROOT / path).exists()


def test_files_are_named_at_all():
    assert len(PATHS) > 25


def test_the_table_of_what_is_looked_for_names_existing_files_and_functions():
    """A file is named from the package or, after another, from that one's folder; a function follows its file."""
    (table,) = re.findall(r"^\| looking for \|.*\n\|.*\n((?:\|.*\n)+)", TEXT, re.M)
    rows = [re.findall(r"`([\w./]+)`", line) for line in table.splitlines()]
    assert len(rows) > 12
    for row in rows:
        path = Path(pcbench.__file__)
        for name in row:
            if name.endswith(".py"):
                path = next(p for p in (ROOT / "pcbench" / name, path.parent / name) if p.exists() or "NAME" in name)
            elif not (ROOT / "pcbench" / name).is_dir():
                module = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").replace("NAME", "kf")
                assert callable(getattr(importlib.import_module(module), name, None)), (row, name)


def test_the_names_in_how_to_add_are_defined_in_the_package():
    code = "\n".join(p.read_text() for p in (ROOT / "pcbench").rglob("*.py"))
    defined = set(re.findall(r"^(?: *(?:class|def) |(?=\w+(?:: .*)? = )| {4}(?=\w+: ))(\w+)", code, re.M))
    section = TEXT.split("## How to add")[1].split("\n## ")[0]
    names = set(re.findall(r"`(?:pcbench\.)?(\w+)(?:\([^`]*)?`", section))
    assert len(names) > 40
    assert names <= defined


def test_every_command_that_is_quoted_exists():
    (block,) = re.findall(r"^```sh\n(.*?)^```$", TEXT, re.S | re.M)
    tools = set(re.findall(r"\.venv/bin/([\w]+)", block))
    assert tools == {"pip", "python", "ruff", "lint", "mypy"}
    asked = re.search(r'pip install -e "\.\[([\w,]+)\]"', block)[1].split(",")
    assert set(asked) <= set(PROJECT["project"]["optional-dependencies"])
    assert re.findall(r"--group (\w+)", block) == list(PROJECT["dependency-groups"])
    for script in (".ci/run", ".ci/site", ".ci/search", ".ci/smoke"):
        assert script in block
        assert (ROOT / script).stat().st_mode & 0o100
    for command in set(re.findall(r"`pcbench ((?:external )?[\w-]+)", TEXT)):
        assert call(*command.split(), "--help").returncode == 0


def test_the_words_of_the_protocols_are_those_of_the_code():
    for word in ("init", "snapshot", "jump", "flow", "estimate"):
        assert word in Observer._fields
    for word in ("snapshot", "jump", "flow"):
        assert f"`{word}`" in TEXT or f"**{word}**" in TEXT
    assert "knows_schedule" in ObserverSpec._fields
    assert callable(options.tunable)
    assert callable(options.method_option)
    for name in ("Gains", "Options", "design", "OBSERVER"):
        assert hasattr(sys.modules[OBSERVERS["model-only"].design.__module__], name)


@pytest.mark.ci
def test_counts_of_the_code_are_those_of_the_script():
    """Within 3 %, so that a small change leaves the page alone; then `python tests/support/counts.py` writes it."""
    stated = counts.stated_counts(TEXT)
    assert list(stated) == ["pcbench", "tests"]
    for name, said in stated.items():
        np.testing.assert_allclose(said, counts.count_files(ROOT / name), rtol=0.03)


def test_the_folders_with_nightly_tests_are_listed():
    files = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py") if "mark.nightly" in path.read_text()}
    rows = re.findall(r"^\| `tests/(\w+)` \|", TEXT, re.M)
    assert rows == sorted(files)


def test_the_table_of_folders_has_the_order_that_the_linter_holds():
    rows = re.findall(r"^\| (`pcbench/.*?) \|", TEXT, re.M)
    (layers,) = (c["layers"] for c in PROJECT["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    assert [" | ".join(re.findall(r"`pcbench/(\w+)(?:\.py)?`", row)) for row in rows] == layers


def test_ci_builds_the_site():
    assert ".ci/site" in (ROOT / ".ci" / "run").read_text()


def test_it_names_nothing_outside_the_repository():
    assert not re.findall(r"(?<![\w.`])/(?:\w+/)+\w*", TEXT)
    assert "http" not in TEXT
