"""Arithmetic of many lanes where what the compiler does by itself is too slow, or depends on what else is in a program.

Products. A compiler joins a product and a sum into one operation (FMA), which rounds once, if it finds both in one loop; what
is in one loop depends on the whole program, so that the last bit of a run would depend on which other observers are simulated
with it. Adding a zero that the compiler does not know makes every product round by itself, and costs nothing: what is joined
then is the product and the zero. Without `separate_products` a product is what it is. Small products of matrices are written
as products and sums, so that this holds for them too; also, the multiple-model filter takes a third of the time that it takes
with `dot_general` under vmap.

Sine and cosine. XLA calls a scalar function for each lane: 5 ns a sine on one core of a server processor, 1 ns as written here,
and 1.3 instead of 9.3 ns for sine and cosine of the same angle. Plants and observers keep `jnp.sin` and `jnp.cos`; the
interpreter puts these in their place. An angle x is n quarter turns and a rest r, |r| <= pi/4: r = x - n pi/2, with pi/2 in
three parts of 33 bits, so that n times each of the first two is exact (Cody and Waite). What rounding r leaves is t. On r, sine
and cosine are polynomials in r^2.

Accuracy: 1 unit in the last place for |x| up to 1e5, 2 up to 1.5e6; beyond, the error grows as 1e-16 |x|. Only an estimate that
has diverged has angles above 1e12: they are taken as 1e12.
Source: W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980; the coefficients of the polynomials are
those of fdlibm (Sun Microsystems, 1993), of least error on [-pi/4, pi/4].
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial, reduce
from typing import Any

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
LARGEST = 1e12  # rad
WRITTEN_OUT = 128  # products in one dot_general; above, vmap of the dot compiles faster and runs no slower


_ZERO: ContextVar[Array | None] = ContextVar("zero", default=None)


@contextmanager
def separate_products(number: Array) -> Iterator[None]:
    """Let every product round by itself where a program is traced; `number` is any finite one that it has as an argument."""
    token = _ZERO.set(0.0 * number)
    try:
        yield
    finally:
        _ZERO.reset(token)


def product(a: Array, b: Array) -> Array:
    """Return a b."""
    zero = _ZERO.get()
    return lax.mul(a, b) if zero is None or a.dtype != jnp.float64 else lax.mul(a, b) + zero


def is_written_out(eqn: Eqn) -> bool:
    """Return whether a dot_general is written as products and sums."""
    return jaxpr_compat.products(eqn) <= WRITTEN_OUT


def dot(a: Array, b: Array, dimension_numbers: Any) -> Array:
    """Return what `lax.dot_general` returns: [batch, rest of a, rest of b]."""
    (ca, cb), (ba, bb) = dimension_numbers
    free_a = [i for i in range(a.ndim) if i not in (*ba, *ca)]
    free_b = [i for i in range(b.ndim) if i not in (*bb, *cb)]
    a, b = lax.transpose(a, (*ca, *ba, *free_a)), lax.transpose(b, (*cb, *bb, *free_b))
    a = lax.expand_dims(a, range(a.ndim, a.ndim + len(free_b)))
    b = lax.expand_dims(b, range(len(cb) + len(bb), len(cb) + len(bb) + len(free_a)))
    shape = jnp.broadcast_shapes(a.shape, b.shape)
    terms = [(a[i], b[i]) for i in np.ndindex(shape[: len(ca)])]
    whole = [[jnp.broadcast_to(x, shape[len(ca) :]) for x in term] for term in terms]
    return reduce(lax.add, (product(*term) for term in whole))


def power(x: Array, exponent: int) -> Array:
    """Return a whole power above 0, by squaring."""
    half = power(x, exponent // 2) if exponent > 1 else None
    even = x if half is None else product(half, half)
    return even if exponent == 1 or exponent % 2 == 0 else product(even, x)


def sin(x: Array) -> Array:
    """Return the sine of angles [rad] in float64."""
    return _turned(x, 0.0)


def cos(x: Array) -> Array:
    """Return the cosine of angles [rad] in float64."""
    return _turned(x, 1.0)


def _turned(x: Array, quarters: float) -> Array:
    """The sine of an angle and some quarter turns more."""
    x = lax.clamp(-LARGEST, x, LARGEST)
    n = jnp.round(_times(1 / (PI_2[0] + PI_2[1]), x))
    ahead, small = x - _times(PI_2[0], n), _times(PI_2[1], n)
    r = ahead - small
    t = (ahead - r) - small - _times(PI_2[2], n)
    n = n + quarters
    quarter = n - _times(4.0, jnp.floor(_times(0.25, n)))  # 0 to 3; as a float, which every processor has vectors of
    is_odd = (quarter == 1.0) | (quarter == 3.0)
    size = jnp.where(is_odd, _cosine(r, t), _sine(r, t))
    return jnp.where(quarter >= 2.0, -size, size)


def _sine(r: Array, t: Array) -> Array:
    z = product(r, r)
    cube = product(z, r)
    high = product(cube, _polynomial(SINE[1:], z))
    return r - ((product(z, _times(0.5, t) - high) - t) - _times(SINE[0], cube))


def _cosine(r: Array, t: Array) -> Array:
    z = product(r, r)
    half = _times(0.5, z)
    near = 1.0 - half
    return near + (((1.0 - near) - half) + (product(product(z, z), _polynomial(COSINE, z)) - product(r, t)))


def _polynomial(coefficients: tuple[float, ...], z: Array) -> Array:
    """The polynomial with coefficients of rising order, by Horner's rule."""
    value = jnp.full_like(z, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = product(value, z) + c
    return value


def _times(number: float, x: Array) -> Array:
    return product(x, jnp.full_like(x, number))


KERNELS: dict[str, Callable[..., Array]] = {"mul": product, "sin": sin, "cos": cos}  # by the name of the primitive


def function_of(eqn: Eqn) -> Callable[..., Array]:
    """Return what applies a primitive to arrays of float64: a kernel of this module, or what jax has."""
    name, params = eqn.primitive.name, eqn.params
    if eqn.outvars[0].aval.dtype == jnp.float64:
        if name in KERNELS:
            return KERNELS[name]
        if name == "dot_general" and is_written_out(eqn):
            return partial(dot, dimension_numbers=params["dimension_numbers"])
        if name == "square" or (name == "integer_pow" and params["y"] > 0):
            return partial(power, exponent=params.get("y", 2))
    return partial(eqn.primitive.bind, **params)
