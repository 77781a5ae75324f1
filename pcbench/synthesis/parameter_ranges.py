"""Maps of a model from sample to sample over ranges of sampling intervals and of model parameters.

A certificate over a range is checked at every whole tick, which are all intervals that can occur, and at VALUES values of
each parameter. A matrix inequality that is affine in the map also holds between these values, if the map there is in the
convex hull of the checked ones (a polytope).
Not claimed: any property for a plant whose parameters differ from the observer's; the difference acts on the error.
"""

import itertools
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError
from pcbench.synthesis.certificate import DesignContext

SOLVER_MAPS = 17  # maps that a solver uses; the check of the certificate uses all
VALUES = 33  # of a parameter
MAX_MAPS = 50_000  # maps in all


def _require_increasing(bounds: list[float]) -> list[float]:
    if len(bounds) != 2 or not bounds[0] < bounds[1]:
        raise ValueError("a range: [lowest, highest]")
    return bounds


Range = Annotated[list[float], AfterValidator(_require_increasing)]


class Maps(NamedTuple):
    """Maps of a model over k intervals and parameter values; n states."""

    Phi: Matrix  # [k, n, n]
    Q: Matrix  # [k, n, n] covariance that process noise adds
    seconds: Matrix  # [k]
    corners: NDArray[np.int64]  # [c] indices of the maps for a solver

    @property
    def at_corners(self) -> "Maps":
        """Return the maps of the corners."""
        k = self.corners
        return Maps(self.Phi[k], self.Q[k], self.seconds[k], np.arange(len(k)))


def maps(
    context: DesignContext, periods: list[float] | None, parameters: dict[str, list[float]] | None, q: float, where: str
) -> Maps:
    """Return the maps over every whole tick of `periods` (lowest, highest [s]; None: the intervals of the schedule).

    `parameters` are the lowest and highest value of each parameter; None: nominal values. `q` is the assumed intensity of
    process noise through the input, per second. Raises UserError for a range without a tick, or a parameter that the plant
    does not have.
    """
    ticks = list(context.intervals or sorted(set(context.period)))
    if periods is not None:
        ticks = _ticks(periods, context, where)
    grid = {name: np.linspace(low, high, VALUES) for name, (low, high) in (parameters or {}).items()}
    count = len(ticks) * VALUES ** len(grid)
    if count > MAX_MAPS:
        raise UserError(
            f"{where}: got ranges of {len(ticks)} intervals and {len(grid)} parameters, which are {count} maps to check, "
            f"expected {MAX_MAPS} at most; narrow the periods or leave a parameter out."
        )
    parts = [
        _maps_at(context, dict(zip(grid, point, strict=True)), ticks, q) for point in itertools.product(*grid.values())
    ]
    Phi, Q = (np.concatenate([part[i] for part in parts]) for i in range(2))
    seconds = np.tile(np.array(ticks) * context.dt, len(parts))
    return Maps(Phi, Q, seconds, _corners(len(ticks), len(grid)))


def _ticks(periods: list[float], context: DesignContext, where: str) -> list[int]:
    low, high = (edge / context.dt for edge in periods)
    if high - low > MAX_MAPS:
        raise UserError(
            f"{where}: got a period_range of {periods} s, which are {high - low:.3g} ticks of {context.dt:g} s, expected "
            f"{MAX_MAPS} at most; write seconds, or a narrower range."
        )
    ticks = list(range(max(int(np.ceil(low - 1e-9)), 1), int(high + 1e-9) + 1))
    if not ticks:
        raise UserError(
            f"{where}: got a period_range of {periods} s, expected one with a multiple of the tick of {context.dt:g} s in it."
        )
    return ticks


def _maps_at(context: DesignContext, parameters: dict[str, float], ticks: list[int], q: float) -> tuple[Matrix, Matrix]:
    """Return the maps and process noise covariances of one model, [ticks, n, n]."""
    model = context.variant(parameters) if parameters else context.model
    tick = linear.input_noise(model, q, context.dt) + context.process_noise
    binary_maps = linear.doublings(model, context.dt, linear.bits_for(max(ticks)))
    noise = linear.noise_doublings(model, tick, context.dt, len(binary_maps))
    Phi = np.stack([linear.over(binary_maps, t) for t in ticks])
    return Phi, np.stack([linear.noise_over(binary_maps, noise, t) for t in ticks])


def _corners(intervals: int, parameters: int) -> NDArray[np.int64]:
    """Return the indices of some intervals, with the first and the last, at lowest, middle and highest parameter values."""
    axes = [np.array([0, VALUES // 2, VALUES - 1])] * parameters
    count = max(SOLVER_MAPS // 3**parameters, 3)
    indices = np.unique(np.linspace(0, intervals - 1, min(count, intervals)).round().astype(int))
    shape = (*[VALUES] * parameters, intervals)
    grids = np.meshgrid(*axes, indices, indexing="ij")
    return np.ravel_multi_index(tuple(g.ravel() for g in grids), shape)
