"""The list of mutations has not rotted: each still changes one place, into code that can be read, and names tests that exist.

That the tests fail on each is seen by `python tests/mutate.py`, which takes a while.
"""

import ast
import re
from functools import cache
from pathlib import Path

import mutate
import pytest

MUTATIONS = mutate.listed()
PACKAGE = mutate.ROOT / "pcbench"
LEAST = 120
NAMES = [f"{i}: {m.title}" for i, m in enumerate(MUTATIONS)]


@cache
def source(file):
    return (PACKAGE / file).read_text(encoding="utf-8")


@cache
def names_of_tests(name):
    tree = ast.parse((mutate.TESTS / name).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


@pytest.mark.parametrize("m", MUTATIONS, ids=NAMES)
def test_it_changes_one_place_into_code_that_can_be_read(m):
    changed = mutate.mutated(m, source(m.file))
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(source(m.file))), "it changes what is computed"


@pytest.mark.parametrize("m", MUTATIONS, ids=NAMES)
def test_it_names_tests_that_exist_and_what_is_wrong(m):
    assert m.tests
    for test in m.tests:
        name, _, function = test.partition("::")
        assert (mutate.TESTS / name).is_file(), test
        assert not function or re.match(r"\w+", function)[0] in names_of_tests(name), test
    assert m.why
    assert not m.harmless or len(m.harmless) > 40, "an explanation"


def test_no_mutation_stands_there_twice():
    assert len({(m.file, m.old, m.new) for m in MUTATIONS}) == len(MUTATIONS) >= LEAST


def test_every_folder_is_covered():
    covered = {Path(m.file).parent for m in MUTATIONS}
    assert {p.parent.relative_to(PACKAGE) for p in PACKAGE.rglob("*.py")} - {Path("cli/templates")} <= covered, (
        "a text is none"
    )


def test_a_mutation_without_its_one_place_is_an_error():
    m = mutate.Mutation("x.py", "a = 1", "a = 2", (), "another number")
    assert mutate.mutated(m, "a = 1\nb = a\n") == "a = 2\nb = a\n"
    for text in ("b = 1\n", "a = 1\na = 1\n"):
        with pytest.raises(ValueError, match="expected once"):
            mutate.mutated(m, text)
