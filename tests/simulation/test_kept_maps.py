"""Maps of a lifted flow are made once for all problems that agree in what they depend on, and nobody's numbers change by it.

What they depend on is said by their equations; the oracle here is to change a problem's numbers one leaf at a time.
"""

import threading
from functools import partial

import jax
import numpy as np
import pytest

from pcbench.engine import event_loop, runner
from pcbench.engine.products import map_cache
from pcbench.machine import process
from tests.support.harness import ODD, Case, problem

pytestmark = pytest.mark.usefixtures("in_a_hurry")
CASE = Case(ODD, 37, 74, ticks=400, h=0.01, noise_std=0.4, seed=3, xhat0=[0.5, -1.0, 2.0], input_intensity=0.05)
OBSERVERS, WIDTH = ("pccebo", "dkf"), 4


@pytest.fixture(scope="module")
def one():
    """A layout with two observers that go by products, its problem as NumPy's arrays, and a function that makes maps."""
    with process.float64():
        layout, p = problem(CASE, {o: {} for o in OBSERVERS})
        layout, p = layout._replace(lifted=64, width=WIDTH, random_start=True), jax.tree.map(np.asarray, p)
        return layout, p, jax.jit(partial(map_cache.made, layout))


def named(p):
    """The leaves of a problem by name, in their order."""
    return {jax.tree_util.keystr(path): a for path, a in jax.tree_util.tree_flatten_with_path(p)[0]}


def with_leaf(p, name, value):
    leaves = named(p) | {name: value}
    return jax.tree.unflatten(jax.tree.structure(p), list(leaves.values()))


def bits(maps):
    return [np.asarray(a).tobytes() for a in jax.tree.leaves(maps)]


def test_maps_depend_on_what_is_read_and_on_nothing_else(one):
    layout, p, make = one
    with process.float64():
        reads, before, rng = map_cache.reads(map_cache.traced(layout, p)), make(p), np.random.default_rng(0)
        assert set(reads) == {"", *OBSERVERS}
        changed = {label: set() for label in reads}
        for name, a in named(p).items():
            if a.dtype.kind != "f" or not a.size:
                continue
            after = make(with_leaf(p, name, a + rng.uniform(0.1, 0.2, a.shape)))
            for label in reads:
                if bits(after[label]) != bits(before[label]):
                    changed[label].add(name)
    names = list(named(p))
    for label, found in changed.items():
        assert found, "something that they depend on"
        assert found <= {names[i] for i in reads[label]}
    assert not {".noise_std", ".x0", ".spread0"} & {names[i] for each in reads.values() for i in each}


def test_problems_that_differ_in_noise_share_maps_and_those_of_another_plant_input_or_schedule_do_not(one):
    layout, p, _ = one
    calls, kept = [], map_cache.Kept(2**30)
    with process.float64():
        reads = sorted(set().union(*map_cache.reads(map_cache.traced(layout, p)).values()))
    maker = map_cache.Maker(lambda p: calls.append(p) or {"made": np.asarray(len(calls))}, tuple(reads), 0)
    other = p._replace(schedule=p.schedule._replace(event=~p.schedule.event))
    each = [
        p,
        p._replace(noise_std=p.noise_std * 2, x0=p.x0 + 1),
        p._replace(params=jax.tree.map(lambda a: a * 1.01, p.params)),
        p._replace(inputs=p.inputs * 2),
        other,
        p,
    ]
    assert [int(map_cache.given(maker, q, kept)["made"]) for q in each] == [1, 1, 2, 3, 4, 1]


def calls(one, observers):
    """A program of some of the observers, its problem, and what two calls leave."""
    layout, p, _ = one
    layout = layout._replace(observers=tuple(o for o in layout.observers if o[0] in observers))
    p = p._replace(gains={o: p.gains[o] for o in observers})
    job = runner.Job(p, 0, np.arange(WIDTH))
    made = runner.program(layout, job)
    return made, layout, p, [next(runner.serial(made, [job]))[1] for _ in range(2)]


def test_a_call_leaves_the_same_with_maps_that_were_kept(one):
    """That they are right is tested in test_lifted."""
    with process.float64():
        made, _, _, (first, again) = calls(one, ["dkf"])
    assert made.ways == {"dkf": "lifted"}
    assert bits(first) == bits(again)


@pytest.mark.nightly
def test_a_call_leaves_the_same_with_maps_that_it_makes_itself(one):
    with process.float64():
        _, layout, p, (first, _) = calls(one, OBSERVERS)
        alone = jax.jit(partial(event_loop.simulate, layout))(p, np.asarray(0), np.arange(WIDTH))
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, 1e-11, 1e-13 * np.abs(b).max(initial=0.0))


def test_a_layout_that_is_stepped_has_no_maps(one):
    layout, p, _ = one
    with process.float64():
        assert map_cache.reads(map_cache.traced(layout._replace(lifted=0), p)) == {}
    assert map_cache.given(None, p) == {}


def test_of_several_that_ask_for_the_same_one_makes_it():
    kept, begun, go, calls = map_cache.Kept(2**20), threading.Event(), threading.Event(), []

    def make():
        calls.append(begun.set())
        go.wait(10)
        return np.zeros(3)

    found = []
    threads = [threading.Thread(target=lambda: found.append(kept.ask("key", make))) for _ in range(4)]
    for thread in threads:
        thread.start()
    begun.wait(10)
    go.set()
    for thread in threads:
        thread.join()
    assert len(calls) == 1
    assert all(a is found[0] for a in found)


def test_what_cannot_be_made_is_not_kept():
    kept = map_cache.Kept(2**20)
    with pytest.raises(ZeroDivisionError):
        kept.ask("key", lambda: 1 / 0)
    assert kept.ask("key", lambda: np.ones(1)) == 1


def test_those_that_were_asked_for_first_are_forgotten_where_room_is_short_but_never_the_last():
    kept = map_cache.Kept(100)
    for key in "abc":
        kept.ask(key, lambda: np.zeros(5))  # 40 bytes
    assert list(kept.made) == ["b", "c"]
    kept.ask("b", list)
    kept.ask("d", lambda: np.zeros(5))
    assert list(kept.made) == ["b", "d"], "c was asked for before b"
    kept.ask("e", lambda: np.zeros(50))
    assert list(kept.made) == ["e"]
