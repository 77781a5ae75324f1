"""Arithmetic kernels for many lanes, used if the compiler's own code is too slow or depends on the rest of the program.

Products
    A compiler may fuse a product and a sum into one operation with one rounding (FMA) if both are in one loop. Which operations
    are in one loop depends on the whole program. So the last bit of a run would depend on the other observers in the program.
    `separate_products` adds a zero that the compiler cannot see to every product, so each product is rounded by itself. Only
    the product and that zero are fused, at no cost. Small matrix products are written as products and sums, for the same
    reason. This also reduces the time of the multiple-model filter to a third of `dot_general` under vmap.

Sine and cosine
    XLA calls a scalar function per lane: 5 ns per sine on one server core, against 1 ns here. Sine and cosine of one angle take
    1.3 ns instead of 9.3 ns. Plants and observers use `jnp.sin` and `jnp.cos`, which the interpreter replaces by these.
    An angle x is n quarter turns and a remainder r = x - n pi/2, |r| <= pi/4. pi/2 has three parts of 33 bits, so that n times
    each of the first two is exact (Cody and Waite). t is the rounding error of r. Sine and cosine of r are polynomials in r^2.

Accuracy: 1 unit in the last place for |x| up to 1e5, 2 up to 1.5e6. Beyond, the error grows as 1e-16 |x|. Angles above 1e12,
which only diverged estimates have, are replaced by 1e12.
Source: W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980. The polynomial coefficients are those of
fdlibm (Sun Microsystems, 1993), of least error on [-pi/4, pi/4].
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import Eqn

PI_2 = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
LARGEST_ANGLE = 1e12  # rad
MOST_PRODUCTS = 128  # products in one dot_general; larger ones use vmap, which compiles faster and runs as fast


_ZERO: ContextVar[Array | None] = ContextVar("zero", default=None)


@contextmanager
def separate_products(number: Array) -> Iterator[None]:
    """Round every product separately in programs traced in this context; `number` is any finite argument of the program."""
    with _use_zero(0.0 * number):
        yield


@contextmanager
def _use_zero(zero: Array | None) -> Iterator[None]:
    token = _ZERO.set(zero)
    try:
        yield
    finally:
        _ZERO.reset(token)


def product(a: Array, b: Array) -> Array:
    """Return a b."""
    zero = _ZERO.get()
    result = lax.mul(a, b)
    return result if zero is None or a.dtype != jnp.float64 else lax.add(result, lax.full_like(result, zero))


def is_written_out(eqn: Eqn) -> bool:
    """Return whether a dot_general is written as products and sums."""
    return jaxpr_compat.product_count(eqn) <= MOST_PRODUCTS


def dot(a: Array, b: Array, dimension_numbers: Any) -> Array:
    """Return the result of `lax.dot_general`: [batch, rest of a, rest of b]."""
    (ca, cb), (ba, bb) = dimension_numbers
    free_a = [i for i in range(a.ndim) if i not in (*ba, *ca)]
    free_b = [i for i in range(b.ndim) if i not in (*bb, *cb)]
    a, b = lax.transpose(a, (*ca, *ba, *free_a)), lax.transpose(b, (*cb, *bb, *free_b))
    a = lax.expand_dims(a, range(a.ndim, a.ndim + len(free_b)))
    b = lax.expand_dims(b, range(len(cb) + len(bb), len(cb) + len(bb) + len(free_a)))
    shape = jnp.broadcast_shapes(a.shape, b.shape)
    terms = [(a[i], b[i]) for i in np.ndindex(shape[: len(ca)])]
    factors = [[jnp.broadcast_to(x, shape[len(ca) :]) for x in term] for term in terms]
    return reduce(lax.add, (product(*term) for term in factors))


def power(x: Array, exponent: int) -> Array:
    """Return a positive integer power, by squaring."""
    half = power(x, exponent // 2) if exponent > 1 else None
    even = x if half is None else product(half, half)
    return even if exponent == 1 or exponent % 2 == 0 else product(even, x)


def sin(x: Array) -> Array:
    """Return the sine of angles [rad] in float64."""
    return _sine_of_quarters(x, _ZERO.get(), 0.0)


def cos(x: Array) -> Array:
    """Return the cosine of angles [rad] in float64."""
    return _sine_of_quarters(x, _ZERO.get(), 1.0)


@partial(jax.jit, static_argnums=2)  # traced once for each shape
def _sine_of_quarters(x: Array, zero: Array | None, quarters: float) -> Array:
    """Return the sine of an angle plus a number of quarter turns."""
    with _use_zero(zero):
        x = lax.clamp(-LARGEST_ANGLE, x, LARGEST_ANGLE)
        n = jnp.round(_times(1 / (PI_2[0] + PI_2[1]), x))
        high, low = x - _times(PI_2[0], n), _times(PI_2[1], n)
        r = high - low
        t = (high - r) - low - _times(PI_2[2], n)
        n = n + quarters
        # 0 to 3, as a float, for which every processor has vector instructions
        quarter = n - _times(4.0, jnp.floor(_times(0.25, n)))
        is_odd = (quarter == 1.0) | (quarter == 3.0)
        magnitude = jnp.where(is_odd, _cosine(r, t), _sine(r, t))
        return jnp.where(quarter >= 2.0, -magnitude, magnitude)


def _sine(r: Array, t: Array) -> Array:
    z = product(r, r)
    cube = product(z, r)
    high = product(cube, _polynomial(SINE[1:], z))
    return r - ((product(z, _times(0.5, t) - high) - t) - _times(SINE[0], cube))


def _cosine(r: Array, t: Array) -> Array:
    z = product(r, r)
    half = _times(0.5, z)
    c = 1.0 - half
    return c + (((1.0 - c) - half) + (product(product(z, z), _polynomial(COSINE, z)) - product(r, t)))


def _polynomial(coefficients: tuple[float, ...], z: Array) -> Array:
    """Return the polynomial with coefficients of rising order, by Horner's rule."""
    value = jnp.full_like(z, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = product(value, z) + c
    return value


def _times(number: float, x: Array) -> Array:
    return product(x, jnp.full_like(x, number))


KERNELS: dict[str, Callable[..., Array]] = {"mul": product, "sin": sin, "cos": cos}  # by the name of the primitive


def function_of(eqn: Eqn) -> Callable[..., Array]:
    """Return the function that applies a primitive to float64 arrays: a kernel of this module, or that of jax."""
    name, params = eqn.primitive.name, eqn.params
    if eqn.outvars[0].aval.dtype == jnp.float64:
        if name in KERNELS:
            return KERNELS[name]
        if name == "dot_general" and is_written_out(eqn):
            return partial(dot, dimension_numbers=params["dimension_numbers"])
        if name == "square" or (name == "integer_pow" and params["y"] > 0):
            return partial(power, exponent=params.get("y", 2))
    return partial(eqn.primitive.bind, **params)
