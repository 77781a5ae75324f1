"""Every function of every observer says its shapes, and refuses others: checked calls (`shapes.check_types`) raise."""

import jax
import jax.numpy as jnp
import pytest
from harness import Case, problem, suitable
from jaxtyping import TypeCheckError

from pcbench.engine import steps
from pcbench.observers import OBSERVERS
from pcbench.protocols import Arrival


class Calls:
    """An observer's gains, memory and arguments at tick 30, as they should be."""

    def __init__(self, name):
        model = suitable(name)[-1]
        q, n = model.C.shape
        p = jax.tree.map(jnp.asarray, problem(Case(model, 10, 20, ticks=50), {name: {}})[1])
        self.observer, self.gains, self.now = (
            OBSERVERS[name].observer,
            p.gains[name],
            steps.present(p, jnp.asarray(30), True),
        )
        self.xhat0, self.y = jnp.ones(n), jnp.ones(q)
        self.memory = self.observer.init(self.gains, self.xhat0)
        snapshot = self.observer.snapshot(self.gains, self.memory, self.now)
        self.arrival = Arrival(self.y, jnp.ones(q, bool), jnp.full(q, 20), jnp.ones(q, int), snapshot, jnp.asarray(10))


def taller(tree):
    """The same with a further axis on every array."""
    return jax.tree.map(lambda a: jnp.asarray(a)[None], tree)


@pytest.fixture(params=OBSERVERS)
def calls(request):
    return Calls(request.param)


def assert_type_error(function, *args):
    with pytest.raises((TypeError, TypeCheckError)) as found:
        function(*args)
    assert "Type-check error" in str(found.value)


@pytest.mark.ci
def test_as_they_should_be_all_are_taken(calls):
    c = calls
    for memory in (
        c.memory,
        c.observer.jump(c.gains, c.memory, c.now, c.arrival),
        c.observer.flow(c.gains, c.memory, c.now),
    ):
        c.observer.estimate(c.gains, memory)
    if c.observer.field:
        c.observer.field(c.gains, c.memory, c.now, c.y)


@pytest.mark.ci
def test_a_start_of_another_rank_is_refused(calls):
    assert_type_error(calls.observer.init, calls.gains, calls.xhat0[None])


@pytest.mark.ci
def test_a_note_of_a_memory_of_another_rank_is_refused(calls):
    assert_type_error(calls.observer.snapshot, calls.gains, taller(calls.memory), calls.now)


@pytest.mark.ci
@pytest.mark.parametrize("function", ["snapshot", "flow"])
def test_an_input_of_another_rank_is_refused(calls, function):
    assert_type_error(
        getattr(calls.observer, function), calls.gains, calls.memory, calls.now._replace(u=calls.now.u[None])
    )


@pytest.mark.parametrize("field", ["value", "mask", "age", "index"])
def test_an_arrival_with_a_channel_more_in_one_place_is_refused(calls, field):
    more = jnp.append(getattr(calls.arrival, field), getattr(calls.arrival, field)[:1])
    assert_type_error(
        calls.observer.jump, calls.gains, calls.memory, calls.now, calls.arrival._replace(**{field: more})
    )


@pytest.mark.ci
def test_a_memory_of_another_rank_is_no_estimate(calls):
    assert_type_error(calls.observer.estimate, calls.gains, taller(calls.memory))


def test_a_field_refuses_an_output_of_another_rank(calls):
    if calls.observer.field:
        assert_type_error(calls.observer.field, calls.gains, calls.memory, calls.now, calls.y[None])
