"""Test whether the moments of an observer at a grid point are exact, for built-in and user-defined observers alike.

Affine in the noise
    A run with eight times the noise must agree with the run without noise plus the linear maps of its ticks and events, to
    rounding at every tick. This is stronger than e(v) + e(-v) = 2 e(0), which a sign function satisfies too. A run that may
    exceed the divergence threshold counts as diverged and enters no average, so the moments of all runs would not describe it.

Digits
    State and memories may be far larger than the errors. This matters twice. The test above compares runs to ROUNDING of
    the errors' size, while a state x is rounded by EPS |x|. And the covariance of the errors is a difference of large squares,
    with a relative rounding error of about EPS Var x / E e^2. The effect of the initial state is propagated separately and is
    not squared (`programs`). In a closed loop the same holds for an observer that stores the response to the input.
"""

import numpy as np
from jaxtyping import Float

from pcbench.moments.affinity import ROUNDING
from pcbench.moments.error_sums import AMPLIFIED, relative_deviation
from pcbench.moments.solve import CellMoments
from pcbench.planning import drafts
from pcbench.planning.digits import EPS, amount, describe_response, response_size
from pcbench.planning.padding import fit
from pcbench.plants import signals_of

SQUARES = 1e-6  # relative to E e^2
TRIFLE = 1e-4  # relative to the settling band: a smaller error counts as 0


def lost(cell: CellMoments, label: str) -> str:
    """Return a clause about the state that leaves an observer's moments too few digits; empty if none does."""
    if not np.size(cell.reached):
        return ""
    p, s, mine = cell.planned, cell.sums, cell.signals[label]
    size, deviation = np.asarray(cell.reached).max(-1)
    n = min(len(size), mine.stop - mine.start)
    state = slice(mine.start, mine.start + n)
    size, deviation, band = size[:n], deviation[:n], np.asarray(p.problem.band)[:n]
    square = _steady_square(cell, state)
    with np.errstate(over="ignore", invalid="ignore"):
        failed = (relative_deviation(s, mine) > ROUNDING).any()
        trial = failed & (AMPLIFIED * EPS * size > ROUNDING * np.asarray(s.size)[state].max(-1))
        squares = EPS * deviation**2 > SQUARES * square
        bad = (trial & (EPS * size > ROUNDING * TRIFLE * band)) | (squares & (np.sqrt(EPS) * deviation > TRIFLE * band))
    if not bad.any():
        return ""
    i = int(np.argmax(np.where(bad, size, 0.0)))
    name, unit = signals_of(p.cell.scenario)[i]
    return (
        f"has too few digits for an exact answer: {name} reaches {amount(float(size[i]), unit)}, whose rounding in float64 is "
        "not small compared to the errors"
    )


def _steady_square(cell: CellMoments, signals: slice) -> Float[np.ndarray, " n"]:
    """Return the least mean square error of signals after the transient, over initial states."""
    times = cell.planned.cell.times
    return np.asarray(cell.sums.square)[1, signals].min(-1) / (times.ticks - times.tail)


INSTEAD = 'take runs for it: pcbench.run, or evaluation = "runs"'


def refusal(cell: CellMoments, label: str, instead: str = INSTEAD) -> str:
    """Return a sentence why an observer's moments are not exact at a grid point, and what to do; empty if they are."""
    p, s = cell.planned, cell.sums
    mine, where = cell.signals[label], f"{p.cell.scenario.name}, cell {p.cell.number}: {label}"
    names = [name for name, _ in signals_of(p.cell.scenario)]
    if cell.refused:
        return f"{where} {cell.refused}; {instead}."
    if said := lost(cell, label):
        return f"{where} {said}; shorten the horizon, or {instead}."
    part = relative_deviation(s, mine, cell.reached)
    worst = int(np.argmax(part))
    failed = part[worst] > ROUNDING
    alone = p.cell._replace(
        options={label: p.cell.options[label]}
    )  # one observer: in a closed loop each has its own draft
    kept = response_size(fit(list(drafts([alone])))[0], label) if p.layout.controller else None
    if kept is not None:
        n, apart = len(kept), np.asarray(s.apart)[mine].max(-1)
        square = _steady_square(cell, slice(mine.start, mine.start + n))
        rounding = (part[:n] > ROUNDING) & (apart[:n] <= AMPLIFIED * EPS * kept)
        rounding |= (EPS * kept**2 > SQUARES * square) & (np.sqrt(EPS) * kept > TRIFLE * np.asarray(p.problem.band)[:n])
        if rounding.any():
            return (
                f"{where} {describe_response(p, kept, rounding)}, which leaves too few digits for an exact answer; shorten the "
                f"horizon, take kf or ekf, or {instead}."
            )
    reach = s.reach[mine].max(-1)
    bounded = np.isfinite(reach).all() or np.isfinite(s.size[mine]).all()  # of the runs, if linear maps overflow
    if failed and (np.isfinite(part[worst]) or bounded):
        off = f"{part[worst]:.1g} of its size" if np.isfinite(part[worst]) else "more than a number can hold"
        return (
            f"{where} is not affine in the noise: {names[worst]} is off by {off} where an affine observer is off by less than "
            f"{ROUNDING:.0e}; {instead}."
        )
    bound = np.asarray(p.problem.bound)[: len(reach)]
    beyond = ~(reach <= bound)
    if beyond.any():
        i = int(np.argmax(beyond))
        far = f"reaches {reach[i]:.3g}" if np.isfinite(reach[i]) else "grows beyond what a number can hold"
        return (
            f"{where} may leave its bound: {names[i]} {far} within six standard deviations, expected at most "
            f"{bound[i]:.3g}, beyond which a run counts as diverged; {instead}."
        )
    return ""
