"""What is imported where: what imports no jax, what `--help` needs, who sees the insides of jax. Folders: `lint-imports`."""

import re
import subprocess
import sys
from pathlib import Path

import pcbench

ROOT = Path(pcbench.__file__).parent
NO_JAX = ["errors", "synthesis", "synthesis.chain", "synthesis.pole_placement", "synthesis.sampled_model",
          "synthesis.riccati", "synthesis.current_lmi", "synthesis.certificate", "synthesis.unknown_input",
          "synthesis.sliding_mode", "synthesis.pi_lmi", "dynamics.linear", "dynamics.observability", "statistics",
          "dataset.columns", "dataset.storage", "dataset.block_files", "scenarios", "simulation.schedule.common_times",
          "runtime.cache", "runtime.memory"]  # fmt: skip


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
    assert sorted(users) == ["engine/jaxpr_compat.py", "simulation/threefry.py"]


def test_cvxpy_is_imported_by_synthesis_only():
    users = [p.relative_to(ROOT).parts[0] for p in ROOT.rglob("*.py") if "import cvxpy" in p.read_text()]
    assert set(users) == {"synthesis"}
