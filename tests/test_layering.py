"""The shape of the house: imports go down only, and what must not import jax does not."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pcbench

ROOT = Path(pcbench.__file__).parent
LAYERS = [  # top to bottom; a module may import its own layer and those below
    {"__main__"},
    {"cli"},
    {"cli.commands"},
    {
        "cli.lists",
        "cli.observers",
        "cli.runs",
        "cli.datasets",
        "cli.tuning",
        "cli.reports",
        "cli.papers",
        "cli.checking",
    },
    {"cli.screen", "cli.catalogue"},
    {"cli.shared", "cli.stopping"},
    {"report", "report.page"},
    {"report.lines", "report.maps", "report.headline", "report.figures"},
    {"report.chart"},
    {"reproduce"},
    {"plots"},
    {"plots.lines", "plots.maps", "plots.tuning"},
    {"examples"},
    {"plots.frames"},
    {"plots.sheet"},
    {"plots.palette"},
    {"bench", "interop"},
    {"designing", "checking"},
    {"tuning.gap"},
    {"tuning.fairness"},
    {"tuning.effort"},
    {"tuning.judging"},
    {"running"},
    {"result"},
    {"tuning.gradient", "tuning.record"},
    {"tuning.goal", "tuning.ways", "tuning"},
    {"tuning.free"},
    {"dataset.merging", "dataset.comparing"},
    {"dataset.inspection", "dataset.until"},
    {"dataset.campaign"},
    {"dataset.blocks", "dataset.closing"},
    {"dataset.folder"},
    {"dataset.mending"},
    {"study_file", "dataset.changes"},
    {"dataset.as_file", "dataset.executors", "dataset.ledger", "dataset.growing", "differentiable"},
    {"sweep", "planning", "dataset.parcel"},
    {"shapes"},
    {"closed_loop"},
    {"tables", "cells"},
    {"study", "dataset.store", "dataset"},
    {"statistics"},
    {"statistics.winning", "statistics.wording"},
    {"statistics.description", "statistics.pairing"},
    {"statistics.comparison"},
    {"statistics.stack", "statistics.estimates", "statistics.order_statistics", "statistics.selection"},
    {"statistics.moments"},
    {"own_plant"},
    {"axes"},
    {"limits"},
    {"ensemble", "recording", "conformance"},
    {"simulation"},
    {"own_events"},
    {"shared_events"},
    {"rollout"},
    {"feedback"},
    {"problem"},
    {"irregular"},
    {"packing", "entrywise"},
    {"lanes", "metrics", "sampling", "draws"},
    {"plants", "observers", "controllers"},
    {"integrate", "signals", "actuator"},
    {"machine"},
    {"synthesis"},
    {"scenarios"},
    {"quoting", "primitives"},
    {"types", "errors"},
]
NO_JAX = ["synthesis.linear", "synthesis.chain", "synthesis.shared_lyapunov", "synthesis.sampled", "synthesis.late",
          "synthesis.riccati", "synthesis.current_estimator", "synthesis.certificate", "synthesis.unknown_input",
          "synthesis.sliding_mode", "synthesis.pi_lmi", "statistics", "tables", "dataset.store",
          "dataset.ledger", "scenarios", "sampling", "signals", "errors"]  # fmt: skip


def layer(module):
    """The layer of a module, or else of the package that it is in."""
    for name in (".".join(module.split(".")[:2]), module.split(".")[0]):
        for i, names in enumerate(LAYERS):
            if name in names:
                return i
    raise AssertionError(f"{module} is in no layer")


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "pcbench":
            inner = node.module.removeprefix("pcbench").lstrip(".")
            for alias in node.names:
                below = f"{inner}.{alias.name}".lstrip(".")
                yield below if (ROOT / (below.replace(".", "/") + ".py")).exists() or not inner else inner


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down_only(path):
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    if module == "__init__":
        return
    for other in imports(path):
        assert layer(other) >= layer(module), f"{module} imports {other}, which stands above it"


@pytest.mark.parametrize("module", NO_JAX)
def test_no_jax_here(module):
    code = f"import sys, pcbench.{module}; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


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
    assert users == ["primitives.py"]


def test_cvxpy_is_imported_by_synthesis_only():
    users = [p.relative_to(ROOT).parts[0] for p in ROOT.rglob("*.py") if "import cvxpy" in p.read_text()]
    assert set(users) == {"synthesis"}
