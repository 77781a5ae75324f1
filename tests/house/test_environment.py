"""What a shell may set: the answer is one sentence, or the same numbers."""

import json
import os
import subprocess
import sys

import pytest
from small_study import reseal, tables

import pcbench
from pcbench.dataset import block_files, storage, verify

PCBENCH = [sys.executable, "-m", "pcbench"]
RUN = ["run", "cart/slow", "--observers", "pccebo,kfbo", "--seeds", "3"]


def command(*words, cwd, **environment):
    """A command in a process of its own."""
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "PYTHON", "LC_", "LANG"))}
    given = plain | {"PYTHONPATH": os.environ.get("PYTHONPATH", "")} | environment
    done = subprocess.run([*PCBENCH, *words], cwd=cwd, env=given, capture_output=True, timeout=900, check=False)
    assert b"Traceback" not in done.stderr, done.stderr
    return done


ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}


@pytest.mark.nightly
def test_a_terminal_without_our_letters_has_the_table_in_its_own(tmp_path):
    done = command(*RUN, "--out", "out", cwd=tmp_path, **ASCII)
    assert done.returncode == 0, done.stderr
    assert "+- is half a 95 % interval" in done.stdout.decode("ascii")
    assert "?" not in done.stdout.decode("ascii")


@pytest.mark.ci
def test_a_name_that_a_process_cannot_write_is_one_sentence(tmp_path):
    done = command(*RUN, "--out", "résultats", cwd=tmp_path, **ASCII)
    assert done.returncode == 2
    assert b"whose encoding is ascii, expected UTF-8; set LC_ALL=C.UTF-8" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.ci
def test_a_platform_that_jax_does_not_have_is_one_sentence(tmp_path):
    done = command(*RUN, cwd=tmp_path, JAX_PLATFORMS="abacus")
    assert done.returncode == 2
    assert b"JAX_PLATFORMS: got 'abacus'" in done.stderr
    assert done.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_jax_told_not_to_compile_computes_the_same(tmp_path):
    for name, more in (("as it is", {}), ("disabled", {"JAX_DISABLE_JIT": "1"})):
        assert command(*RUN, "--out", name, cwd=tmp_path, **more).returncode == 0
    one, two = (tables(tmp_path / name) for name in ("as it is", "disabled"))
    assert one == two


@pytest.mark.nightly
def test_what_the_compiler_was_told_is_said(tmp_path):
    """With other flags bits differ: a dataset knows its own, and verify says whose numbers they are."""
    for name, flags in (("plain", "--xla_dump_hlo_as_text=false"), ("fast", "--xla_cpu_enable_fast_math=true")):
        assert command(*RUN, "--out", name, cwd=tmp_path, XLA_FLAGS=flags).returncode == 0
    said = {name: pcbench.open_result(tmp_path / name).provenance["compiler"] for name in ("plain", "fast")}
    assert said == {"plain": "defaults", "fast": "--xla_cpu_enable_fast_math=true"}
    place = storage.target(tmp_path / "plain")
    for b in block_files.present(place):
        table = block_files.read_block(place, b)
        assert block_files.about(table)["versions"]["compiler"] == "defaults"
        i = table.schema.get_field_index("mae")
        changed = table.set_column(i, table.schema.field(i), [table["mae"].to_numpy() * (1 + 3e-15)])
        about = block_files.about(table)
        about["versions"]["compiler"] = "--xla_cpu_max_isa=SSE4_2"
        storage.write_table(place, b.name, block_files.seal_block(changed, about))
    for sentence in verify.verify(tmp_path / "plain", None, 0).differing:
        assert "made with compiler --xla_cpu_max_isa=SSE4_2, now defaults; numbers differ by " in sentence
        assert sentence.endswith("(rounding).")


def test_other_flags_are_among_what_compare_says(whole, copy):
    reseal(copy, compiler="--xla_cpu_max_isa=SSE4_2")
    from pcbench.dataset import compare

    there = json.loads((whole / "provenance.json").read_text())["compiler"]
    assert compare.compare(whole, copy).made_by == [f"compiler: {there} there, --xla_cpu_max_isa=SSE4_2 here"]


LOADS = """
import signal, sys
from importlib.machinery import ExtensionFileLoader

def create_module(self, spec, real=ExtensionFileLoader.create_module):
    if spec.name == {module!r}:  # Ctrl-C in the middle of it
        print("loading", flush=True)
        signal.raise_signal(signal.SIGINT)
    return real(self, spec)

ExtensionFileLoader.create_module = create_module

class Asked:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r} and "." not in name:
            print("loading", flush=True)
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Asked())
from pcbench import cli
sys.argv = ["pcbench", "run", "cart/slow", "--out", {out!r}]
cli.main()
"""


SLOW_TO_LOAD = ("jax", "numpy._core._multiarray_umath", "pyarrow.lib")


@pytest.mark.parametrize(
    "module", ["typer", "jaxlib._jax", *(pytest.param(m, marks=pytest.mark.nightly) for m in SLOW_TO_LOAD)]
)
def test_ctrl_c_while_a_library_is_being_loaded_stops_in_one_sentence(module, tmp_path):
    """Extensions crash, or make another error of it, where Python is interrupted in the middle of them."""
    code = LOADS.format(module=module, out=str(tmp_path / "out"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert done.stdout == "loading\n"
    assert done.returncode == 130, done.stderr
    assert done.stderr == "pcbench: stopped; every file already written is complete.\n"
    assert not list(tmp_path.rglob("stats.parquet"))
