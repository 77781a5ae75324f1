"""What a program of exact moments is made for, carries from tick to tick, and leaves."""

from typing import Any, NamedTuple

from jax import Array

from pcbench.moments.error_sums import Sums
from pcbench.moments.events import Moving
from pcbench.moments.noise_state import Form
from pcbench.moments.tick_matrix import Tick

COVARIANCE = "covariance"


class Shape(NamedTuple):
    """What is compiled in besides the layout."""

    cells: int
    form: Form
    own: tuple[bool, ...]  # which arrays of the problem are each cell's own
    recorded: str = ""  # nothing, "std" or COVARIANCE over time
    every: int = 1  # ticks apart
    written: bool = False  # whether functions of a state are written out entry by entry


class Recorded(NamedTuple):
    """Moments at T ticks, 0 and every so many after it; Z signals of all observers, one after another."""

    mean: Array  # [T, Z, C]
    covariance: Array  # [T, Z, Z, C], or of each signal [T, Z, 1, C]


class Found(NamedTuple):
    """What a batch leaves."""

    sums: Sums
    rows: Any  # Recorded; (): nothing is recorded
    last: Any = ()  # Last, of a layout with consistency
    unlike: Any = ()  # [C] of modes, as in `events.Moving`
    reached: Any = ()  # [2, n, C] of the state in the end: its size in the runs, its deviation without that of the start


class Carried(NamedTuple):
    """From tick to tick."""

    moving: Moving
    tick: Tick
    sums: Sums
    rows: Any
    last: Any = ()
