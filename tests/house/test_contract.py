"""What a user's module needs stands in `pcbench` itself, typed: a type checker reads it, and finds what is wrong."""

import ast
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

import pcbench
from pcbench.cli import new


def test_type_checkers_see_the_names_that_programs_get():
    tree = ast.parse(Path(pcbench.__file__).read_text())
    seen = {
        alias.asname: f"{node.module}.{alias.name}"
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {name: f"pcbench.{module}.{name}" for name, module in pcbench._LAZY.items()}
    assert (files("pcbench") / "py.typed").is_file()


def test_every_name_has_a_docstring_that_stands_alone():
    for name in pcbench._LAZY:
        assert len((getattr(pcbench, name).__doc__ or "").split()) > 4, name


@pytest.mark.nightly
def test_a_type_checker_reads_a_users_module(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    new.new("observer", "mine")
    check = [sys.executable, "-m", "mypy", "--ignore-missing-imports", "mine.py"]
    good = subprocess.run(check, capture_output=True, text=True)
    assert good.returncode == 0, good.stdout
    text = Path("mine.py").read_text()
    Path("mine.py").write_text(
        text.replace("return gains.C @ memory", 'return "no"').replace("s.share * C.T", "s.shore * C.T")
    )
    bad = subprocess.run(check, capture_output=True, text=True)
    assert 'has no attribute "shore"' in bad.stdout
    assert 'got "str", expected "Array"' in bad.stdout
