"""Entries that are known before a program runs: results equal those of vmap, and products with zeros are left out."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from pcbench.engine import interpreter, jaxpr_compat, known_entries, lane_array, lane_forms
from pcbench.engine.interpreter import vmap_entrywise

L = 5
RNG = np.random.default_rng(11)
Z, P = RNG.normal(size=(3, L)), RNG.normal(size=(3, 3, L))


def field(z):
    return jnp.stack([z[1], jnp.sin(z[0]) * z[2], -z[2]])


def jacobian(z, field=field):
    return jnp.eye(3) + 0.1 * jax.jacfwd(field)(z)


def with_copy(z, P):
    """A Kalman update of a state with a copy, of which the output does not depend."""
    c = jnp.pad(jnp.array([1.0, 0.0, 2.0])[:2] + z[:2], (0, 1))
    I_KC = jnp.eye(3) - jnp.outer(z, c)
    return I_KC @ P @ I_KC.T


FUNCTIONS = {
    "jacobian": lambda z, P: jacobian(z),
    "covariance of a tick": lambda z, P: jacobian(z) @ P @ jacobian(z).T,
    "update of a state with a copy": with_copy,
    "second derivatives": lambda z, P: jax.hessian(lambda z: z[0] * jnp.sin(z[1]))(z),
    "0 x, x 0, 1 x, x 1, x / 1, 1 / x": lambda z, P: jnp.stack([0 * z, z * 0.0, 1 * z, z * 1.0, z / 1, 1 / z]),
    "0 + x, x - 0, 0 - x, 0 / x": lambda z, P: jnp.stack([0 + z, z + 0.0, z - 0.0, 0 - z, 0 / z]),
    "choice between equal entries": lambda z, P: jnp.where(z > 0, jnp.eye(3), jnp.diag(jnp.array([1.0, 1.0, 2.0]))) @ z,
    "choice that is known": lambda z, P: jnp.where(jnp.arange(3) == 1, z, 2.0),
    "whole numbers that wrap around": lambda z, P: (lax.iota(jnp.uint8, 3) + np.uint8(255) == 0) * z,
    "large whole numbers": lambda z, P: ((lax.iota(int, 3) + (2**53 + 1)) - 2**53) * z,
    "truncation": lambda z, P: jnp.array([0.5, 1.5, -0.5]).astype(int) * z,
    "a number as a truth": lambda z, P: jnp.array([2.0, 0.5, 0.0]).astype(bool) * z,
    "matrix product of zeros": lambda z, P: jnp.zeros((2, 3)) @ P,
    "batch of products": lambda z, P: jnp.einsum("kij,kjl->kil", jnp.stack([jnp.eye(3), jnp.tri(3)]), jnp.stack([P, P.T])),
    "sum of rows and columns": lambda z, P: (jnp.eye(3) * P).sum(0) + jnp.eye(3).sum(1),
    "in a loop": lambda z, P: lax.fori_loop(0, 2, lambda i, P: jacobian(z) @ P, P),
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_results_equal_vmap(name):
    got = vmap_entrywise(FUNCTIONS[name])(lane_array.split(jnp.asarray(Z)), lane_array.split(jnp.asarray(P)))
    want = jax.vmap(FUNCTIONS[name], -1, -1)(jnp.asarray(Z), jnp.asarray(P))
    got = lane_array.join(got) if lane_array.is_lanes(got) else jnp.broadcast_to(got[..., None], want.shape)
    assert got.dtype == want.dtype
    np.testing.assert_allclose(got, want, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_entry_that_is_known_has_this_value(name):
    program, _, _ = lane_forms.trace_lane(FUNCTIONS[name], jnp.asarray(Z[:, 0]), jnp.asarray(P[..., 0]))
    args = [lane_array.split(jnp.asarray(a)) for a in (Z, P)]
    (result,), (known,) = interpreter._evaluate_known(program.jaxpr, program.consts, args, [None, None])
    if known is not None:
        value = np.asarray(lane_array.join(result) if lane_array.is_lanes(result) else result[..., None])
        known = np.broadcast_to(known[..., None], value.shape)
        np.testing.assert_array_equal(value[~np.isnan(known)], known[~np.isnan(known)])


def test_zeros_of_a_jacobian_are_known():
    """df/dz = [[0, 1, 0], [cos(z0) z2, 0, sin(z0)], [0, 0, -1]]; of the entries of I + 0.1 df/dz, five are known."""
    program, _, _ = lane_forms.trace_lane(lambda z: (jax.jacfwd(field)(z), jacobian(z)), jnp.asarray(Z[:, 0]))
    args = [lane_array.split(jnp.asarray(Z))]
    _, (derivative, tick) = interpreter._evaluate_known(program.jaxpr, program.consts, args, [None])
    nan = np.nan
    np.testing.assert_array_equal(derivative, [[0, 1, 0], [nan, 0, nan], [0, 0, -1]])
    np.testing.assert_array_equal(tick, [[1, nan, 0], [nan, 1, nan], [0, 0, nan]])


def products_of(f, *args):
    """How many products a program has."""
    text = str(jax.make_jaxpr(vmap_entrywise(f))(*args))
    return text.count(" mul ")


def test_products_with_zeros_and_ones_are_left_out():
    """F has four entries that are neither 0 nor 1, and P none: F P has 3 x 4 products, and (F P) F' as many."""
    z, P_lanes = lane_array.split(jnp.asarray(Z)), lane_array.split(jnp.asarray(P))
    F = partial(jacobian, field=lambda z: jnp.stack([z[1], z[0] * z[2], -z[2]]))
    assert products_of(lambda z, P: F(z) @ P @ F(z).T, z, P_lanes) == 2 * products_of(F, z) + 24
    assert products_of(lambda F, P: F @ P @ F.T, P_lanes, P_lanes) == 54


