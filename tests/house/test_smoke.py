"""The script that runs the wheel on every Python finds interpreters, and refuses to pass without one."""

import importlib.machinery
import importlib.util
import os
import subprocess
import sys
import tomllib

import pytest
from documents import ROOT

SCRIPT = ROOT / ".ci" / "smoke"


@pytest.fixture(scope="module")
def smoke():
    loader = importlib.machinery.SourceFileLoader("smoke_script", str(SCRIPT))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("smoke_script", loader))
    loader.exec_module(module)
    return module


def test_targets_are_the_supported_pythons(smoke):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    supported = [c.rpartition(" ")[2] for c in project["classifiers"] if "Python :: 3." in c]
    assert [t for t in smoke.TARGETS if "-" not in t] == supported
    assert f"{project['requires-python'].removeprefix('>=')}-lowest" in smoke.TARGETS


def test_missing_interpreter_is_a_failure_that_says_how_to_install_it(tmp_path):
    environment = {"PATH": str(tmp_path), "HOME": str(tmp_path), "PYENV_ROOT": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "3.13"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr == (
        "smoke: no Python 3.13 on the path, in pyenv or in uv; install it: 'pyenv install 3.13' or 'uv python install 3.13'.\n"
    )


def fake(path, version):
    """A program that answers as an interpreter of this version does, or fails as a pyenv shim without one does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho {version}\n" if version else "#!/bin/sh\nexit 127\n")
    path.chmod(0o755)
    return path


def test_interpreters_are_found_on_the_path_in_pyenv_and_in_uv(smoke, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "bin") + os.pathsep + "/bin")
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    monkeypatch.delenv("PYENV_VERSION", raising=False)
    fake(tmp_path / "bin" / "python3.13", "")
    older = fake(tmp_path / "pyenv" / "versions" / "3.13.9" / "bin" / "python", "3.13")
    newer = fake(tmp_path / "pyenv" / "versions" / "3.13.10" / "bin" / "python", "3.13")
    assert smoke.find_interpreter("3.13") == str(newer)
    monkeypatch.setenv("PYENV_VERSION", "3.13.9:3.11.2")
    assert smoke.find_interpreter("3.13") == str(older)
    with_uv = fake(tmp_path / "elsewhere" / "python", "3.14")
    fake(tmp_path / "bin" / "uv", with_uv)
    assert smoke.find_interpreter("3.14") == str(with_uv)


def test_lowest_versions_pin_every_requirement(smoke):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pins = smoke.lowest_versions().splitlines()
    assert all("==" in pin for pin in pins)
    assert len(pins) >= len(project["dependencies"]) + len(project["optional-dependencies"]["logs"])
