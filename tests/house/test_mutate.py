"""`tests/mutate.py` tells tests that see a change from those that do not, and says what it cannot do."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILE = "pcbench/signal_names.py"
SEES = f"""from pathlib import Path
from pcbench import signal_names


def test_the_file_is_as_it_was():
    assert Path(signal_names.__file__).read_text() == Path({str(ROOT / FILE)!r}).read_text()
"""
BLIND = "def test_nothing(): assert True\n"


def mutate(*words):
    pytest.importorskip("cosmic_ray")
    words = [sys.executable, str(ROOT / "tests" / "mutate.py"), *words]
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=600)


@pytest.mark.nightly
@pytest.mark.parametrize(("text", "score", "code"), [(SEES, "4 of 4", 0), (BLIND, "0 of 4", 1)], ids=["sees", "blind"])
def test_the_score_is_the_share_of_mutants_on_which_a_test_fails(tmp_path, text, score, code):
    (tmp_path / "test_it.py").write_text(text)
    done = mutate(FILE, "--sample", "4", "--tests", str(tmp_path / "test_it.py"), "--least", "0.5")
    assert f"{score} mutants caught" in done.stdout, done.stderr
    assert done.returncode == code
    assert done.stdout.count("SURVIVED") == (0 if text == SEES else 4)


@pytest.mark.ci
def test_tests_that_name_a_mutated_file_most_often_run_first():
    pytest.importorskip("cosmic_ray")
    sys.path.insert(0, str(ROOT / "tests"))
    from mutate import tests_of

    found = tests_of(Path("pcbench/observers/kf_larsen.py"))
    folders = {test.split("/")[0] for test in found}
    assert folders == {"observers", "invariants", "plants"}
    first, *_, last = ((ROOT / "tests" / test).read_text() for test in found)
    assert "kf-larsen" in first
    assert "kf-larsen" not in last


@pytest.mark.ci
@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["pcbench/no_such.py"], "no file or folder of the package"),
        (["tests"], "no file or folder of the package"),
        (["--since", "no-such-commit"], "no-such-commit"),
        ([FILE, "--sample", "0"], "at least 1"),
        ([], "nothing to change"),
    ],
)
def test_a_mistake_is_one_sentence(words, why):
    done = mutate(*words)
    assert why in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode
