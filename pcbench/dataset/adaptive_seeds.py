"""Seeds until a standard error is reached: the cells that need more, and how many.

The number of seeds depends only on the existing runs, so the same command gives the same seeds again. A stopping rule
that uses the data makes intervals slightly too narrow. From 256 seeds on, their coverage is within the tested band of
all other intervals.
"""

from collections.abc import Callable, Iterator
from math import ceil, inf, isfinite, nan
from typing import NamedTuple

from pcbench import statistics
from pcbench.dataset import aggregate, block_files, storage
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.run_missing import SeedsOf
from pcbench.dataset.seed_ranges import Seeds, seed_range
from pcbench.errors import UserError, unknown
from pcbench.plants import signals_of

MARGIN = 1.05  # the standard error is an estimate itself
GROWTH = 16  # largest factor of the number of seeds from round to round
BUDGET = 100  # times the study's seeds, if --max-seeds is not given
METRICS = (*statistics.RUN_METRICS, *statistics.POOLED, "divergence_rate", "unsettled_rate")


class Goal(NamedTuple):
    """The standard error to reach."""

    metric: str
    signal: str | None  # of this signal; None: of those that each scenario's closing table shows
    value: float
    max_seeds: int | None  # per cell


def parse(text: str | None, max_seeds: int | None) -> Goal | None:
    """Return the goal METRIC=VALUE or METRIC.SIGNAL=VALUE; raise UserError for any other form."""
    if text is None:
        if max_seeds is not None:
            raise UserError(f"--max-seeds: got {max_seeds} without --until-se, expected both; leave --max-seeds out.")
        return None
    name, equals, number = text.partition("=")
    metric, _, signal = name.strip().partition(".")
    try:
        value = float(number)
    except ValueError:
        value = -1.0
    if not equals or not (isfinite(value) and value > 0):
        raise UserError(
            f"--until-se: got {text!r}, expected METRIC=VALUE with a standard error above 0; write mae=0.001."
        )
    if metric not in METRICS:
        raise unknown("--until-se", "metric", metric, METRICS)
    if max_seeds is not None and max_seeds < 1:
        raise UserError(f"--max-seeds: got {max_seeds}, expected a number of seeds, 1 or more; leave it out.")
    return Goal(metric, signal or None, value, max_seeds)


def check(goal: Goal | None, claim: StudyClaim) -> None:
    """Raise UserError if no scenario has the signal of the goal."""
    names = {name for c in claim.cells for name, _ in signals_of(c.scenario)}
    if goal is not None and goal.signal is not None and goal.signal not in names:
        raise unknown("--until-se", "signal", goal.signal, names)


def rounds(
    goal: Goal | None, target: storage.Target, claim: StudyClaim, on_warning: Callable[[str], None]
) -> Iterator[SeedsOf]:
    """Yield the next number of seeds of each cell, until all reach the goal or the budget is spent.

    Each round uses only the seeds that the previous one requested, and no other existing seeds. A resumed run therefore
    requests the same seeds as an uninterrupted one.
    """
    if goal is None:
        return
    first, seeds, n_short = claim.study.first_seed, claim.study.seeds, 0
    max_seeds, size = goal.max_seeds or BUDGET * seeds, {cell.key: seeds for cell in claim.cells}
    cells = list(claim.cells)
    while cells:
        blocks = block_files.series(block_files.drop_overlaps(block_files.present(target)))
        for cell in list(cells):
            n = size[cell.key]
            c = aggregate.of_cell(target, cell, blocks)
            error = _error(goal, c, claim.study.name, Seeds(0, first + n))
            size[cell.key] = max(n, min(seeds_for(n, error, goal.value), max_seeds))
            if size[cell.key] == n:
                cells.remove(cell)
                n_short += error > goal.value
        if cells:
            yield lambda cell: seed_range(first, size[cell.key])
    if n_short:
        on_warning(
            f"--until-se: {n_short} of {len(claim.cells)} cells stopped at {max_seeds} seeds, short of the goal; raise "
            "--max-seeds."
        )


def _error(goal: Goal, c: aggregate.CellBlocks, study: str, within: Seeds) -> float:
    """Return the largest standard error of any observer over some seeds; inf for a single run.

    The standard error of a fraction is that of Wilson's interval, which is above 0 even without an event.
    """
    scenario = c.cell.scenario
    signals = [goal.signal] if goal.signal else scenario.scoring.headline or (signals_of(scenario)[0][0],)
    stats = aggregate.rows_of(study, c, within)[0].select(["signal", "metric", "n", "se", "ci_low", "ci_high"])
    rows = [r for r in stats.to_pylist() if r["metric"] == goal.metric and r["signal"] in signals]
    if not rows:
        raise UserError(
            f"--until-se: got {goal.metric} of {', '.join(signals)}, which {scenario.name} does not have, expected a "
            "metric that every scenario of the study has; use another one."
        )
    errors = [inf if r["n"] == 1 else nan if r["se"] is None else r["se"] for r in rows if r["n"]]
    if goal.metric in ("divergence_rate", "unsettled_rate"):
        errors = [inf if r["n"] == 1 else (r["ci_high"] - r["ci_low"]) / (2 * statistics.Z95) for r in rows if r["n"]]
    return max(errors, default=0.0)


def seeds_for(n: int, error: float, goal: float) -> int:
    """Return the seeds that a standard error from `n` seeds needs to decrease to its goal; it is inverse to their root."""
    if error <= goal:
        return n
    return ceil(n * min(MARGIN * (error / goal) ** 2, GROWTH))
