"""A mistake is one line with the nearest valid name, and what a user's code raised is quoted with the user's own line."""

import inspect
import json

import pytest

from pcbench import errors
from pcbench.errors import UserError


def test_a_sentence_is_one_line_whatever_it_quotes():
    said = str(UserError("x: got 'a\nb\x1b[31m\tc\u202e', expected ü."))
    assert said == r"x: got 'a\nb\x1b[31m\tc\u202e', expected ü."


@pytest.mark.parametrize(
    ("got", "hint"), [("Posision", "did you mean 'position'? "), ("VELOCITY", "did you mean 'velocity'? "), ("zzz", "")]
)
def test_a_name_that_is_none_comes_with_the_nearest_and_all_that_are(got, hint):
    said = str(errors.unknown("here", "signal", got, ["velocity", "position"]))
    assert said == f"here: '{got}' is no signal; {hint}valid: position, velocity."


def test_what_is_too_long_loses_its_middle():
    text = "".join(chr(65 + i % 26) for i in range(300))
    assert errors.short(text) == text[:77] + "..." + text[-20:]
    assert errors.short(text[:100]) == text[:100]
    assert len(errors.brief_repr(list(range(10**4)))) < 100
    assert errors.first_sentence("It failed. A second sentence\nand a line.") == "It failed"


def inner():
    raise ZeroDivisionError("by nothing")


def test_the_line_that_is_quoted_is_the_one_that_raised():
    with pytest.raises(ZeroDivisionError) as caught:
        inner()
    line = inspect.getsourcelines(inner)[1] + 1
    assert errors.describe_exception(caught.value) == f"ZeroDivisionError: by nothing, test_sentences.py line {line}"


def test_lines_of_libraries_are_not_the_users():
    with pytest.raises(ValueError, match="Expecting") as caught:
        json.loads("{")
    assert "decoder.py" in str(caught.traceback[-1].path), "it was raised there"
    assert errors.line_of(caught.value).startswith("test_sentences.py line ")
