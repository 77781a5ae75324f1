"""The shape of the house: imports go down only, and what must not import jax does not."""

import ast
import graphlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pcbench

ROOT = Path(pcbench.__file__).parent
TABLE = (ROOT.parent / "CONTRIBUTING.md").read_text()
FLOORS = [
    re.findall(r"`pcbench/(\w+)(?:\.py)?`", row) for row in re.findall(r"^\| (`pcbench/.*?) \|", TABLE, re.M)
]  # top to bottom
FLOOR = {room: i for i, rooms in enumerate(FLOORS) for room in rooms}
NO_JAX = ["errors", "synthesis", "synthesis.chain", "synthesis.chain_lyapunov", "synthesis.sampled",
          "synthesis.riccati", "synthesis.current_estimator", "synthesis.certificate", "synthesis.unknown_input",
          "synthesis.sliding_mode", "synthesis.pi_lmi", "dynamics.linear", "dynamics.observability", "statistics",
          "dataset.columns", "dataset.store", "dataset.block_files", "scenarios", "simulation.schedule.shared",
          "machine.cache", "machine.memory"]  # fmt: skip


def modules():
    """The files of the package by the names of their modules."""
    names = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in ROOT.rglob("*.py")
    }
    return {name: p for name, p in names.items() if name not in ("__init__", "__main__")}


def imported(path):
    """The modules of pcbench that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "pcbench":
            inner = node.module.removeprefix("pcbench").lstrip(".")
            for alias in node.names:
                below = f"{inner}.{alias.name}".lstrip(".")
                yield below if below in MODULES else inner


MODULES = modules()


def room(module):
    return module.split(".")[0]


@pytest.mark.parametrize("module", MODULES)
def test_a_folder_imports_folders_below_it_only(module):
    for other in filter(None, imported(MODULES[module])):
        assert room(other) == room(module) or FLOOR[room(other)] > FLOOR[room(module)], f"{module} imports {other}"


def test_inside_a_folder_no_imports_go_in_a_circle():
    inside = {m: {o for o in imported(p) if o != m and room(o or m) == room(m)} for m, p in MODULES.items()}
    graphlib.TopologicalSorter(inside).prepare()


def test_every_folder_has_its_floor_and_says_what_it_is():
    assert len(FLOORS) == 16
    assert {room(m) for m in MODULES} == set(FLOOR)
    for name in FLOOR:
        assert ast.get_docstring(ast.parse(MODULES[name].read_text())), name


def test_no_statement_of_the_package_is_an_assert():
    """With `python -O` it would not be there: a mistake is a UserError."""
    found = [m for m, p in MODULES.items() for n in ast.walk(ast.parse(p.read_text())) if isinstance(n, ast.Assert)]
    assert found == []


def test_no_file_is_too_long():
    assert max(len(p.read_text().splitlines()) for p in MODULES.values()) <= 500


def test_no_jax_here():
    code = "import sys\nfor name in sys.argv[1:]:\n    __import__(f'pcbench.{name}')\n    assert 'jax' not in sys.modules, name"
    done = subprocess.run([sys.executable, "-c", code, *NO_JAX], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_help_imports_nothing_heavy():
    heavy = "{'jax', 'cvxpy', 'pandas', 'scipy', 'pyarrow', 'matplotlib', 'numpy'}"
    code = (
        "import sys; sys.argv = ['pcbench', '--help']\nimport pcbench.cli\n"
        f"try: pcbench.cli.main()\nexcept SystemExit: pass\nfound = {heavy} & set(sys.modules)\n"
        "sys.exit(str(found) if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_insides_of_jax_are_taken_in_one_file_only():
    users = [
        str(p.relative_to(ROOT))
        for p in ROOT.rglob("*.py")
        if re.search(r"jax\.(extend|_src|core|interpreters)\b|[.]params[.[]", p.read_text())
    ]
    assert sorted(users) == ["engine/jaxpr_compat.py", "simulation/generator.py"]


def test_cvxpy_is_imported_by_synthesis_only():
    users = [p.relative_to(ROOT).parts[0] for p in ROOT.rglob("*.py") if "import cvxpy" in p.read_text()]
    assert set(users) == {"synthesis"}
