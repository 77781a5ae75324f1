"""Entries that are known before a program runs: zeros and ones of Jacobians, identity matrices and padding.

`jax.jacfwd` multiplies each derivative by the entries of an identity matrix, and F P F' has the zeros of F. The compiler cannot
leave such products out, because 0 x is not 0 for every x (and because `kernels.product` adds a zero that it cannot see). Here
they are left out: 0 x = 0, 1 x = x and 0 + x = x. Results are the same, except the sign of a zero, and values computed from
infinities or NaN, which only diverged runs have. A zero that is written in the code, as in 0.0 * x, stays a factor.

The known entries of a value are an array of its shape for one lane, NaN where an entry is not known; None: no entry is known.
Only whole numbers are known, so that they are exact in every type.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from pcbench.engine import batching_rules, jaxpr_compat
from pcbench.engine.batching_rules import Known
from pcbench.engine.jaxpr_compat import STRUCTURAL, Eqn, Literal

MOST_ENTRIES = 1024  # larger values are not examined
LARGEST = 2**31 - 1  # larger whole numbers are not known


def of_constant(x: Any) -> Known:
    """Return the known entries of a constant or a literal."""
    if jaxpr_compat.is_traced(x) or np.size(x) > MOST_ENTRIES or np.asarray(x).dtype.kind not in "fiub":
        return None
    return _exact(np.asarray(x, float), np.asarray(x).dtype)


def of_results(eqn: Eqn, known: list[Known]) -> list[Known]:
    """Return the known entries of an equation's results from those of its arguments."""
    name = eqn.primitive.name
    unknown: list[Known] = [None] * len(eqn.outvars)
    if max(v.aval.size for v in (*eqn.invars, *eqn.outvars)) > MOST_ENTRIES:
        return unknown
    if name == "iota":
        return [np.indices(eqn.outvars[0].aval.shape, float)[jaxpr_compat.param(eqn, "dimension")]]
    if all(k is None for k in known):
        return unknown
    entries = [batching_rules.known_array(k, v.aval.shape) for k, v in zip(known, eqn.invars, strict=True)]
    if name in STRUCTURAL:
        flat, shapes = np.concatenate([k.ravel() for k in entries]), tuple(k.shape for k in entries)
        sources = batching_rules.source_indices(eqn.primitive, jaxpr_compat.parameter_items(eqn), shapes)
        return [_exact(flat[i.astype(int)], v.aval.dtype) for i, v in zip(sources, eqn.outvars, strict=True)]
    if name == "dot_general":
        return [_exact(_dot(eqn, *entries), eqn.outvars[0].aval.dtype)]
    is_written_zero = (isinstance(v, Literal) and not jaxpr_compat.value(v).any() for v in eqn.invars)
    if name not in RULES or (name in ("mul", "div") and any(is_written_zero)):
        return unknown  # so that 0.0 * x is NaN if x is
    aval = eqn.outvars[0].aval
    return [_exact(np.broadcast_to(RULES[name](*entries), aval.shape), aval.dtype)]


def product_count(eqn: Eqn, known: list[Known]) -> int:
    """Return the number of products of a dot_general that are not known to be zero."""
    nonzero = [
        (batching_rules.known_array(k, v.aval.shape) != 0).astype(float) for k, v in zip(known, eqn.invars, strict=True)
    ]
    return int(_dot(eqn, *nonzero).sum())


def _exact(known: np.ndarray, dtype: Any) -> Known:
    """Return the entries that are whole numbers, and in the range of the type."""
    low, high = -LARGEST, LARGEST
    if dtype.kind != "f":
        limits = (0, 1) if dtype.kind == "b" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
        low, high = max(low, limits[0]), min(high, limits[1])
    is_exact = (known == np.round(known)) & (known >= low) & (known <= high)
    return np.where(is_exact, known, np.nan) if is_exact.any() else None


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where((a == 0) | (b == 0), 0.0, a * b)


def _quotient(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where((a == 0) & (b != 0), 0.0, np.nan)


def _choice(which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    is_same = np.all([case == cases[0] for case in cases], axis=0)
    return np.select([which == i for i in range(len(cases))], list(cases), np.where(is_same, cases[0], np.nan))


def _equal(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(a + b), np.nan, a == b)


def _dot(eqn: Eqn, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (contract_a, contract_b), (batch_a, batch_b) = jaxpr_compat.dot_axes(eqn.params)
    left, right = batching_rules.as_matrices(a, batch_a, contract_a), batching_rules.as_matrices(b, batch_b, contract_b)
    return _product(left[:, :, None], right[:, None]).sum(-1).reshape(eqn.outvars[0].aval.shape)


RULES: dict[str, Callable[..., np.ndarray]] = {
    "mul": _product,
    "div": _quotient,
    "add": np.add,
    "add_any": np.add,
    "sub": np.subtract,
    "neg": np.negative,
    "eq": _equal,
    "select_n": _choice,
    "convert_element_type": np.asarray,
    "copy": np.asarray,
}
