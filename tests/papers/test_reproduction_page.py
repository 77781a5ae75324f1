"""REPRODUCTION.md is what `pcbench reproduce all --page` writes, and counts what it holds."""

import json
import re
from pathlib import Path

import pytest
from commands import call

from pcbench.papers import PAPERS, arm, cart, chain, pi_pco
from pcbench.papers.claim import FINDING, NOT_OBTAINED, VERDICTS, Claim, counts, digits, rounds_to, statement
from pcbench.papers.page import _cell, page
from pcbench.runtime import config

PAGE = Path(__file__).parents[2] / "REPRODUCTION.md"


def cells(line):
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def parts(text):
    """The rows of claims, of findings, and of what was not obtained, by paper."""
    out = {}
    for part in text.split("\n## ")[1:]:
        name, body = part.split("\n", 1)
        rest, _, missing = body.partition("### Not obtained")
        claims, _, ours = rest.partition("### Findings")
        tables = (claims, ours, missing)
        out[name] = [[cells(li) for li in table.splitlines() if li.startswith("| ")][2:] for table in tables]
    return out


def summary(text):
    rows = [cells(line) for line in text.split("\n## ")[0].splitlines() if line.startswith("| ")]
    return {row[0]: [int(n) for n in row[1:]] for row in rows[2:]}


def consistent(text):
    """The counts of a page's summary are those of its rows."""
    said, total = summary(text), [0] * (len(VERDICTS) + 2)
    for name, (claims, ours, missing) in parts(text).items():
        many = [sum(row[-1] == v for row in claims) for v in VERDICTS] + [len(ours), len(missing)]
        assert sum(many[:-2]) == len(claims), f"{name} has a verdict of no vocabulary"
        assert said[name] == many, name
        total = [a + b for a, b in zip(total, many, strict=True)]
    assert said["all"] == total


def test_the_pages_counts_are_those_of_its_rows():
    consistent(PAGE.read_text())
    assert list(parts(PAGE.read_text())) == list(PAPERS)


def test_what_is_quickly_computed_stands_in_the_page_as_it_comes_out():
    there = parts(PAGE.read_text())
    with config.float64():
        quick = {
            "cart": list(cart.theorem()),
            "chain": chain.design_claims(),
            "pi-pco": pi_pco.equations(),
            "arm": list(arm._part_claims()),
        }
    for paper, rows in quick.items():
        for row in rows:
            line = [_cell(text) for text in (row.claim, row.printed, row.steady or row.reproduced, row.verdict)]
            assert line in there[paper][0], row


def test_nothing_in_the_page_is_of_a_day_or_a_machine():
    text = PAGE.read_text()
    assert not re.search(r"\b20[2-9]\d-\d\d|Linux|x86|/home|/tmp|seconds taken", text)
    for tiny in re.findall(r"\d(?:\.\d+)?e-(\d+)", text.replace("1.4e-11 | 1.44e-19", "")):
        assert int(tiny) <= 12, "digits of rounding"


def test_a_page_counts_and_escapes_what_it_is_given():
    rows = [
        statement("|e| < 1", "zero", "a|b * c", True),
        Claim("two", "2", "3", "misprint"),
        Claim("ours", "", "loose 1.2345", FINDING, "steady"),
        Claim("gain", "", "nothing", NOT_OBTAINED, source="Smith 1970"),
    ]
    text = page({"cart": rows, "arm": rows[1:]})
    consistent(text)
    assert summary(text) == {"cart": [1, 1, 0, 0, 1, 1], "arm": [0, 1, 0, 0, 1, 1], "all": [1, 2, 0, 0, 2, 2]}
    assert "1.2345" not in text
    assert parts(text)["arm"][2] == [["Smith 1970", "gain", "nothing"]]
    assert parts(text)["cart"][0][0] == ["\\|e\\| \\< 1", "zero", "a\\|b \\* c", "reproduced"]
    broken = text.replace("| 2 | 3 | misprint |", "| 2 | 3 | reproduced |", 1)
    with pytest.raises(AssertionError):
        consistent(broken)


def test_a_printed_number_comes_out_when_it_rounds_to_the_print():
    assert digits("x", "0.0083", 0.00832).verdict == "reproduced"
    assert digits("x", "0.0083", 0.00832).reproduced.endswith("to 2 digits")
    assert digits("x", "0.0083", 0.00836).verdict == "does not hold"
    assert rounds_to("5.33e-4", 5.3349e-4)
    assert not rounds_to("5.33e-4", 5.3351e-4)
    assert not rounds_to("0.5", -0.5)


def test_every_command_line_mistake_is_one_sentence(tmp_path):
    for words in (["card"], ["cart", "--page", str(tmp_path / "x.md")]):
        done = call("reproduce", *words)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.nightly
def test_the_page_is_what_comes_out(tmp_path):
    done = call("reproduce", "all", "--json", "--page", tmp_path / "page.md")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "page.md").read_text() == PAGE.read_text()
    said = json.loads(done.stdout)
    assert [p["paper"] for p in said["papers"]] == list(PAPERS)
    whole = [Claim(**row) for p in said["papers"] for row in p["claims"]]
    assert said["verdicts"] == counts(whole)
    assert {row.verdict for row in whole} == {*VERDICTS, FINDING, NOT_OBTAINED}
