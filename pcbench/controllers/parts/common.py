"""Options of all control laws and their types, the inputs of a law's design, and checks that options fit a plant."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jax import Array
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pcbench.controllers.parts.set_points import Number, Positive, SetPoints
from pcbench.dynamics.linear import Matrix, Model, one_tick
from pcbench.errors import UserError, brief_repr, unknown
from pcbench.protocols import Delay

Rows = list[list[Number]]
Weight = Number | list[Number] | Rows  # one number for all, a diagonal, or a matrix
COST = "weight of the metric `lq_cost`; default: no such metric"


class Options(BaseModel):
    """Options of all laws."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    period: Positive | None = Field(
        None, description="period of the controller, which holds its command in between [s]; default: one tick"
    )
    limit: Positive | list[Positive] | None = Field(
        None, description="largest command, one number or one per input; default: unlimited"
    )
    offset: Number | list[Number] = Field(0.0, description="[m] input of the operating point, added to every command")
    set_point: SetPoints = Field(
        {}, description="set point by state: a number, or a table with `step`, `sine` or `table`; default: 0"
    )
    Q1: Weight | None = Field(None, description=COST)
    Q2: Weight | None = Field(None, description=COST)


class ControllerContext(NamedTuple):
    """What the design of a control law may use at a grid point."""

    model: Model  # nominal linear model
    dt: float  # duration of a tick [s]
    ticks: int  # number of ticks of a run
    rows: int  # number of commands before tick 0 that the loop stores
    lookahead: int  # number of ticks after the run for which a set point may be needed
    late: int  # mean delay from command to plant [ticks]
    states: tuple[str, ...]  # names of the states
    delay: Delay  # delay from command to plant as a function of time [s]
    # (now, x, unknowns) -> dx/dt, if the nominal model is not linear
    field: Callable[..., Array] | None = None
    # (unknowns, path, rates, accelerations) -> u, if the plant has an inverse
    inverse: Callable[..., Array] | None = None

    @property
    def tick(self) -> tuple[Matrix, Matrix]:
        """Return Phi [n, n] and Gamma [n, m] of one tick."""
        return one_tick(self.model, self.dt)

    def period_ticks(self, period: float | None) -> int:
        """Return a controller's period in ticks; None is one tick."""
        return 1 if period is None else round(period / self.dt)


class Sizes(NamedTuple):
    """Names of a plant's states, numbers of inputs and outputs, and the place that error messages name."""

    states: tuple[str, ...]
    m: int
    q: int
    dt: float  # [s]
    where: str

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.states)


def matrix(rows: Any, shape: tuple[int, int], name: str, sizes: Sizes) -> NDArray[np.float64]:
    """Return rows of numbers as a matrix; a number or a flat list is the diagonal of a square one."""
    if not isinstance(rows, list):
        rows = [rows] * shape[0]
    flat = not any(isinstance(row, list) for row in rows)
    if flat and shape[0] == shape[1] == len(rows):
        return np.diag(np.asarray(rows, float))
    lengths = [len(row) if isinstance(row, list) else 1 for row in rows]
    if flat or len(rows) != shape[0] or set(lengths) != {shape[1]}:
        got = (
            f"a flat list of {len(rows)}"
            if flat
            else f"{len(rows)} rows of {', '.join(map(str, sorted(set(lengths))))}"
        )
        more = ", or the numbers of its diagonal" if shape[0] == shape[1] else ""
        raise UserError(
            f"{sizes.where}.{name}: got {got}, expected {shape[0]} x {shape[1]} ({sizes.n} states, {sizes.m} inputs, "
            f"{sizes.q} outputs) as a list of rows{more}."
        )
    return np.asarray(rows, float)


def weight(rows: Weight, n: int, name: str, sizes: Sizes, definite: bool = False) -> NDArray[np.float64]:
    """Return a symmetric weight [n, n] that is positive semidefinite, or `definite`."""
    Q = matrix(rows, (n, n), name, sizes)
    least, kind = np.linalg.eigvalsh((Q + Q.T) / 2)[0], "positive definite" if definite else "positive semidefinite"
    if not np.allclose(Q, Q.T, rtol=1e-9, atol=0) or (least <= 0 if definite else least < -1e-12 * abs(Q).max()):
        raise UserError(
            f"{sizes.where}.{name}: got {brief_repr(rows)}, whose least eigenvalue is {least:.3g}, expected a "
            f"symmetric, {kind} "
            "matrix; write larger numbers on its diagonal."
        )
    return Q


def vector(value: float | list[float] | None, default: float, n: int, name: str, sizes: Sizes) -> NDArray[np.float64]:
    """Return an array [n]: one number for all inputs, or one for each."""
    values = [default if value is None else value] * n if not isinstance(value, list) else value
    if len(values) != n:
        raise UserError(
            f"{sizes.where}.{name}: got {len(values)} numbers, expected one, or one for each of {n} inputs."
        )
    return np.asarray(values, float)


def require_common(options: Options, sizes: Sizes, definite: bool = False) -> None:
    """Raise UserError unless period, limit, offset, set points and cost weights fit the plant."""
    if options.period is not None:
        ticks = options.period / sizes.dt
        if abs(ticks - round(ticks)) > 1e-6 or round(ticks) < 1:
            raise UserError(
                f"{sizes.where}.period: got {options.period:g} s, expected a whole number of ticks of {sizes.dt:g} s; write "
                f"{max(round(ticks), 1) * sizes.dt:.12g}."
            )
    vector(options.limit, np.inf, sizes.m, "limit", sizes)
    vector(options.offset, 0.0, sizes.m, "offset", sizes)
    for name in options.set_point:
        if name not in sizes.states:
            raise unknown(f"{sizes.where}.set_point", "state", name, sizes.states)
    if (options.Q1 is None) != (options.Q2 is None):
        present, missing = ("Q1", "Q2") if options.Q2 is None else ("Q2", "Q1")
        raise UserError(f"{sizes.where}: got {present} without {missing}, expected both, or neither, without a cost.")
    if options.Q1 is not None and options.Q2 is not None:
        weight(options.Q1, sizes.n, "Q1", sizes)
        weight(options.Q2, sizes.m, "Q2", sizes, definite)
