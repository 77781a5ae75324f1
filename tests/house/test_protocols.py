"""Every plant and observer keeps the protocol: argument names, shapes, purity; a new one is tested by being listed."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, Case, context_of, problem, suitable

from pcbench.dynamics.integrate import rk4
from pcbench.observers import OBSERVERS, base_of
from pcbench.plants import PLANTS, entry_of, output_units, signals_of, states_of
from pcbench.protocols import Arrival
from pcbench.scenarios import INTERVAL, SCENARIOS
from pcbench.simulation.types import present

SIGNATURES = {
    "init": ["gains", "xhat0"],
    "snapshot": ["gains", "memory", "now"],
    "jump": ["gains", "memory", "now", "arrival"],
    "flow": ["gains", "memory", "now"],
    "estimate": ["gains", "memory"],
}
OPTIONAL = {
    "covariance": ["gains", "memory", "now"],
    "innovation": ["gains", "memory", "now", "arrival"],
    "on_sample": ["gains", "memory", "now", "mask"],
    "init_random": ["gains", "memory", "words", "xhat0"],
}


@pytest.mark.parametrize("name", OBSERVERS)
def test_observer_functions_have_the_protocols_arguments(name):
    for function, names in SIGNATURES.items():
        assert list(inspect.signature(getattr(OBSERVERS[name].observer, function)).parameters) == names
    for function, names in OPTIONAL.items():
        f = getattr(OBSERVERS[name].observer, function)
        assert f is None or list(inspect.signature(f).parameters) == names


@pytest.mark.parametrize("name", PLANTS)
def test_plant_functions_have_the_protocols_arguments(name):
    for function in ("step", "output", "field"):
        f = getattr(PLANTS[name].plant, function)
        assert f is None or list(inspect.signature(f).parameters) == ["params", "now", "x"]


@pytest.mark.parametrize(("name", "model"), [(o, m) for o in OBSERVERS for m in suitable(o)])
def test_memory_keeps_its_shape_and_gains_are_arrays(name, model):
    q, n = model.C.shape
    _, p = problem(Case(model, 10, 20, ticks=50), {name: {}})
    observer, gains = OBSERVERS[name].observer, p.gains[name]
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(gains))

    def called(p, gains):
        memory, now = observer.init(gains, jnp.zeros(n)), present(p, jnp.asarray(30), True)
        snapshot = observer.snapshot(gains, memory, now)
        arrival = Arrival(jnp.ones(q), jnp.ones(q, bool), jnp.full(q, 20), jnp.ones(q, int), snapshot, jnp.asarray(10))
        moved = [observer.jump(gains, memory, now, arrival), observer.flow(gains, memory, now)]
        moved += [observer.field(gains, memory, now, jnp.ones(q))] if observer.field else []
        return memory, moved, snapshot, observer.estimate(gains, memory)

    memory, moved, snapshot, estimate = jax.eval_shape(called, p, gains)
    assert snapshot.ndim == 1
    for after in moved:
        assert jax.tree.map(lambda a: (a.shape, a.dtype), after) == jax.tree.map(lambda a: (a.shape, a.dtype), memory)
    signals = n + len(context_of(Case(model, 10, 20)).unknown_std)
    assert estimate.shape in ((n,), (signals,))


@pytest.mark.ci
@pytest.mark.parametrize("name", OBSERVERS)
def test_a_channel_that_is_not_fresh_changes_nothing(name):
    """Whatever value stands in a channel that did not arrive, the estimate is the same."""
    model = suitable(name)[-1]
    p = jax.tree.map(jnp.asarray, problem(Case(model, 10, 20, ticks=50), {name: {}})[1])
    observer, gains, q = OBSERVERS[name].observer, p.gains[name], len(model.C)
    memory, now = observer.init(gains, jnp.arange(float(len(p.x0)))), present(p, jnp.asarray(30), False)
    snapshot = observer.snapshot(gains, memory, now)

    def jumped(other):
        arrival = Arrival(
            jnp.array([2.0, other])[2 - q :],
            jnp.array([True, False])[2 - q :],
            jnp.full(q, 20),
            jnp.ones(q, int),
            snapshot,
            jnp.asarray(10),
        )
        return observer.flow(gains, observer.jump(gains, memory, now, arrival), now)

    for a, b in zip(jax.tree.leaves(jumped(0.0)), jax.tree.leaves(jumped(77.0)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_name_what_exists(name):
    s = SCENARIOS[name]
    assert {base_of(label) for label in s.observers} <= set(OBSERVERS)
    assert {len(s.truth.x0), len(s.belief.xhat0), len(s.belief.prior_std)} == {len(states_of(s))}
    assert len(s.scoring.settle_band) == len(signals_of(s))
    assert len(output_units(s)) == len(s.sampling.noise_std)
    assert all(output_units(s)), "every output has a unit"
    assert len(signals_of(s)) == len(s.truth.x0) + len(s.belief.unknown_std) + len(entry_of(s).errors)
    assert set(s.scoring.headline) <= {name for name, _ in signals_of(s)}
    assert 0 <= s.scoring.steady_start < s.duration
    for seconds in (
        *s.sampling.sampling_period,
        *(0.0 if d == INTERVAL else d for d in s.sampling.delay),
        s.duration,
        s.scoring.steady_start,
    ):
        assert abs(seconds / s.dt - round(seconds / s.dt)) < 1e-9


@pytest.mark.ci
@pytest.mark.parametrize("drift", [0.0, 1.0])
def test_the_carts_field_is_its_step_in_the_limit(drift):
    """Plant.field and Plant.step describe one plant: a tick is the integral of the field (RK4 to 1e-6)."""
    entry = PLANTS["cart"]
    params = jax.tree.map(jnp.asarray, entry.prepare(entry.numbers._replace(drift=drift), 1e-3, 20))
    p = jax.tree.map(jnp.asarray, problem(Case(CART, 10, 10, ticks=20), {"model-only": {}})[1])
    now, x = present(p, jnp.asarray(7), True), jnp.array([1.0, 20.0])
    stepped = entry.plant.step(params, now, x)
    flowed = rk4(lambda t, x: entry.plant.field(params, now._replace(t=t), x), now.t, x, now.dt)
    np.testing.assert_allclose(stepped, flowed, rtol=1e-6)


OWN = {"A": [[0.0, 1.0], [-2.0, -0.3]], "B": [[0.0], [1.5]], "C": [[1.0, 0.0]], "D": [[0.4]]}


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "off", "gain", "bias"),
    [("cart", {}, 1.0, 0.2), ("cart", {"drift": 1.0}, 1.0, 0.2), ("lti", OWN, 1.1, -0.3)],
)
def test_a_plant_is_pushed_by_its_gain_times_the_input_and_its_bias(name, off, gain, bias):
    """What moves a plant that differs from its model so is what moves the model under that input."""
    entry = PLANTS[name]
    model = entry.numbers._replace(**off)
    wrong = model._replace(input_bias=bias, **({"input_gain": gain} if gain != 1 else {}))
    p = jax.tree.map(jnp.asarray, problem(Case(CART, 10, 10, ticks=20), {"model-only": {}})[1])
    now, x = present(p, jnp.asarray(7), True), jnp.array([1.0, 20.0])
    theirs, own = (jax.tree.map(jnp.asarray, entry.prepare(numbers, 1e-3, 20)) for numbers in (wrong, model))
    pushed = now._replace(u=gain * now.u + bias)
    assert jnp.abs(now.u).min() > 0.1
    for f in (entry.plant.step, entry.plant.output, entry.plant.field):
        np.testing.assert_allclose(f(theirs, now, x), f(own, pushed, x), rtol=1e-12)
