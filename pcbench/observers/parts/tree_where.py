"""A memory where something holds, another where it does not."""

from typing import Any

import jax
import jax.numpy as jnp


def kept(which: Any, after: Any, before: Any) -> Any:
    """Return the memory after an event where any of `which` holds, else the one before."""
    there = jnp.any(which)
    return jax.tree.map(lambda a, b: jnp.where(there, a, b), after, before)
