"""Input sources as data, in addition to the names of `signals`: waves with an amplitude, and tables of held values."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

NEAR = 1e-9  # tolerance at an edge, relative to a cycle or to a table's first interval


class Wave(NamedTuple):
    """offset + amplitude times a shape of unit size over frequency t + phase / 2 pi cycles."""

    shape: str  # of SHAPES
    amplitude: float = 1.0  # in `unit`
    frequency: float = 0.0  # [Hz]; 0: not periodic
    offset: float = 0.0  # in `unit`
    phase: float = 0.0  # [rad]
    unit: str = ""


class Table(NamedTuple):
    """Values held from their times until the next; 0 before the first."""

    t: tuple[float, ...]  # [K] s, increasing
    u: tuple[tuple[float, ...], ...]  # [K, m]


Source = str | Wave | Table  # a name in `signals.SIGNALS`, or one of these
Sources = str | tuple[Source, ...]  # one for all inputs, or one for each; names with commas between
SHAPES: dict[
    str, Callable[[NDArray[np.float64]], NDArray[np.float64]]
] = {  # of cycles c [N]; the last three repeat with jumps
    "step": np.ones_like,
    "sine": lambda c: np.sin(2 * np.pi * c),
    "square": lambda c: np.where(np.mod(c + NEAR, 1.0) < 0.5, 1.0, -1.0),
    "sawtooth": lambda c: 1 - 2 * np.mod(c + NEAR, 1.0),
    "rising": lambda c: 2 * np.mod(c + NEAR, 1.0) - 1,
}
JUMPS_A_CYCLE = {"square": 2, "sawtooth": 1, "rising": 1}


def values(source: Wave | Table, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values of a source at times t [N] s: [N, 1], or [N, m] for a table."""
    if isinstance(source, Wave):
        shape = SHAPES[source.shape](source.frequency * t + source.phase / (2 * np.pi))
        return (source.offset + source.amplitude * shape)[:, None]
    times, u = np.array(source.t), np.array(source.u)
    tolerance = NEAR * (times[1] - times[0] if len(times) > 1 else 1.0)
    return np.vstack([np.zeros(u.shape[1]), u])[np.searchsorted(times - tolerance, t, side="right")]


def units(sources: Sources, n: int) -> list[str]:
    """Return the unit of each of `n` inputs; empty if no wave has one."""
    names = [""] if isinstance(sources, str) else [part.unit if isinstance(part, Wave) else "" for part in sources]
    return names if len(names) == n else names[:1] * n


def jumps(source: Wave | Table, dt: float, ticks: int) -> list[int]:
    """Return the first tick after every jump of a wave after t = 0, up to `ticks`; empty for a table."""
    if not isinstance(source, Wave) or source.shape not in JUMPS_A_CYCLE or not source.frequency:
        return []
    per_cycle = JUMPS_A_CYCLE[source.shape]
    start, end = source.phase / (2 * np.pi), source.frequency * dt * ticks + source.phase / (2 * np.pi)
    at = [
        (i / per_cycle - start) / source.frequency
        for i in range(math.floor(start * per_cycle) + 1, math.floor(end * per_cycle) + 1)
    ]
    return [math.ceil(t / dt - 1e-6) for t in at if t > 1e-6 * dt]
