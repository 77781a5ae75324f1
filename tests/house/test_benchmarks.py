"""Every script in `benchmarks` runs in its smallest form, with all of its rows and checks, and refuses what does not agree.

No built-in study takes a fifth more than at the commit of the last line of `history.csv`.
"""

import csv
import os
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import hurried
import jax
import jax.numpy as jnp
import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
HELPERS = {"baselines", "hlo_counts", "map_study", "numba_linear", "numba_robots", "turns"}  # imported by the others
ROWS = {  # what each prints, and how often
    "throughput": {
        "(a)": 1,
        "(b)": 1,
        "(c)": 1,
        "(d)": 1,
        "process noise, pcbench": 1,
        "a schedule for each run, pcbench": 1,
        "closed loop, pcbench": 1,
        "nonlinear plant, pcbench": 1,
    },
    "numba_cases": {
        "process noise": 1,
        "a schedule for each run": 1,
        "closed loop": 1,
        "arm, smo": 1,
        "helicopter, high-gain": 1,
        "helicopter, ekf": 1,
    },
    "random_schedules": {
        "one schedule for all": 2,
        "jitter 0.04 s": 2,
        "loss 20 %": 2,
        "random intervals": 2,
        "out of sequence": 1,
    },
    "tuning": {"cart/white": 1, "cart/variable": 1},
    "studies": {"writing: ": 3, "workers: efficiency": 2, "workers: two workers do": 1, "memory: ": 2, "maps: ": 1},
    "survival": {
        "undisturbed: ": 1,
        "each byte for byte as undisturbed": 1,
        "reader, duckdb: ": 3,
        "reader, polars: ": 3,
    },
    "own_code": {"here, ": 2, "workers, ": 2},
    "replay": {"replay: ": 1},
    "first_use": {"short: ": 1},
    "accelerator": {"cart, pccebo and kfbo": 1, "reactor, ekf": 1, "helicopter, ": 2},
}


def test_every_script_is_run_here():
    assert {p.stem for p in FOLDER.glob("*.py")} - HELPERS == set(ROWS)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROWS)
def test_a_benchmark_runs_whole_in_its_small_form(name):
    environment = {**os.environ, "XLA_FLAGS": hurried.flags()}  # compiling is most of it
    command = [sys.executable, str(FOLDER / f"{name}.py"), "--small"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=FOLDER.parent)
    assert done.returncode == 0, done.stderr
    for words, many in ROWS[name].items():
        assert sum(words in line for line in done.stdout.splitlines()) >= many, (words, done.stdout)


GATE = ("quick", "cart", "unequal-delays", "growth-model", "ncs-two-state", "equal-tuning", "new-plant", "900000-runs")


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_no_study_takes_a_fifth_more_than_at_the_last_release():
    *_, last = csv.DictReader((FOLDER / "history.csv").open())
    command = [sys.executable, str(FOLDER / "first_use.py"), *GATE, "--against", last["commit"], "--at-most", "1.2"]
    done = subprocess.run([*command, "--turns", "4"], capture_output=True, text=True, check=False, cwd=FOLDER.parent)
    assert done.returncode == 0, done.stdout + done.stderr


def test_first_use_compares_processor_seconds_and_names_what_is_slower(script, monkeypatch, capsys, tmp_path):
    took = script("first_use")["Took"]

    def run(study, checkout):
        first = {"quick": 10.0, "cart": 10.0, "outage": 10.0}[study] * (1 if checkout == tmp_path else 1.1)
        again = 3.0 if study == "cart" and checkout != tmp_path else 2.0
        return (took(9.0, first, 1.0, 1, 1.0, 64), took(9.0, again, 1.0, 1, 0.0, 64))

    main = script("first_use")["main"]
    monkeypatch.setitem(main.__globals__, "first_and_again", run)
    words = ["first_use", "quick", "cart", "outage", "--against", str(tmp_path), "--at-most"]
    monkeypatch.setattr(sys, "argv", [*words, "1.2"])
    with pytest.raises(SystemExit, match=r"more than 1.2 times the processor seconds of .*: \['cart'\]"):
        main()
    assert "cart: 1.100 of the other's processor seconds first, 1.500 again" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*words, "1.6"])
    main()
    monkeypatch.setattr(sys, "argv", ["first_use", "quick", "--against", "no-such-commit"])
    with pytest.raises(SystemExit, match="no-such-commit is not a folder and not a commit"):
        main()


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


