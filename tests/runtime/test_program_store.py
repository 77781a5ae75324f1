"""Traced programs on disk: the same numbers with and without, one key for one program, and none for a user's functions."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jax.tree_util import Partial

from pcbench import observers
from pcbench.runtime import program_store
from pcbench.simulation.metrics import ErrorSums
from pcbench.study.labels import base_in, label_of

STUDY = """name = "short"
seeds = 16
observers = ["pccebo"]

[scenario]
base = "cart/white"
duration = 1.0
steady_start = 0.5
"""
SCRIPT = """import sys
from jax import export
from pcbench.cli import main
from pcbench.runtime import program_store
from pcbench.study.labels import base_in, label_of
what, *words = sys.argv[1:]
if what == "traced":
    program_store.allow = lambda: None
if what == "stored":
    export.export = None  # nothing may be traced
sys.argv = ["pcbench", *words]
main()
"""


def add(one, many):
    """Return what both are together."""
    return ErrorSums(one + many[0], one * 2, many[1])


add.__module__ = "pcbench.of_this_test"
ARRAYS = np.ones(3), (np.arange(3.0), np.zeros(2))


@pytest.fixture
def store(monkeypatch, tmp_path):
    """The store, allowed, in a folder of its own; with how often `add` was traced."""
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    monkeypatch.setattr(program_store, "_allowed", True)
    return tmp_path / "traces"


def compile_add(about="about"):
    """Compile `add`; return what it gives, and whether it was traced for that."""
    traced = []

    @functools.wraps(add)
    def counted(*given):
        traced.append(1)
        return add(*given)

    call = program_store.compile_program(counted, about, ARRAYS, None, (ErrorSums,))
    return call(*ARRAYS), bool(traced)


def test_a_stored_program_is_not_traced_and_gives_the_same_tree(store):
    first, traced = compile_add()
    again, traced_again = compile_add()
    assert (traced, traced_again) == (True, False)
    assert isinstance(again, ErrorSums)
    for a, b, expected in zip(first, again, add(*ARRAYS), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, expected)


@pytest.mark.parametrize("spoil", [lambda b: b[:-7], lambda b: b[:99] + b"x" + b[100:], lambda b: b""])
def test_a_damaged_program_is_traced_again(store, spoil):
    compile_add()
    (path,) = store.iterdir()
    path.write_bytes(spoil(path.read_bytes()))
    assert compile_add()[1]
    assert not compile_add()[1]


def test_programs_used_longest_ago_are_removed(store, monkeypatch):
    monkeypatch.setattr(program_store, "ROOM", 2)
    for about in ("a", "b"):
        compile_add(about)
    for age, path in enumerate(sorted(store.iterdir(), key=lambda p: p.stat().st_mtime, reverse=True)):
        os.utime(path, (1e9 - age, 1e9 - age))
    assert not compile_add("a")[1]  # now used last
    compile_add("c")
    assert not compile_add("a")[1]
    assert compile_add("b")[1]


def closure(number):
    def inner(x):
        return x * number

    inner.__module__ = "pcbench.of_this_test"
    return inner


def ours(function):
    function.__module__ = "pcbench.of_this_test"
    return function


DIFFERENT = {
    "numbers": (1, 2),
    "types of numbers": (1, 1.0),
    "truth": (True, 1),
    "texts": ("a", "b"),
    "lists": ([1, 2], [2, 1]),
    "nests": (((1,), 2), ((1, 2),)),
    "arrays": (np.zeros(2), np.zeros(3)),
    "values of arrays": (np.zeros(2), np.ones(2)),
    "dtypes": (np.zeros(2), np.zeros(2, int)),
    "shapes": (jax.ShapeDtypeStruct((2,), float), jax.ShapeDtypeStruct((2, 1), float)),
    "named tuples": (ErrorSums(1, 2, 3), (1, 2, 3)),
    "keys": ({"a": 1}, {"b": 1}),
    "closures": (closure(1.0), closure(2.0)),
    "defaults": (ours(lambda x=1: x), ours(lambda x=2: x)),
    "functions on one line": (ours(lambda x: x + 1), ours(lambda x: x - 1)),
    "constants on one line": (ours(lambda x: x + 1), ours(lambda x: x + 2)),
    "arguments of a partial": (Partial(label_of, 1), Partial(label_of, 2)),
    "programs within": (jax.jit(closure(1.0)), jax.jit(closure(2.0))),
    "functions": (label_of, base_in),
}


@pytest.mark.parametrize("what", DIFFERENT)
def test_what_differs_has_another_key(what):
    a, b = (program_store._digest(add, each) for each in DIFFERENT[what])
    assert a
    assert b
    assert a != b


def test_another_function_has_another_key():
    assert program_store._digest(add, 1) != program_store._digest(label_of, 1)


def test_equal_things_made_twice_have_one_key():
    assert program_store._digest(add, closure(1.0), label_of) == program_store._digest(add, closure(1.0), label_of)


def users_own(x):
    return x


@pytest.mark.parametrize(
    "about",
    [
        users_own,
        lambda x: x,
        (1, [users_own]),
        functools.partial(users_own, 1),
        jax.jit(users_own),
        eval("lambda x: x", {}),
    ],
)
def test_what_a_user_wrote_has_no_key(about):
    assert program_store._digest(add, about) is None
    assert program_store._digest(add, ours(lambda x: users_own(x)).__code__) is not None  # a name alone is no function
    assert program_store._digest(users_own, 1) is None


def test_an_object_of_unknown_content_has_no_key():
    assert program_store._digest(add, object()) is None
    assert program_store._digest(add, jnp.sin) is None or program_store._digest(add, jnp.sin) != program_store._digest(
        add, jnp.cos
    )
    assert program_store._digest(add, observers) is None  # a module


@pytest.mark.ci
def test_the_command_line_takes_the_trace_of_a_run_before(tmp_path):
    (tmp_path / "short.toml").write_text(STUDY)
    tables = {}
    for what in ("traced", "first", "stored"):
        words = [sys.executable, "-c", SCRIPT, what, "run", "short.toml", "--out", what, "--quiet"]
        cache = "other" if what == "traced" else "cache"
        subprocess.run(words, cwd=tmp_path, env=os.environ | {"PCBENCH_CACHE": str(tmp_path / cache)}, check=True)
        tables[what] = pd.read_parquet(tmp_path / what / "stats.parquet")
    assert not (tmp_path / "other" / "traces").exists()
    assert len(list((tmp_path / "cache" / "traces").iterdir())) == 1
    pd.testing.assert_frame_equal(tables["traced"], tables["first"], check_exact=True)
    pd.testing.assert_frame_equal(tables["traced"], tables["stored"], check_exact=True)
