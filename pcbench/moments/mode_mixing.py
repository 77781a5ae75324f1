"""From the moments of a cell in each of its modes to those of the cell: expectations over modes, by how often each is there."""

from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from pcbench.moments.error_sums import Sums
from pcbench.moments.types import Found, Recorded

LARGEST = ("reach", "apart", "size")  # of the mode where it is largest


def combined(found: Found, shares: NDArray[np.float64]) -> Found:
    """Return what M modes [..., M] leave together, [..., 1]; what observers believe stays one a mode.

    A sum over ticks is the mean of the modes' sums, as each is there as often at every tick; a variance has that of the means
    between modes besides.
    """
    s: Sums = jax.tree.map(lambda a: _mean(a, shares), found.sums)
    s = s._replace(**{name: getattr(found.sums, name).max(-1, keepdims=True) for name in LARGEST})
    apart = found.sums.mean - s.mean
    s = s._replace(std=np.sqrt(_mean(np.square(found.sums.std) + np.square(apart), shares)))
    return found._replace(sums=s, rows=_rows(found.rows, shares) if found.rows else ())


def _rows(rows: Recorded, shares: NDArray[np.float64]) -> Recorded:
    mean = _mean(rows.mean, shares)
    apart = rows.mean - mean
    wide = rows.covariance.shape[2] > 1
    between = apart[:, :, None] * apart[:, None] if wide else np.square(apart)[:, :, None]
    return Recorded(mean, _mean(rows.covariance + between, shares))


def _mean(a: Any, shares: NDArray[np.float64]) -> Any:
    return (a @ shares)[..., None]
