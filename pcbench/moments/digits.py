"""Whether exact moments keep their digits: they are of the state and of memories, which may be far larger than the errors.

Two things need digits. The trial of `exactness` compares runs to ROUNDING of the errors' size, and a state x is rounded by EPS
|x|: where the trial fails, that may be why. And noise adds to the covariance of the state and of the estimates, from which the
errors' is a difference of large squares: it keeps about EPS Var x / E e^2. What the start adds goes by itself, and loses no
square (`program`).
"""

import numpy as np

from pcbench.moments.error_sums import AMPLIFIED, strayed
from pcbench.moments.plant_affinity import ROUNDING
from pcbench.moments.solve import CellMoments
from pcbench.planning.digits import EPS, amount
from pcbench.plants import signals_of

SQUARES = 1e-6  # of E e^2
TRIFLE = 1e-4  # of the settling band: what is less is 0 for every purpose


def lost(cell: CellMoments, label: str) -> str:
    """Return which state leaves an observer's moments too few digits, the middle of a sentence; empty where none does."""
    if not np.size(cell.reached):
        return ""
    p, s, mine = cell.planned, cell.sums, cell.signals[label]
    size, deviation = np.asarray(cell.reached).max(-1)
    n = min(len(size), mine.stop - mine.start)
    state = slice(mine.start, mine.start + n)
    size, deviation, band = size[:n], deviation[:n], np.asarray(p.problem.band)[:n]
    square = np.asarray(s.square)[1, state].min(-1) / (p.cell.times.ticks - p.cell.times.tail)
    with np.errstate(over="ignore", invalid="ignore"):
        failed = (strayed(s, mine) > ROUNDING).any()
        trial = failed & (AMPLIFIED * EPS * size > ROUNDING * np.asarray(s.size)[state].max(-1))
        squares = EPS * deviation**2 > SQUARES * square
        bad = (trial & (EPS * size > ROUNDING * TRIFLE * band)) | (squares & (np.sqrt(EPS) * deviation > TRIFLE * band))
    if not bad.any():
        return ""
    i = int(np.argmax(np.where(bad, size, 0.0)))
    name, unit = signals_of(p.cell.scenario)[i]
    return (
        f"has too few digits for an exact answer: {name} reaches {amount(float(size[i]), unit)}, whose rounding in float64 is "
        "not small beside the errors"
    )
