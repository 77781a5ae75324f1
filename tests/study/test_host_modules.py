"""A user's file and the modules of the program that reads it: neither replaces the other's."""

import pickle
import sys
from types import ModuleType

import pytest

from pcbench.study.plugins import user_code

MINE = """
import helpers
from helpers import Gains

value = helpers.value
found = Gains(1.0)
"""
HELPERS = """
from typing import NamedTuple

class Gains(NamedTuple):
    x: float

value = {}
"""


def execute(folder, value):
    (folder / "mine.py").write_text(MINE)
    (folder / "helpers.py").write_text(HELPERS.format(value))
    code = user_code.code_of("mine.py:value", "here", folder)
    return user_code.module_of(code, "here", folder)


@pytest.fixture(autouse=True)
def unchanged():
    path, finders = list(sys.path), list(sys.meta_path)
    yield
    assert sys.path == path
    assert sys.meta_path == finders


def test_a_module_of_the_host_program_stays_where_the_file_has_one_of_its_name(tmp_path, monkeypatch):
    hosts = ModuleType("helpers")
    monkeypatch.setitem(sys.modules, "helpers", hosts)
    assert execute(tmp_path, 1).value == 1
    assert sys.modules["helpers"] is hosts
    assert execute(tmp_path, 2).value == 2, "another content is another module"
    assert sys.modules["helpers"] is hosts


def test_types_of_a_file_beside_it_are_found_when_they_are_unpickled(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "helpers", ModuleType("helpers"))
    module = execute(tmp_path, 3)
    assert pickle.loads(pickle.dumps(module.found)) == module.found
    assert type(pickle.loads(pickle.dumps(module.found))) is type(module.found)


def test_a_file_that_fails_leaves_the_host_as_it_was(tmp_path, monkeypatch):
    hosts = ModuleType("helpers")
    monkeypatch.setitem(sys.modules, "helpers", hosts)
    with pytest.raises(user_code.UserError, match="ZeroDivisionError"):
        execute(tmp_path, "1 / 0")
    assert sys.modules["helpers"] is hosts


def test_a_module_of_the_working_folder_is_imported_after_all_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "colorsys.py").write_text("shadows = True")
    (tmp_path / "only_here_s16.py").write_text("value = 4")
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    assert not hasattr(user_code.module_of(user_code.code_of("colorsys:value", "here"), "here"), "shadows")
    assert user_code.module_of(user_code.code_of("only_here_s16:value", "here"), "here").value == 4
    monkeypatch.delitem(sys.modules, "only_here_s16")
