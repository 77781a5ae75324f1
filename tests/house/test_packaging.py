"""What is published: the version from one place, classifiers that say what is so, and a wheel and an sdist that work alone."""

import ast
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import version

import pytest
from documents import GUIDE, ROOT

import pcbench
from pcbench.errors import EXTRAS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CITATION = (ROOT / "CITATION.cff").read_text()


def test_the_version_stands_in_one_place():
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert PROJECT["tool"]["hatch"]["version"]["path"] == "pcbench/__init__.py"
    assert re.search(r"^version: (.*)$", CITATION, re.M)[1] == pcbench.__version__ == version("pcbench")


def test_the_package_says_what_it_is():
    said = PROJECT["project"]["classifiers"]
    assert "Typing :: Typed" in said
    assert (GUIDE.parent / "py.typed").exists()
    assert said == sorted(said)
    assert "urls" in PROJECT["project"]
    assert set(PROJECT["dependency-groups"]) == {"dev", "docs"}


def test_pytest_is_strict():
    said = PROJECT["tool"]["pytest"]["ini_options"]
    assert said["xfail_strict"]
    assert {"--strict-markers", "--strict-config"} <= set(said["addopts"].split())


@pytest.mark.slow
def test_wheel_and_sdist_build_install_and_run_outside_the_checkout(tmp_path):
    """The wheel is built of the sdist, as an index does it; libraries are those of this environment."""
    hooks = "import sys; from hatchling import build; print(getattr(build, f'build_{sys.argv[1]}')(sys.argv[2]))"

    def built(kind, source):
        words = [sys.executable, "-c", hooks, kind, str(tmp_path)]
        return subprocess.run(words, cwd=source, capture_output=True, text=True, check=True).stdout.split()[-1]

    with tarfile.open(tmp_path / built("sdist", ROOT)) as sdist:
        sdist.extractall(tmp_path / "source", filter="data")
    (source,) = (tmp_path / "source").iterdir()
    assert (source / "REPRODUCTION.md").exists()
    wheel = tmp_path / built("wheel", source)
    with zipfile.ZipFile(wheel) as files:
        names = set(files.namelist())
    pages = {f"pcbench/guide/{path.relative_to(GUIDE).as_posix()}" for path in GUIDE.rglob("*") if path.is_file()}
    others = (
        "py.typed",
        "references.bib",
        "report/page.html",
        "report/page.css",
        "report/page.js",
        "report/explorer.js",
        "report/replay.html",
        "cli/templates/recordings/car/LICENSE",
        "cli/templates/recordings/leg/LICENSE",
    )
    assert pages | {f"pcbench/{name}" for name in others} <= names
    assert not any(name.startswith("tests/") for name in names)
    place = tmp_path / "place"
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(place), str(wheel)]
    subprocess.run(pip, check=True, cwd=tmp_path)
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PYTHONPATH": str(place)}
    for words in (["--version"], ["guide", "float64"], ["run", "quick", "--seeds", "4", "--quiet"]):
        done = subprocess.run(
            [sys.executable, "-m", "pcbench", *words], cwd=tmp_path, env=alone, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    where = subprocess.run(
        [sys.executable, "-c", "import pcbench; print(pcbench.__file__)"],
        cwd=tmp_path,
        env=alone,
        capture_output=True,
        text=True,
    )
    assert where.stdout.startswith(str(place))


@pytest.mark.parametrize("package", ["pandas", pytest.param("cvxpy", marks=pytest.mark.slow)])
def test_missing_library_is_a_sentence_with_its_install_command(package, tmp_path):
    code = f"import sys; sys.modules['{package}'] = None; from pcbench import cli; cli.main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "design", "cart/nominal", "pccebo", "--gain", "h2"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PCBENCH_CACHE": str(tmp_path)},
    )
    assert done.returncode == 2
    assert (
        done.stderr
        == f"pcbench: got no package '{package}', expected it for this command; install it: pip install {package}.\n"
    )


def names_of(requirements):
    return {re.match(r"[\w-]+", requirement)[0] for requirement in requirements}


def test_extras_table_lists_every_library_of_an_extra():
    extras = PROJECT["project"]["optional-dependencies"]
    for package, extra in EXTRAS.items():
        assert any(re.match(rf"{package}\b", requirement) for requirement in extras[extra]), package
    for extra in ("dask", "control"):
        assert names_of(extras[extra]) <= set(EXTRAS), extra
    assert not names_of(PROJECT["project"]["dependencies"]) & set(EXTRAS)


IMPORT_NAMES = {"tomli-w": "tomli_w"}
OPTIONAL = {"dask", "distributed", "control", "rosbags", "mcap", "mcap_ros2", "pyulog", "h5py"}
TRANSITIVE = {"annotated_types", "markupsafe"}  # part of pydantic, part of jinja2


@pytest.mark.ci
def test_every_imported_library_is_a_dependency_or_a_known_extra():
    """A plain `pip install pcbench` brings whatever the package imports, but for the extras and checks of foreign objects."""
    imported = set()
    for path in (ROOT / "pcbench").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module.split(".")[0])
    foreign = imported - set(sys.stdlib_module_names) - {"pcbench"}
    required = {IMPORT_NAMES.get(name, name) for name in names_of(PROJECT["project"]["dependencies"])}
    assert foreign - required - TRANSITIVE == OPTIONAL
