"""Programs are loaded ahead by a command's words: the same programs, or none; and a program knows its trees."""

import json
from types import SimpleNamespace
from typing import NamedTuple

import jax
import numpy as np
import pytest

from pcbench.machine import process
from pcbench.simulation import kept_programs
from pcbench.simulation.foreseen import foreseen

X = np.arange(9.0)
WORDS = ("run", "quick")


class Pair(NamedTuple):
    a: jax.Array
    b: jax.Array


@pytest.fixture
def where(tmp_path, monkeypatch):
    """A cache of its own, with two programs."""
    before = {
        n: getattr(jax.config, n) for n in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    }
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    process.setup()
    for text, factor in {"twice": 2.0, "thrice": 3.0}.items():
        made = jax.jit(lambda p, by=factor: Pair(p.a * by, p.b)).lower(Pair(X, X)).compile()
        kept_programs.keep(kept_programs.folder(), text, None, made)
    yield kept_programs.folder()
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.fixture
def read(monkeypatch):
    """The texts of the programs that are read from their files."""
    texts, really = [], kept_programs.read
    monkeypatch.setattr(kept_programs, "read", lambda *a: (texts.append(a[1]), really(*a))[1])
    return texts


def asked(where, text):
    found = kept_programs.load(where, text, jax.devices()[0])
    return found and np.asarray(found(Pair(X, X)).a)


def note(where):
    (path,) = where.glob("*.foreseen")
    return path


def test_what_words_asked_for_is_read_once_they_are_said_again_and_not_a_second_time(where, read):
    with foreseen(WORDS):
        np.testing.assert_array_equal(asked(where, "twice"), 2 * X)
    assert read == ["twice"]
    assert json.loads(note(where).read_text()) == ["twice"]
    with foreseen(WORDS):
        np.testing.assert_array_equal(asked(where, "twice"), 2 * X)
        assert read == ["twice"] * 2
        asked(where, "twice")
    assert read == ["twice"] * 3, "a program that was handed out is not handed out again"
    with foreseen(("run", "cart")):
        pass
    assert len(read) == 3, "other words, other programs"


def test_a_guess_that_is_wrong_changes_nothing_and_is_put_right(where, read):
    for text, factor in (("twice", 2), ("thrice", 3), ("thrice", 3)):
        with foreseen(WORDS):
            np.testing.assert_array_equal(asked(where, text), factor * X)
    assert sorted(read) == ["thrice", "thrice", "twice", "twice"]
    assert json.loads(note(where).read_text()) == ["thrice"]
    with foreseen(WORDS):
        pass
    assert json.loads(note(where).read_text()) == ["thrice"], "a run that had nothing to do says nothing of the next"


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"a": 1}', '["gone"]'])
def test_a_note_that_is_none_costs_nothing(where, content):
    for _ in range(2):
        with foreseen(WORDS):
            np.testing.assert_array_equal(asked(where, "twice"), 2 * X)
        note(where).write_text(content)


def test_for_another_device_it_is_read_anew(where, monkeypatch):
    devices = jax.devices()
    monkeypatch.setattr(kept_programs, "read", lambda where, text, device: SimpleNamespace(trees=True, on=device))
    for asks in (devices[1], devices[0], devices[1]):
        with foreseen(WORDS):
            assert kept_programs.load(where, "twice", asks).on == asks


def test_where_nothing_is_kept_nothing_is_foreseen(where, monkeypatch):
    jax.config.update("jax_compilation_cache_dir", str(where))
    with foreseen(WORDS):
        asked(where, "twice")
    assert not list(where.glob("*.foreseen"))


def test_trees_are_those_it_was_compiled_for_and_where_their_types_are_gone_it_is_none(where, monkeypatch):
    found = kept_programs.load(where, "twice", jax.devices()[0])
    assert type(found(Pair(X, X))) is Pair
    with pytest.raises(TypeError, match="expected PyTreeDef"):
        found((X, X))
    with pytest.raises(TypeError, match="a program that is kept: got"):
        found(Pair(X, X), X)
    monkeypatch.delitem(globals(), "Pair")
    assert kept_programs.read(where, "twice", jax.devices()[0])
    assert kept_programs.load(where, "twice", jax.devices()[0]) is None
