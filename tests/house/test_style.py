"""Style that a test can read: records of many fields are filled by keyword, as what stands in place seven nobody knows."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import pcbench

ROOT = Path(pcbench.__file__).parent
MOST = 6  # arguments by position
CAP_WORDS = re.compile(r"[A-Z]\w*[a-z]\w*")


def crowded(text):
    """The calls of a CapWords name with too many arguments by position, as (line, name, how many)."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    named = [(call, getattr(call.func, "id", getattr(call.func, "attr", ""))) for call in calls]
    return [(c.lineno, n, len(c.args)) for c, n in named if CAP_WORDS.fullmatch(n) and len(c.args) > MOST]


@pytest.mark.ci
def test_records_are_filled_by_keyword():
    found = {str(path.relative_to(ROOT)): crowded(path.read_text()) for path in ROOT.rglob("*.py")}
    assert {file: calls for file, calls in found.items() if calls} == {}


def test_what_is_looked_for_is_seen():
    assert crowded("a.Share(1, 2, 3, 4, 5, 6, 7)\nShare(1, 2, 3, 4, 5, 6, x=7)\nSHARE(1, 2, 3, 4, 5, 6, 7)") == [
        (1, "Share", 7)
    ]


def test_no_module_has_the_name_of_what_its_package_offers():
    """The API reference cannot hold both."""
    for package in ROOT.rglob("__init__.py"):
        names = {node.value for node in ast.walk(ast.parse(package.read_text())) if isinstance(node, ast.Constant)}
        text = re.search(r"__all__ = \[(.*?)\]", package.read_text(), re.S)
        offered = set(re.findall(r'"(\w+)"', text[1])) & names if text and package.parent != ROOT else set()
        modules = {path.stem for path in package.parent.glob("*.py")}
        assert not offered & modules, package


PUBLIC = [name for name in pcbench.__all__ if inspect.isfunction(getattr(pcbench, name))]


@pytest.mark.parametrize("name", PUBLIC)
def test_public_functions_document_each_argument_and_what_they_return(name):
    function = getattr(pcbench, name)
    text, signature = inspect.getdoc(function), inspect.signature(function)
    sections = dict(re.findall(r"^(Args|Returns|Raises):\n((?:    .*\n?|\n(?=    ))*)", text, re.M))
    documented = re.findall(r"^    \*{0,2}(\w+): ", sections.get("Args", ""), re.M)
    assert documented == list(signature.parameters)
    assert ("Returns" in sections) == (signature.return_annotation not in (None, "None"))
    raised = set(re.findall(r"raise (UserError|DesignError)\(", inspect.getsource(function)))
    assert all(error in sections.get("Raises", "") for error in raised)


def test_their_annotations_are_complete():
    for name in PUBLIC:
        signature = inspect.signature(getattr(pcbench, name))
        assert signature.return_annotation is not inspect.Signature.empty, name
        assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values()), name
