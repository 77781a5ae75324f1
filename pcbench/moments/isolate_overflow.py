"""Observers of a cell whose numbers overflow do not take the others with them.

In a joint covariance a zero stands between observers that share nothing, and zero times infinity is not a number. Where a call
leaves anything that is not finite, each observer is computed again by itself, and what it says of itself is what counts.
Covariances between two observers stay those of the joint call.
"""

from typing import Any

import jax
import numpy as np

from pcbench.moments.programs import compute
from pcbench.moments.realisations import Realised
from pcbench.moments.types import Found

ALONE = "observer"  # what an observer is called that goes by itself


def computed(ones: list[Realised], recorded: str, every: int = 1, width: int | None = None) -> Found:
    """Return what cells of one layout leave, [..., at least as many as there are], no observer spoilt by another."""
    found = compute(ones, recorded, every, width)
    layout = ones[0].layout
    spoilt = [
        at for at in range(len(ones)) if not all(np.isfinite(a[..., at]).all() for a in jax.tree.leaves(found.sums))
    ]
    if layout.controller or len(layout.observers) == 1 or not spoilt:
        return found
    found, first = jax.tree.map(np.array, found), 0
    for name in sorted(name for name, _ in layout.observers):
        own = compute([_of(ones[at], name) for at in spoilt], recorded, every)
        many = own.sums.mean.shape[0]
        for place, at in enumerate(spoilt):
            _put(found, at, slice(first, first + many), jax.tree.map(lambda a, i=place: a[..., i], own), name)
        first += many
    return found


def _of(one: Realised, name: str) -> Realised:
    """The same cell with one of its observers."""
    layout = one.layout._replace(observers=tuple((ALONE, o) for n, o in one.layout.observers if n == name))
    return one._replace(layout=layout, problem=one.problem._replace(gains={ALONE: one.problem.gains[name]}))


def _put(found: Found, at: int, mine: slice, own: Found, name: str) -> None:
    """Write what one observer left of cell `at` over what the joint call says of its signals `mine`."""
    for field in ("square", "absolute"):
        getattr(found.sums, field)[:, mine, at] = getattr(own.sums, field)
    for field in ("mean", "std", "reach", "apart", "size"):
        getattr(found.sums, field)[mine, at] = getattr(own.sums, field)
    if found.rows:
        found.rows.mean[:, mine, at] = own.rows.mean
        _block(found.rows.covariance, mine)[..., at] = own.rows.covariance
    if found.last:
        found.last.covariance[mine, mine, at] = own.last.covariance
        if name in found.last.believed:
            found.last.believed[name][..., at] = own.last.believed[ALONE]


def _block(covariance: Any, mine: slice) -> Any:
    """The part [N+1, z, z or 1, C] of recorded covariances that is between signals of one observer."""
    return covariance[:, mine] if covariance.shape[2] == 1 else covariance[:, mine, mine]
