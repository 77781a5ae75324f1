"""What a control law's numbers are made from."""

from typing import Any, NamedTuple

from pcbench.dynamics.linear import Model, one_tick
from pcbench.protocols import Delay


class ControllerContext(NamedTuple):
    """What the designer of a law knows of a cell. n states, m inputs, q outputs."""

    model: Model  # linear, as observers know it
    dt: float  # [s]
    ticks: int  # horizon N
    rows: int  # commands that the loop keeps from before tick 0
    ahead: int  # ticks past the horizon for which a set point may be asked
    late: int  # [ticks] mean delay from command to plant
    states: tuple[str, ...]  # [n] names
    delay: Delay  # from command to plant, of the time
    field: Any = None  # (now, x[n], unknowns) -> dx/dt, where observers are told a nonlinear model
    inverse: Any = None  # (unknowns, path, rates, accelerations) -> u[m], where the plant has one

    @property
    def tick(self) -> Any:
        """Return Phi [n, n] and Gamma [n, m] of one tick."""
        return one_tick(self.model, self.dt)

    def every(self, period: float | None) -> int:
        """Return a controller's period in ticks; None is one tick."""
        return 1 if period is None else round(period / self.dt)