def test_numba_cases_refuses_to_time_other_numbers(script):
    check, sums = script("numba_cases")["check"], np.ones((3, 5))
    check("same", sums, sums * (1 + 1e-12))
    with pytest.raises(SystemExit, match=r"numba_cases: other: got metrics 1.0e-06 off pcbench's"):
        check("other", sums * [[1 + 1e-6], [1.0], [1.0]], sums)
    with pytest.raises(SystemExit):
        check("none", sums * np.nan, sums)


def test_hlo_counts_multiply_loops_and_refuse_other_numbers_of_loops(script):
    count = script("hlo_counts")["count"]

    def program(x, n):
        outer = jax.lax.fori_loop(0, n, lambda i, x: jax.lax.fori_loop(0, 4, lambda j, x: jnp.sqrt(x) * x, x), x)
        return outer @ outer.T

    text = jax.jit(program).lower(jnp.ones((8, 3)), jnp.asarray(5)).compile().as_text()
    assert count(text, [5.0]).flops == 5 * 4 * 2 * 24 + 2 * 8 * 8 * 3
    with pytest.raises(ValueError, match="got 1 numbers of loop runs too many"):
        count(text, [5.0, 1.0])


def test_accelerator_sees_a_difference_of_any_observer(script):
    difference = script("accelerator")["difference"]

    def sums(*values):
        one = [SimpleNamespace(absolute=np.full((2, i + 1, 3), v), square=np.ones((2, i + 1, 3)), peak=np.ones((2, i + 1, 3)))
               for i, v in enumerate(values)]  # fmt: skip
        return SimpleNamespace(streams=dict(zip("ab", one, strict=False)))

    assert difference(sums(1.0, 0.0), sums(1.0, 0.0)) == 0.0
    assert difference(sums(1.0, 1.1), sums(1.0, 1.0)) == pytest.approx(0.1)
    assert difference(sums(1.0, 1.0), sums(1.0, 0.0)) == np.inf
    assert np.isnan(difference(sums(1.0, np.nan), sums(1.0, 1.0)))


def test_random_schedules_refuses_runs_that_are_not_random(script):
    names = script("random_schedules")
    row = names["Row"]("what", 1, 1, 1, None, None)
    a, b = names["Made"](row, np.ones(3)), names["Made"](row, np.full(3, 2.0))
    names["check"]([a, b])
    with pytest.raises(SystemExit, match="got the runs of one schedule for all"):
        names["check"]([a, a])
    with pytest.raises(SystemExit, match="not finite"):
        names["check"]([a, b._replace(errors=np.array([1.0, np.inf]))])


def test_own_code_refuses_other_bits_and_another_speed(script, capsys):
    names = script("own_code")
    turn, seconds = names["Turn"], iter(range(1, 100))

    def way(left, factor):
        return lambda: turn(left, (float(next(seconds)), factor))

    took = names["alternating"]("same", way([np.ones(3)], 1.0), way([np.ones(3)], 1.01), 4)
    np.testing.assert_array_equal(took[0], [[3, 4], [6, 5], [7, 8], [10, 9]])  # A B, B A, ...
    names["said"]("like", took, False)
    assert "within a pair 1.010 (1.010 .. 1.010)" in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"got a ratio of 1.040 .. 1.040, expected 1 within 0.03"):
        names["said"]("slower", np.stack([took[1], took[1] * [1.0, 1.04 / 1.01]]), False)
    with pytest.raises(SystemExit, match="got other bits"):
        names["alternating"]("other", way([np.ones(3)], 1.0), way([np.ones(3) * (1 + 1e-15)], 1.0), 1)