def test_a_large_product_with_many_zeros_is_written_out():
    a = jnp.eye(8)
    product = vmap_entrywise(lambda x: a @ x)
    x = lane_array.split(jnp.asarray(RNG.normal(size=(8, 8, L))))
    assert "dot_general" not in str(jax.make_jaxpr(product)(x))
    assert "dot_general" in str(jax.make_jaxpr(vmap_entrywise(lambda x: x @ x))(x))


def test_a_zero_that_is_written_in_the_code_stays_a_factor():
    """So an observer that reads an input that is not stored, which is NaN, has no estimate."""
    x = lane_array.split(jnp.full((3, L), jnp.nan))
    assert np.isnan(lane_array.join(vmap_entrywise(lambda x: 0.0 * x + x * 0)(x))).all()


def test_large_values_are_not_examined():
    assert known_entries.of_constant(np.zeros(known_entries.MOST_ENTRIES)) is not None
    assert known_entries.of_constant(np.zeros(known_entries.MOST_ENTRIES + 1)) is None


REARRANGED = {
    "broadcast_in_dim": lambda x: jnp.broadcast_to(x[:, None, :], (3, 2, 4)),
    "concatenate": lambda x: jnp.concatenate([x, x[:1]], 0),
    "reshape": lambda x: x.reshape(2, 6),
    "slice": lambda x: x[1:, 1::2],
    "split": lambda x: jnp.split(x, [1], 1)[1],
    "squeeze": lambda x: lax.squeeze(x[:1], (0,)),
    "stack": lambda x: jnp.stack([x, x], 1),
    "transpose": lambda x: x.T,
}


@pytest.mark.parametrize("name", REARRANGED)
def test_a_rearrangement_in_numpy_equals_that_of_jax(name):
    x = np.arange(12.0).reshape(3, 4)
    program = jax.make_jaxpr(REARRANGED[name])(x)
    env = dict(zip(program.jaxpr.invars, [x], strict=True))
    seen = set()
    for eqn in program.jaxpr.eqns:
        args = [np.asarray(env[v]) for v in eqn.invars]
        want = eqn.primitive.bind(*map(jnp.asarray, args), **eqn.params)
        want = want if eqn.primitive.multiple_results else [want]
        got = jaxpr_compat.rearrange(eqn.primitive.name, eqn.params, args)
        for a, b in zip(got or want, want, strict=True):
            np.testing.assert_array_equal(a, b)
        seen |= {eqn.primitive.name} if got is not None else set()
        env.update(zip(eqn.outvars, want, strict=True))
    assert name in seen or (name == "stack" and "concatenate" in seen)  # up to jax 0.10.1 a stack is a concatenation
