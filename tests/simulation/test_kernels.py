"""The engine's own products, sine and cosine: against extended precision, and applied by the interpreter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import pcbench
from pcbench.engine import event_loop, jaxpr_compat, kernels, runner
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.lane_array import is_lanes, join, split

REFERENCES = {"sin": np.sin, "cos": np.cos}


def test_products_round_by_themselves_if_asked():
    a, b, c = np.random.default_rng(0).normal(size=(3, 4096))
    separate = a * b + c

    def found(number):
        with kernels.separate_products(number):
            return kernels.product(a, b) + c

    assert np.array_equal(jax.jit(found)(0.01), separate)


@pytest.mark.parametrize("exponent", range(1, 12))
def test_powers_agree_with_repeated_products(exponent):
    x = np.random.default_rng(exponent).uniform(0.5, 2, 50)
    np.testing.assert_allclose(kernels.power(jnp.asarray(x), exponent), x**exponent, rtol=1e-14)


def test_powers_and_squares_of_a_step_round_each_product():
    x = np.random.default_rng(4).normal(size=(2, 64))

    def step(a):
        return a**2 + a[::-1], jnp.square(a) + 1.0, a**3

    def found(number):
        with kernels.separate_products(number):
            return jax.tree.map(join, vmap_entrywise(step)(split(jnp.asarray(x))), is_leaf=is_lanes)

    wanted = x * x + x[::-1], x * x + 1.0, x * x * x
    for each, exact in zip(jax.jit(found)(0.01), wanted, strict=True):
        assert np.array_equal(each, exact)


DOTS = {
    "dot": lambda a, b: a[0] @ b[0],
    "matrix and vector": lambda a, b: a @ b[0],
    "matrices": lambda a, b: a @ b.T,
    "outer": lambda a, b: jnp.tensordot(a[0], b[0], 0),
    "both axes": lambda a, b: jnp.tensordot(a, b, 2),
    "batch": lambda a, b: jnp.einsum("ij,ij->i", a, b),
    "batch, both axes": lambda a, b: jnp.einsum(
        "ijk,kil->ilj", jnp.stack([a, b]), jnp.stack([b, a], 1).transpose(2, 1, 0)
    ),
}


@pytest.mark.parametrize("name", DOTS)
def test_products_of_what_all_lanes_share_agree_with_matmul_and_hold_no_dot(name):
    a, b = np.random.default_rng(5).normal(size=(2, 3, 3))
    f = vmap_entrywise(DOTS[name])
    np.testing.assert_allclose(f(jnp.asarray(a), jnp.asarray(b)), DOTS[name](a, b), rtol=1e-13, atol=1e-15)
    assert "dot_general" not in str(jax.make_jaxpr(f)(a, b))


def products_in(jaxpr):
    """Every product of a program and of those in it, but those with a zero."""
    for eqn in jaxpr.eqns:
        name, number = eqn.primitive.name, eqn.outvars[0].aval.dtype == jnp.float64
        plain = not any(getattr(v, "val", None) == 0.0 for v in eqn.invars)
        if number and name == "mul" and plain:
            yield str(eqn)
        if number and name == "dot_general" and jaxpr_compat.product_count(eqn) <= kernels.MOST_PRODUCTS:
            yield str(eqn)
        for program in jaxpr_compat.inner_programs(eqn.params):
            yield from products_in(getattr(program, "jaxpr", program))


@pytest.mark.parametrize(
    ("scenario", "observers"),
    [
        ("cart/white", ["pccebo", "kfbo", "kf", "ekf-delay"]),
        pytest.param("arm/sampled", ["smo", "pio", "kf"], marks=pytest.mark.ci),
        ("reactor/batch", ["ekf", "ukf"]),
        pytest.param("helicopter/varying", ["high-gain"], marks=pytest.mark.ci),
    ],
)
def test_every_product_of_an_event_loop_rounds_by_itself(scenario, observers, monkeypatch):
    """No product may be joined with a sum, be it of what lanes share, of a function applied as a unit, or left to vmap.

    Products by the kernel are made quotients here, to tell them from others. A large dot is none of the kernel.
    """
    programs, simulate = [], event_loop.simulate

    def noted(layout, *given):
        programs.append(jax.make_jaxpr(lambda *rest: simulate(layout, *rest))(*given).jaxpr)
        raise KeyboardInterrupt

    monkeypatch.setattr(event_loop, "simulate", noted)
    monkeypatch.setattr(runner, "_PROGRAMS", type(runner._PROGRAMS)())
    for draw in ("normal", "uniform"):  # what these compute is theirs alone
        monkeypatch.setattr(jax.random, draw, lambda key, shape=(), dtype=float, **_: jnp.zeros(shape, dtype))
    # not the compiled function, whose trace, with quotients, would be kept for the tests that follow
    monkeypatch.setattr(kernels, "_sine_of_quarters", kernels._sine_of_quarters.__wrapped__)
    monkeypatch.setattr(kernels, "product", lax.div)
    monkeypatch.setitem(kernels.KERNELS, "mul", lax.div)
    with pytest.raises(KeyboardInterrupt):
        pcbench.run({"name": "products", "scenarios": [scenario], "observers": observers}, seeds=2)
    assert " div " in str(programs[0])
    assert list(products_in(programs[0])) == []


def separately(kernel):
    def apply(x, number):
        with kernels.separate_products(number):
            return kernel(x)

    return apply


def units_in_the_last_place(name, x):
    found = np.asarray(jax.jit(separately(kernels.KERNELS[name]))(x, 0.01))
    exact = REFERENCES[name](x.astype(np.longdouble))
    return np.max(np.abs(found - exact) / np.spacing(np.abs(exact.astype(float))))


@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize(("size", "units"), [(1e-3, 1), (1.0, 1), (10.0, 1), (1e5, 1), (1.5e6, 2)])
def test_kernels_agree_with_extended_precision(name, size, units):
    x = np.random.default_rng(1).uniform(-size, size, 100_000)
    assert units_in_the_last_place(name, x) <= units


@pytest.mark.parametrize("name", REFERENCES)
def test_kernels_agree_next_to_multiples_of_quarter_turns(name):
    turns = np.arange(-4000, 4001) * (np.pi / 2)
    x = np.concatenate([turns, np.nextafter(turns, np.inf), turns + 1e-9, turns + np.pi / 4])
    found = np.asarray(kernels.KERNELS[name](x))
    assert np.abs(found - REFERENCES[name](x.astype(np.longdouble))).max() < 2e-16


@pytest.mark.parametrize("name", REFERENCES)
def test_error_grows_as_documented_for_large_angles(name):
    x = np.random.default_rng(2).uniform(1e6, 1e12, 100_000)
    found = np.asarray(kernels.KERNELS[name](x))
    assert np.all(np.abs(found - REFERENCES[name](x.astype(np.longdouble))) < 2e-16 + 1.2e-16 * x)


def test_kernels_stay_bounded_for_what_is_no_angle():
    x = jnp.array([jnp.inf, -jnp.inf, 1e300, jnp.nan])
    for name in REFERENCES:
        found = np.asarray(kernels.KERNELS[name](x))
        assert np.all(np.abs(found[:3]) <= 1)
        assert np.isnan(found[3])


@pytest.mark.parametrize("name", REFERENCES)
def test_interpreter_takes_kernels_for_lanes_and_for_what_all_lanes_share(name):
    x = np.random.default_rng(3).uniform(-9, 9, (2, 5))

    def step(shared, own):
        f = getattr(jnp, name)
        return f(shared), f(own)

    shared, own = vmap_entrywise(step)(jnp.asarray(x[:, 0]), split(jnp.asarray(x)))
    assert np.array_equal(shared, kernels.KERNELS[name](x[:, 0]))
    assert np.array_equal(join(own), kernels.KERNELS[name](x))
    assert np.array_equal(shared, join(own)[:, 0])
