"""The engine's own products, sine and cosine: against extended precision, and in place of jnp's in a step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.engine import kernels
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
