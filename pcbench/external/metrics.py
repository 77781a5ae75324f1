"""The metrics of runs whose estimates are given, as the simulation keeps them: sums over the same windows, the same watches."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.planning import digits
from pcbench.planning.padding import Plan
from pcbench.simulation import metrics
from pcbench.simulation.metrics import ErrorSums, SettlingState

Floats = NDArray[np.float64]


def scored(p: Plan, x: Floats, xhat: Floats) -> dict[str, Any]:
    """Return every metric of runs by name, [s, runs]: x [runs, N+1, n + s] and xhat [runs, N, s] at ticks 0 .. N-1."""
    n, tail, dt = p.cell.times.ticks, p.cell.times.tail, p.cell.scenario.dt
    many = xhat.shape[-1]
    e = np.moveaxis(x[:, :n, :many] - xhat, (0, 1, 2), (2, 0, 1))  # [N, s, runs]
    with np.errstate(invalid="ignore", over="ignore"):
        streams = [_stream(e[a:b]) for a, b in np.asarray(p.problem.windows)]
        watch = _watch(e, p)
    whole: Any = ErrorSums._make(np.stack(each) for each in zip(*streams, strict=True))
    digits.require_of(p, x[:, n - 1].T, whole.absolute[1:].sum(0) / (n - tail))
    falls = bool((p.problem.jumps < n).any())
    return metrics.read(whole, watch, e[-1], n, tail, dt, falls)  # type: ignore[arg-type]


def _stream(e: Floats) -> ErrorSums:
    size = np.abs(e)
    return ErrorSums(size.sum(0), (e * e).sum(0), size.max(0, initial=0.0))  # type: ignore[arg-type]


def _watch(e: Floats, p: Plan) -> SettlingState:
    after: Any
    many, ticks = e.shape[1], np.arange(len(e))[:, None, None]
    size, band, bound = np.abs(e), *(np.asarray(a)[:many, None] for a in (p.problem.band, p.problem.bound))
    outside = size > band  # [N, s, runs]
    bad: Any = np.logical_not((size <= bound).all(1))  # [N, runs]
    unsettled = np.where(outside, ticks + 1, 0).max(0)
    first = np.where(bad.any(0), bad.argmax(0), -1)
    jumps = np.asarray(p.problem.jumps)
    recovery = np.zeros(e.shape[1:])
    if len(jumps):
        gone = np.where(jumps <= ticks[:, 0], ticks[:, 0] - jumps, np.iinfo(int).max)
        since, after = gone.min(1), (jumps <= ticks[:, 0]).any(1)
        recovery = np.where(outside & after[:, None, None], since[:, None, None] + 1.0, 0.0).max(0)
    return SettlingState(unsettled.astype(float), recovery, first.astype(float))  # type: ignore[arg-type]
