"""What an option of an observer says of itself besides its type and bounds.

Numbers that an observer draws itself: Threefry-2x32 in counter form, from two words that are a run's own.

A draw has the address (words, kind, tick, number), and nothing else: what is filtered again draws the same, and a run has the
same draws alone or among thousands. Normal numbers come by the inverse error function, from 52 of 64 bits, as a run's own do.
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

TUNABLE, WAY = "tunable", "way"  # keys in a field's extra


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


def way(default: Any, **how: Any) -> Any:
    """Return a field of an option that says in which way gains are found: what `pcbench design --gain` sets."""
    return Field(default, json_schema_extra={WAY: True}, **how)


def extra(field: FieldInfo) -> dict[str, Any]:
    """Return what an option says of itself besides its type."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def matrix(given: float | list[list[float]], shape: tuple[int, int], where: str, what: str) -> Matrix:
    """Return a gain that was given as a matrix; raise UserError where it is of another shape than `shape`, of `what`."""
    try:
        found = np.full((1, 1), given) if isinstance(given, float) else np.array(given, float)
    except ValueError:
        found = np.zeros(0)
    if found.shape != shape:
        raise UserError(f"{where}: got {given}, expected a matrix of shape {list(shape)}: {what}.")
    return found


TURNS = ((13, 15, 26, 6), (17, 29, 16, 24))
PARITY = 0x1BD11BDA


def threefry(key: tuple[Array, Array], counter: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return two words for each of two words, under a key of two, all uint32."""
    keys = (*key, key[0] ^ key[1] ^ jnp.uint32(PARITY))
    a, b = counter[0] + keys[0], counter[1] + keys[1]
    for block in range(5):
        for turn in TURNS[block % 2]:
            a = a + b
            b = ((b << jnp.uint32(turn)) | (b >> jnp.uint32(32 - turn))) ^ a
        a, b = a + keys[(block + 1) % 3], b + keys[(block + 2) % 3] + jnp.uint32(block + 1)
    return a, b


def uniforms(words: UInt32[Array, "2"], kind: Array | int, tick: Array, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Draw numbers in [0, 1) of a kind for a tick."""
    key, zero = (words[0], words[1]), jnp.uint32(0)
    for number in (kind, tick):
        key = threefry(key, (zero, jnp.asarray(number).astype(jnp.uint32)))
    many = math.prod(shape)
    high, low = threefry(key, (jnp.zeros(many, jnp.uint32), jnp.arange(many, dtype=jnp.uint32)))
    whole = (high.astype(jnp.uint64) << jnp.uint64(32)) | low.astype(jnp.uint64)
    return ((whole >> jnp.uint64(12)).astype(float) * 2.0**-52).reshape(shape)


def normals(words: UInt32[Array, "2"], kind: Array | int, tick: Array, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Draw numbers N(0, 1) of a kind for a tick."""
    least = float(np.nextafter(-1.0, 0.0))
    return math.sqrt(2.0) * erfinv(uniforms(words, kind, tick, shape) * (1.0 - least) + least)
