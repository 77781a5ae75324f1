"""What a command imports: nothing heavy that it does not use. By names, not by time."""

import subprocess
import sys

import pytest
import tomli_w

HEAVY = {"cvxpy", "matplotlib", "optax", "pandas", "scipy.optimize", "scipy.signal", "scipy.sparse", "distributed"}
FEW = {"name": "few", "seeds": 2, "observers": ["model-only"]}
FEW |= {"scenario": {"base": "cart/white", "duration": 0.8, "steady_start": 0.4}}
COMMANDS = {  # and what each of them does use of HEAVY, and of jax
    "run": (["run", "few.toml", "--out", "out", "-q"], {"jax", "pandas"}),
    "list": (["list"], {"jax"}),
}


def imports_of(words, cwd):
    """The modules that a command has imported when it ends."""
    code = (
        "import sys, pcbench.cli\n"
        "try: pcbench.cli.main()\nexcept SystemExit as end: code = end.code\n"
        "print('\\n'.join(['', *sys.modules]))\nsys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines())


@pytest.mark.ci
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_imports_nothing_heavy_that_it_does_not_use(name, tmp_path):
    (tmp_path / "few.toml").write_text(tomli_w.dumps(FEW))
    words, uses = COMMANDS[name]
    assert imports_of(words, tmp_path) & (HEAVY | {"jax"}) <= uses


@pytest.mark.ci
def test_before_a_study_begins_no_distribution_is_imported():
    code = "import sys, pcbench.api; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"scipy.special", "pandas"} & set(done.stdout.split())
