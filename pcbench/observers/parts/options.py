"""Fields of observers' options, and random numbers for observers that draw them.

The random numbers are Threefry-2x32 in counter form, from two words per run. The address of a number is (words, kind, tick,
index) and nothing else. So a sample that is filtered again has the same numbers, and a run has the same numbers alone and in
a batch. Normal numbers use the inverse error function on 52 of 64 bits, as the simulation does.
Source: Salmon, Moraes, Dror, Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import erfinv
from jaxtyping import Float, UInt32
from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError

TUNABLE, METHOD = "tunable", "way"  # keys in a field's extra


class StrictOptions(BaseModel):
    """Options of an observer: no other keys, finite numbers, no conversion of types."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


def tunable(default: Any, between: tuple[float, float] | None = None, **how: Any) -> Any:
    """Declare a field of an observer's options that `tune` may change. Gains must depend on it smoothly.

    Args:
        default: its default.
        between: least and greatest value. With gt=0 or ge=0 instead, it stays positive.
        **how: further arguments of pydantic's `Field`, such as ge, gt and description.

    Returns:
        The field.
    """
    return Field(default, json_schema_extra={TUNABLE: list(between or ())}, **how)


def method_option(default: Any, **how: Any) -> Any:
    """Return a field for the design method of the gains, which `pcbench design --gain` sets."""
    return Field(default, json_schema_extra={METHOD: True}, **how)


def option_metadata(field: FieldInfo) -> dict[str, Any]:
    """Return the metadata of an option."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def matrix(value: float | list[list[float]], shape: tuple[int, int], where: str, dimensions: str) -> Matrix:
    """Return a gain as a matrix; raise UserError unless it has the shape `shape`, described by `dimensions`."""
    try:
        entries = np.full((1, 1), value) if isinstance(value, float) else np.array(value, float)
    except ValueError:
        entries = np.zeros(0)
    if entries.shape != shape:
        raise UserError(f"{where}: got {value}, expected a matrix of shape {list(shape)}: {dimensions}.")
    return entries


ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
PARITY = 0x1BD11BDA


def threefry(key: tuple[Array, Array], counter: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return two uint32 words for each counter of two words, under a key of two words."""
    keys = (*key, key[0] ^ key[1] ^ jnp.uint32(PARITY))
    a, b = counter[0] + keys[0], counter[1] + keys[1]
    for block in range(5):
        for rotation in ROTATIONS[block % 2]:
            a = a + b
            b = ((b << jnp.uint32(rotation)) | (b >> jnp.uint32(32 - rotation))) ^ a
        a, b = a + keys[(block + 1) % 3], b + keys[(block + 2) % 3] + jnp.uint32(block + 1)
    return a, b


def uniforms(words: UInt32[Array, "2"], kind: Array | int, tick: Array, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Return uniform numbers in [0, 1) of a kind for a tick."""
    key, zero = (words[0], words[1]), jnp.uint32(0)
    for number in (kind, tick):
        key = threefry(key, (zero, jnp.asarray(number).astype(jnp.uint32)))
    count = math.prod(shape)
    high, low = threefry(key, (jnp.zeros(count, jnp.uint32), jnp.arange(count, dtype=jnp.uint32)))
    bits = (high.astype(jnp.uint64) << jnp.uint64(32)) | low.astype(jnp.uint64)
    return ((bits >> jnp.uint64(12)).astype(float) * 2.0**-52).reshape(shape)


def normals(words: UInt32[Array, "2"], kind: Array | int, tick: Array, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Return standard normal numbers of a kind for a tick."""
    least = float(np.nextafter(-1.0, 0.0))
    return math.sqrt(2.0) * erfinv(uniforms(words, kind, tick, shape) * (1.0 - least) + least)
