"""TOML from somebody else, nested too deeply or not valid: one sentence from every command that reads it."""

import pytest

import pcbench
from pcbench import toml_text
from pcbench.cli.commands import app

DEEP = {
    "tables": "a=" + "{b=" * 3000 + "1" + "}" * 3000,
    "lists": "a=" + "[" * 3000 + "]" * 3000,
    "key": "a" + ".b" * 500 + " = 1",
    "just too deep": "a=" + "[" * toml_text.DEEPEST + "1" + "]" * toml_text.DEEPEST,
}


@pytest.mark.parametrize("what", DEEP)
def test_text_that_is_nested_too_deeply_is_a_value_error(what):
    for text in (DEEP[what], DEEP[what].encode()):
        with pytest.raises(ValueError, match="nested deeper than 64"):
            toml_text.parse(text)


def test_text_that_is_deep_enough_for_any_study_is_read():
    inside = toml_text.DEEPEST - 1
    assert toml_text.parse("a=" + "[" * inside + "1" + "]" * inside)["a"]
    assert toml_text.parse(b"\xef\xbb\xbfa = 1\r\n") == {"a": 1}


@pytest.mark.ci
@pytest.mark.parametrize("what", DEEP)
@pytest.mark.parametrize("command", ["info", "show", "status", "check", "run", "compare"])
def test_every_command_that_reads_it_says_one_sentence(command, what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ds").mkdir()
    for name in ("deep.toml", "ds/study.toml"):
        (tmp_path / name).write_text(DEEP[what])
    words = {"status": ["ds"], "compare": ["ds", "ds"], "run": ["cart/slow", "--out", "ds"]}.get(command, ["deep.toml"])
    with pytest.raises(pcbench.UserError, match=r"nested|study.toml: is not as pcbench run has written") as error:
        app([command, *words], prog_name="pcbench", standalone_mode=False)
    assert "\n" not in str(error.value)
