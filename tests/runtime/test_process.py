"""Memory that may be used, amounts as a user writes them, and JSON for a program."""

import json
import subprocess
import sys

import numpy as np
import psutil
import pytest

from pcbench.cli.render.tables import to_json
from pcbench.errors import UserError
from pcbench.runtime import memory

AMOUNTS = {
    "500MB": 500e6, "2GiB": 2 * 2**30, "2 gib": 2 * 2**30, "1.5K": 1500.0, "3MiB": 3 * 1024**2, "7": 7.0, "64 B": 64.0,
    "1T": 1e12, "1KiB": 1024.0,
}  # fmt: skip


@pytest.mark.parametrize("text", AMOUNTS)
def test_an_amount_is_what_its_unit_says(text):
    assert memory.memory_budget(text) == AMOUNTS[text]


@pytest.mark.parametrize("text", ["0", "-1GB", "2Gx", "many", "1e19", "nan", ""])
def test_what_is_no_amount_is_one_sentence(text):
    with pytest.raises(UserError, match="expected an amount such as 500MB or 2GiB"):
        memory.memory_budget(text)


def test_the_memory_is_the_least_of_the_machines_and_its_control_groups(monkeypatch, tmp_path):
    total = psutil.virtual_memory().total
    for name, content in (("large", f"{10 * total}\n"), ("small", f"{total // 3}\n"), ("none", "max\n")):
        (tmp_path / name).write_text(content)
    for names, want in ((["large", "none"], total), (["large", "small", "gone", "none"], total // 3)):
        monkeypatch.setattr(memory, "_limits", lambda names=names: [tmp_path / name for name in names])
        assert memory.usable() == want


def test_without_saying_results_may_take_a_quarter_of_the_memory_and_never_more_than_is_free(monkeypatch):
    monkeypatch.setattr(memory, "usable", lambda: 4_000)
    monkeypatch.setattr(memory, "free", lambda: 3_000)
    assert memory.memory_budget(None) == 1_000
    monkeypatch.setattr(memory, "free", lambda: 600)
    assert memory.memory_budget(None) == 600


def test_numbers_that_json_does_not_know_are_null_or_words():
    said = {
        "a": float("nan"),
        "b": np.array([1.0, np.nan]),
        "c": -np.inf,
        "d": 1 + 2j,
        "e": (np.float64(0.5), True),
        3: None,
    }
    assert json.loads(to_json(said)) == {
        "a": None, "b": [1.0, None], "c": "-inf", "d": {"real": 1.0, "imag": 2.0}, "e": [0.5, True], "3": None,
    }  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such limit")
def test_memory_that_is_free_keeps_to_the_limit_of_data():
    code = """
import resource
from pcbench.runtime import memory
resource.setrlimit(resource.RLIMIT_DATA, (1 << 29, 1 << 29))
before = memory.free()
held = bytearray(1 << 26)
print(before, before - memory.free())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, less = map(int, done.stdout.split())
    assert 1 << 26 < before < 1 << 29
    assert less == pytest.approx(1 << 26, abs=1 << 22)
