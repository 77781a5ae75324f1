"""Exact results as pandas frames: expected values of a study's metrics, and moments of errors over time."""

from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pcbench.dataset import columns
from pcbench.dataset.aggregate import resolvable_bound
from pcbench.errors import UserError, unknown
from pcbench.moments import exactness, stats_rows
from pcbench.moments.propagate import COVARIANCE
from pcbench.moments.solve import CellMoments, MomentRequest, plan_cells, solve
from pcbench.plants import signals_of
from pcbench.runtime import config
from pcbench.study.grid import Cell, Grid
from pcbench.synthesis.certificate import is_certified

OVER_TIME = ("observer", "signal", "t", "mean", "std")
METRICS = np.array(stats_rows.ORDER, object)
Values = NDArray[np.floating]


class Joint(NamedTuple):
    """Mean and joint covariance of all errors of one cell, at ticks 0 .. N; Z errors."""

    t: Values  # [N+1] s
    errors: tuple[tuple[str, str], ...]  # (observer, signal)
    mean: Values  # [N+1, Z]
    covariance: Values  # [N+1, Z, Z]


class Exact:
    """The exact results of a study: expected values over infinitely many seeds."""

    def __init__(self, grid: Grid, schedules: int):
        self.grid, self.schedules = grid, schedules

    @cached_property
    def stats(self) -> pd.DataFrame:
        """One row per grid point, observer, signal and metric, like `stats` of a result.

        `method` shows whether a row is exact, and `reason` explains why not. `mean` is the expected value, and `se` is 0. If
        each run has its own schedule, `mean` is over the first `schedules` of them, `n` is their number, and `se` is the
        standard error over schedules.
        """
        return pd.DataFrame(columns.concat_columns(self.all_rows(self.grid.cells)))

    def moments(self, scenario: str | None = None, cell: int | None = None) -> pd.DataFrame:
        """Return mean and standard deviation of the errors at ticks 0 .. N, of all grid points or of one.

        If each run has its own schedule, they are over noise and schedules. Observers without exact results are missing.
        """
        frames = []
        for m in self.solve_cells(self._select(scenario, cell), "std"):
            for part in self.over_time(m):
                head, n = columns.keys(self.grid.study.name, m.plan.cell), len(part["t"])
                frames.append(pd.DataFrame({name: [value] * n for name, value in head.items()} | part))
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()

    def over_time(self, m: CellMoments, points: int = 0) -> Iterator[dict[str, NDArray[np.generic]]]:
        """Yield the moments of a grid point by column, for each observer and signal with exact results."""
        cell = m.plan.cell
        names = [name for name, _ in signals_of(cell.scenario)]
        ticks = np.arange(0, cell.times.ticks + 1, MomentRequest(0, 0, points=points).interval(cell.times.ticks))
        for label, errors in m.signals.items():
            if m.why[label] or not m.rows:
                continue
            means, variances = np.asarray(m.rows.mean[:, errors]), np.asarray(m.rows.covariance[:, errors, 0])
            mean, variance = means[..., 0], variances[..., 0]
            if m.random:
                mean, variance = means.mean(-1), variances.mean(-1) + means.var(-1)
            std = np.sqrt(np.maximum(variance, 0.0))
            for i in range(errors.stop - errors.start):
                labels = (np.full(len(ticks), word, object) for word in (label, names[i]))
                yield dict(zip(OVER_TIME, (*labels, cell.scenario.dt * ticks, mean[:, i], std[:, i]), strict=True))

    def covariance(self, scenario: str | None = None, cell: int | None = None) -> Joint:
        """Return the joint covariance of all errors of one grid point, where all observers get the same noise.

        Raises UserError if an observer has no exact results, or if several observers close a loop.
        """
        cells = self._select(scenario, cell)
        if len(cells) > 1:
            raise UserError(f"covariance: got {len(cells)} cells, expected one; give scenario and cell.")
        m, *more = self.solve_cells(cells, COVARIANCE)
        if more:
            raise UserError(
                f"covariance: got {len(cells[0].options)} observers in a closed loop, expected one: each drives a plant of "
                "its own; name one with observers=[...]."
            )
        if not m.rows or any(m.why.values()):
            # an overflow of one observer spoils the numbers of the others here, but not if each is solved by itself
            reasons = (reason for c in self.solve_cells(cells) for reason in c.why.values())
            raise UserError(f"covariance: {next(filter(None, (*reasons, *m.why.values())))}")
        names = [name for name, _ in signals_of(cells[0].scenario)]
        errors = tuple((o, names[i]) for o, z in m.signals.items() for i in range(z.stop - z.start))
        order = [i for z in m.signals.values() for i in range(z.start, z.stop)]
        mean: Values = np.asarray(m.rows.mean[:, order])
        deviation = mean - mean.mean(-1, keepdims=True)
        between = np.einsum("tis,tjs->tij", deviation, deviation) / deviation.shape[-1]
        total = m.rows.covariance[:, order][:, :, order].mean(-1) + between
        return Joint(cells[0].scenario.dt * np.arange(len(mean)), errors, mean.mean(-1), total)

    def solve_cells(self, cells: list[Cell], quantity: str = "", points: int = 0) -> Iterator[CellMoments]:
        """Yield the moments of cells; if there are many, for one observer at a time."""
        with config.float64():
            request = MomentRequest(self.grid.study.root_seed, self.schedules, quantity, points)
            for m in solve(plan_cells(cells, quantity == COVARIANCE), request):
                yield m._replace(why={label: exactness.refusal(m, label) for label in m.signals})

    def all_rows(self, cells: list[Cell]) -> Iterator[dict[str, object]]:
        """Yield the rows of all cells."""
        for m in self.solve_cells(cells):
            yield from self.rows(m)

    def rows(self, m: CellMoments) -> Iterator[dict[str, object]]:
        """Yield the rows of `stats` of each observer as columns, in their order, for `columns.concat_columns`."""
        cell, p = m.plan.cell, m.plan
        signals, head = signals_of(cell.scenario), columns.keys(self.grid.study.name, cell)
        bound = resolvable_bound(None if p.bound is None else p.bound.tolist(), cell.scenario.belief.prior_std)
        names, units = _names_and_units(tuple(signals))
        order = _order(tuple(head))
        for label in m.signals:
            rows = stats_rows.stats_columns(m, label, m.why[label], bound)
            about = head | {
                "plant": cell.scenario.plant,
                "observer": label,
                "predicts_unknown_input": p.predicts_unknown_input[label],
                "certified": is_certified(p.certificates[label]._asdict()),
            }
            signal, metric = rows["signal"], rows["metric"]
            rows |= about | {"signal": names[signal], "metric": METRICS[metric], "unit": units[signal, metric]}
            yield {name: rows[name] for name in order}

    def _select(self, scenario: str | None, cell: int | None) -> list[Cell]:
        scenarios = list(dict.fromkeys(c.scenario.name for c in self.grid.cells))
        if scenario is not None and scenario not in scenarios:
            raise unknown("exact", "scenario of the study", scenario, scenarios)
        cells = [c for c in self.grid.cells if scenario in (None, c.scenario.name) and cell in (None, c.number)]
        if not cells:
            raise UserError(f"exact: got cell {cell}, expected one of 0 to {len(self.grid.cells) - 1}.")
        return cells


@lru_cache(256)
def _order(head: tuple[str, ...]) -> list[str]:
    return columns.stats_order(columns.axes_of(head))


@lru_cache(256)
def _names_and_units(signals: tuple[tuple[str, str], ...]) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """The names of signals [K], and the units of their metrics [K, METRICS]."""
    units = [[columns.unit_of(metric, unit) for metric in stats_rows.ORDER] for _, unit in signals]
    return np.array([name for name, _ in signals], object), np.array(units, object)
