"""What one study may ask of a machine: more is refused at once, not after hours or when memory runs out.

A run has at most TICKS ticks and SAMPLES samples of a channel, of which at most IN_FLIGHT are on their way at a time and at
most OVERTAKING newer ones arrive before one. A study has at most CELLS cells in a scenario, of
CELL_TICKS ticks in all, and at most LABELS labels of observers
and SCENARIOS scenarios.
"""

from collections.abc import Collection

from pcbench.errors import UserError
from pcbench.simulation.schedule import random_times, sampling
from pcbench.simulation.schedule.sampling import Clock

TICKS = 1_000_000
SAMPLES = 100_000
IN_FLIGHT = 10_000
OVERTAKING = 1_000
LABELS = 1_000
SCENARIOS = 500
CELLS = 10_000
CELL_TICKS = 100_000_000  # each takes at least 50 bytes before anything runs


def ticks_of(horizon: float, tick: float, where: str) -> int:
    """Return a horizon [s] in ticks [s]; raise UserError where that is less than two or more than TICKS."""
    many = horizon / tick
    if many > TICKS + 0.5:
        raise UserError(
            f"{where}: got a duration of {horizon:g} s at a tick of {tick:g} s, expected at most {TICKS:,} ticks; take a "
            "shorter horizon or a longer tick."
        )
    if round(many) < 2:
        raise UserError(
            f"{where}: got a duration of {horizon:g} s at a tick of {tick:g} s, expected at least two ticks; take a longer "
            "horizon or a shorter tick."
        )
    return round(many)


def require_few_samples(clocks: list[Clock], ticks: int, dt: float, where: str) -> None:
    """Raise UserError where samples are too many for a run, on their way at a time, or out of order; `dt` [s] is the tick."""
    for clock in clocks:
        least = sampling.intervals(clock, ticks)[0]
        if ticks // least > SAMPLES:
            raise UserError(
                f"{where}: got a sample every {least * dt:g} s over {ticks * dt:g} s, expected at most {SAMPLES:,} samples of "
                f"a channel; write a sampling_period of at least {-(-ticks // SAMPLES) * dt:g}."
            )
        longest = sampling.ages(clock, ticks)[1]
        if longest // least > IN_FLIGHT:
            raise UserError(
                f"{where}: got samples up to {longest * dt:g} s late and only {least * dt:g} s apart, expected at most "
                f"{IN_FLIGHT:,} of a channel on their way at a time; shorten the delay or sample less often."
            )
    most = random_times.overtaking(clocks, ticks)
    if most > OVERTAKING:
        raise UserError(
            f"{where}: got samples that up to {most:,} newer ones may overtake, expected at most {OVERTAKING:,}; take a "
            "smaller delay_jitter, delays that differ less, or sample less often."
        )


def require_few_labels(labels: Collection[str], where: str) -> None:
    """Raise UserError where a study names too many observers, with their options, at a time."""
    if len(labels) > LABELS:
        raise UserError(
            f"{where}: got {len(labels):,} observers and options of observers, expected at most {LABELS:,}; divide the study."
        )


def require_few_scenarios(many: int, where: str) -> None:
    """Raise UserError where a study has too many scenarios at a time."""
    if many > SCENARIOS:
        raise UserError(f"{where}: got {many:,} scenarios, expected at most {SCENARIOS:,}; divide the study.")


def require_few_cells(cells: int, ticks: int, where: str) -> None:
    """Raise UserError where the axes of a study make too many cells of so many ticks each."""
    most = min(CELLS, CELL_TICKS // ticks)
    if cells > most:
        raise UserError(
            f"{where}: axes: got {cells:,} cells of {ticks:,} ticks, expected at most {most:,}; leave values out, or divide "
            "the study."
        )
