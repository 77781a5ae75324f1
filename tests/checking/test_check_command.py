"""`pcbench check` as a user meets it: a table or JSON, exit codes 0, 1 and 2, and never a traceback."""

import json
from pathlib import Path

import pytest
from commands import call

OWN = (Path(__file__).parents[1] / "support" / "own_observer.py").read_text()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.py").write_text("print('loaded')\n" + OWN)
    return tmp_path


def assert_refusal(done):
    """Exit code 2 and one sentence."""
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("pcbench: check")
    assert lines[0].endswith(".")
    return lines[0]


@pytest.mark.ci
def test_a_file_of_ones_own_passes_and_json_is_for_a_program(folder):
    done = call("check", "mine.py:nudge", "--set", "share=0.2", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["observer"] == "nudge"
    assert {c["verdict"] for c in found["checks"]} == {"passes"}
    assert done.stderr.strip() == "loaded"


@pytest.mark.nightly
def test_a_check_that_fails_has_exit_code_1_and_a_table_says_why(folder):
    text = (folder / "mine.py").read_text().replace("now.u,\n", "now.past_u(1),\n")
    (folder / "slipped.py").write_text(text)
    done = call("check", "slipped:nudge", cwd=folder)
    assert done.returncode == 1, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "fails" in line]
    assert line.split()[:2] == ["perfect", "start"]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("raises", "says"),
    [
        ("1 // 0", "ZeroDivisionError"),
        ("[][3]", "IndexError: list index out of range"),
        ("exit(7)", "SystemExit: 7"),
        ("unheard_of", "NameError: name 'unheard_of'"),
    ],
)
def test_whatever_the_users_code_raises_is_quoted_with_its_line(folder, raises, says):
    text = (folder / "mine.py").read_text().replace("gains.Phi @ memory", f"({raises}, gains.Phi @ memory)[1]")
    (folder / "raising.py").write_text(text)
    line = 1 + next(i for i, text in enumerate(text.splitlines()) if raises in text)
    done = call("check", "raising.py:nudge", "--json", cwd=folder)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    why = {c["check"]: c["why"] for c in json.loads(done.stdout)["checks"]}["shapes"]
    assert says in why
    assert f"raising.py line {line}" in why


BAD_MODULES = {
    "a name that is not defined": ("import os\n\nunheard_of\n", "NameError", "bad.py line 3"),
    "no Python": ("x = (\n\ny z\n", "SyntaxError", "bad.py line"),
    "a library that is not here": ("import own_observer_x\n", "ModuleNotFoundError", "bad.py line 1"),
    "it stops": ("raise SystemExit(0)\n", "SystemExit", "bad.py line 1"),
    "no design": ("from own import nudge\n", "without a function design", "write it in"),
    "not an observer": ("nudge = 3\n", "got a int called nudge", "expected an observer (a pcbench.Observer"),
    "options without defaults": (
        "from own import *\nclass Options(BaseModel):\n    share: float\n", "option share: Field required", "--set"
    ),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("name", BAD_MODULES)
def test_a_module_that_cannot_be_used_is_one_sentence(folder, name):
    text, *says = BAD_MODULES[name]
    (folder / "own.py").write_text(OWN)
    (folder / "bad.py").write_text(text)
    sentence = assert_refusal(call("check", "bad.py:nudge", cwd=folder))
    assert all(text in sentence for text in says), sentence


BAD_WORDS = {
    "no colon": (["mine.py"], "expected MODULE:NAME such as mine.py:nudge, or a study file"),
    "no file": (["mime.py:nudge"], "did you mean 'mine.py'?"),
    "no module": (["pcbench.observers.dfk:OBSERVER"], "did you mean 'pcbench.observers.kf'?"),
    "no scenario": (["mine:nudge", "--scenario", "cart/whit"], "did you mean 'cart/white'?"),
    "no value": (["mine:nudge", "--set", "share"], "expected KEY=VALUE"),
}


@pytest.mark.ci
@pytest.mark.parametrize("name", BAD_WORDS)
def test_a_mistake_is_one_sentence_with_the_nearest_name(folder, name):
    words, says = BAD_WORDS[name]
    assert says in assert_refusal(call("check", *words, cwd=folder))


@pytest.mark.parametrize(
    ("words", "says"), [(["mine:nudgy"], "'nudge'"), (["mine:nudge", "--set", "shore=1"], "'share'")]
)
def test_a_name_that_is_not_there_comes_with_the_nearest(folder, words, says):
    (folder / "mine.py").write_text(OWN)
    assert f"did you mean {says}?" in assert_refusal(call("check", *words, cwd=folder))
