"""Every script in `benchmarks` runs in its smallest form, with all of its rows and checks, and refuses what does not agree."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import hurried
import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
HELPERS = {"baselines", "turns"}  # imported by the others
ROWS = {  # what each prints, and how often
    "throughput": {"(a)": 1, "(b)": 1, "(c)": 1, "pcbench, streams": 2, "pcbench, full product": 2, "random start": 2},
    "random_schedules": {
        "one schedule for all": 3,
        "jitter 0.04 s": 3,
        "loss 20 %": 3,
        "random intervals": 3,
        "overtaking": 2,
    },
    "tuning": {"cart/gaussian": 1, "cart/white": 1, "cart/variable": 3},
    "studies": {"writing: ": 3, "workers: efficiency": 2, "workers: two workers do": 1, "memory: ": 2},
    "survival": {
        "undisturbed: ": 1,
        "each byte for byte as undisturbed": 1,
        "reader, duckdb: ": 3,
        "reader, polars: ": 3,
    },
}


def test_every_script_is_run_here():
    assert {p.stem for p in FOLDER.glob("*.py")} - HELPERS == set(ROWS)


@pytest.mark.parametrize("name", ROWS)
def test_a_benchmark_runs_whole_in_its_small_form(name):
    environment = {**os.environ, "XLA_FLAGS": hurried.flags()}  # compiling is most of it
    command = [sys.executable, str(FOLDER / f"{name}.py"), "--small"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=FOLDER.parent)
    assert done.returncode == 0, done.stderr
    for words, many in ROWS[name].items():
        assert sum(words in line for line in done.stdout.splitlines()) >= many, (words, done.stdout)


@pytest.fixture
def script(monkeypatch):
    """The names of a script, without running it."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return lambda name: runpy.run_path(str(FOLDER / f"{name}.py"))


def test_throughput_refuses_to_time_other_numbers(script):
    agree, sums = script("throughput")["agree"], np.ones((3, 4, 5))
    agree("same", sums, sums, 10)
    with pytest.raises(SystemExit, match=r"got metrics 1.0e-07 off pcbench's"):
        agree("other", sums * [[[1 + 1e-6]], [[1.0]], [[1.0]]], sums, 10)
    with pytest.raises(SystemExit):
        agree("none", sums * np.nan, sums, 10)


def test_random_schedules_refuses_runs_that_are_not_random(script):
    names = script("random_schedules")
    row = names["Row"]("what", 1, 1, 1, None, None)
    a, b = names["Made"](row, np.ones(3)), names["Made"](row, np.full(3, 2.0))
    names["check"]([a, b])
    with pytest.raises(SystemExit, match="got the runs of one schedule for all"):
        names["check"]([a, a])
    with pytest.raises(SystemExit, match="not finite"):
        names["check"]([a, b._replace(errors=np.array([1.0, np.inf]))])
