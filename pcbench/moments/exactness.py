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


def lack_of_digits(cell: CellMoments, label: str) -> str:
    """Return a clause about the state that leaves an observer's moments too few digits; empty if none does."""
    if not np.size(cell.final_state):
        return ""
    p, s, signals = cell.plan, cell.sums, cell.signals[label]
    size, deviation = np.asarray(cell.final_state).max(-1)
    n = min(len(size), signals.stop - signals.start)
    state = slice(signals.start, signals.start + n)
    size, deviation, band = size[:n], deviation[:n], np.asarray(p.problem.band)[:n]
    square = _steady_square(cell, state)
    with np.errstate(over="ignore", invalid="ignore"):
        not_affine = (relative_deviation(s, signals) > ROUNDING).any()
        rounding_in_runs = not_affine & (AMPLIFIED * EPS * size > ROUNDING * np.asarray(s.size)[state].max(-1))
        squares = EPS * deviation**2 > SQUARES * square
        lacks_digits = rounding_in_runs & (EPS * size > ROUNDING * TRIFLE * band)
        lacks_digits |= squares & (np.sqrt(EPS) * deviation > TRIFLE * band)
    if not lacks_digits.any():
        return ""
    i = int(np.argmax(np.where(lacks_digits, size, 0.0)))
    name, unit = signals_of(p.cell.scenario)[i]
    return (
        f"has too few digits for an exact answer: {name} reaches {amount(float(size[i]), unit)}, whose rounding in float64 is "
        "not small compared to the errors"
    )


def _steady_square(cell: CellMoments, signals: slice) -> Float[np.ndarray, " n"]:
    """Return the least mean square error of signals after the transient, over initial states."""
    times = cell.plan.cell.times
    return np.asarray(cell.sums.square)[1, signals].min(-1) / (times.ticks - times.tail)


INSTEAD = 'use runs for it: pcbench.run, or evaluation = "runs"'


def refusal(cell: CellMoments, label: str, instead: str = INSTEAD) -> str:
    """Return a sentence why an observer's moments are not exact at a grid point, and what to do; empty if they are."""
    p, s = cell.plan, cell.sums
    signals, where = cell.signals[label], f"{p.cell.scenario.name}, cell {p.cell.number}: {label}"
    names = [name for name, _ in signals_of(p.cell.scenario)]
    if cell.refusal:
        return f"{where} {cell.refusal}; {instead}."
    if reason := lack_of_digits(cell, label):
        return f"{where} {reason}; shorten the duration, or {instead}."
    ratio = relative_deviation(s, signals, cell.final_state)
    worst = int(np.argmax(ratio))
    not_affine = ratio[worst] > ROUNDING
    # one observer: in a closed loop each has its own draft
    draft_cell = p.cell._replace(options={label: p.cell.options[label]})
    response = response_size(fit(list(drafts([draft_cell])))[0], label) if p.layout.controller else None
    if response is not None:
        n, deviation = len(response), np.asarray(s.deviation)[signals].max(-1)
        square = _steady_square(cell, slice(signals.start, signals.start + n))
        rounding = (ratio[:n] > ROUNDING) & (deviation[:n] <= AMPLIFIED * EPS * response)
        size = np.sqrt(EPS) * response
        rounding |= (EPS * response**2 > SQUARES * square) & (size > TRIFLE * np.asarray(p.problem.band)[:n])
        if rounding.any():
            return (
                f"{where} {describe_response(p, response, rounding)}, which leaves too few digits for an exact answer; "
                f"shorten the duration, use kf or ekf, or {instead}."
            )
    reach = s.reach[signals].max(-1)
    finite = np.isfinite(reach).all() or np.isfinite(s.size[signals]).all()  # of the runs, if linear maps overflow
    if not_affine and (np.isfinite(ratio[worst]) or finite):
        part = f"{ratio[worst]:.1g} of its size" if np.isfinite(ratio[worst]) else "more than a number can hold"
        return (
            f"{where} is not affine in the noise: {names[worst]} is off by {part} where an affine observer is off by less than "
            f"{ROUNDING:.0e}; {instead}."
        )
    bound = np.asarray(p.problem.bound)[: len(reach)]
    beyond = ~(reach <= bound)
    if beyond.any():
        i = int(np.argmax(beyond))
        extent = f"reaches {reach[i]:.3g}" if np.isfinite(reach[i]) else "grows beyond what a number can hold"
        return (
            f"{where} may leave its bound: {names[i]} {extent} within six standard deviations, expected at most "
            f"{bound[i]:.3g}, beyond which a run counts as diverged; {instead}."
        )
    return ""
