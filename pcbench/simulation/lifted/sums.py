"""What the errors of a block of ticks leave in streams and watches: `metrics.update` and `metrics.look` of BLOCK ticks at once.

Errors e [BLOCK, n, L], or [BLOCK, n] where lanes have them in common; those beyond a chunk's end are 0.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from pcbench.simulation.lifted.chunks import BLOCK
from pcbench.simulation.metrics import Stream, Watch
from pcbench.simulation.problem import Problem

Sums = tuple[Stream, Any]  # arrays [n] or [n, L]; with a Watch, or ()


def score(p: Problem, k: Array, left: Array, e: Array, sums: Sums) -> Sums:
    """Take the errors of the ticks from k on into the sums; `first_bad` stays for `first_bad` below."""
    stream, watch = sums
    size = jnp.abs(e)
    stream = Stream(
        stream.absolute + _folded(jnp.add, list(size)),
        stream.square + _folded(jnp.add, list(e * e)),
        jnp.maximum(stream.peak, _folded(jnp.maximum, list(size))),
    )
    return stream, watch and _looked(p, k, size, watch)


def stays(p: Problem, sums: Sums) -> Array:
    """Say whether no lane can have left its bound for the first time: their peaks are of all ticks of a window up to now."""
    stream, watch = sums
    return jnp.all(jnp.all(stream.peak <= _limits(p.bound, stream.peak), 0) | (watch.first_bad >= 0))


def first_bad(p: Problem, k: Array, left: Array, e: Array, bad: Array) -> Array:
    """Return the first tick at which an error is not finite or beyond the bound, or -1, with the `left` ticks from k on."""
    bound = _limits(p.bound, e[0])
    for t in range(BLOCK):
        out = (t < left) & (bad < 0) & ~jnp.all(jnp.abs(e[t]) <= bound, 0)
        bad = jnp.where(out, (k + t).astype(float), bad)
    return bad


def _looked(p: Problem, k: Array, size: Array, watch: Watch) -> Watch:
    band, unsettled, recovery = _limits(p.band, size[0]), watch.unsettled, watch.recovery
    for t in range(BLOCK):
        outside = size[t] > band
        unsettled = jnp.where(outside, (k + t + 1).astype(float), unsettled)
        if p.jumps.shape[0]:
            since = jnp.min(jnp.where(p.jumps <= k + t, k + t - p.jumps, k + t))
            after = outside & jnp.any(p.jumps <= k + t)
            recovery = jnp.where(after, jnp.maximum(recovery, since + 1.0), recovery)
    return watch._replace(unsettled=unsettled, recovery=recovery)


def _limits(limits: Any, like: Array) -> Array:
    """A limit of each signal, [n] or [n, 1] for [n, L]."""
    return jnp.asarray(limits)[: like.shape[0]].reshape(-1, *(1 for _ in like.shape[1:]))


def _folded(way: Callable[[Array, Array], Array], parts: list[Array]) -> Array:
    """Fold arrays two by two."""
    while len(parts) > 1:
        parts = [way(*parts[i : i + 2]) for i in range(0, len(parts), 2)]
    return parts[0]
