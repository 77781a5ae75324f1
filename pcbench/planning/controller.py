"""What closes a loop: the controller with its numbers, and the actuator line with room for what a schedule can ask for."""

from typing import Any, NamedTuple

import numpy as np
from jax.tree_util import Partial
from pydantic import BaseModel

from pcbench import controllers
from pcbench.plants import entry_of, numbers_of
from pcbench.protocols import Controller
from pcbench.simulation import actuator
from pcbench.simulation.schedule import shared
from pcbench.study import times
from pcbench.study.cells import Cell


class Reach(NamedTuple):
    """Ticks that a loop looks back and ahead."""

    back: int  # commands it keeps
    ahead: int


def options(cell: Cell) -> BaseModel:
    """Return the options of a closed loop's controller: the scenario's, with the study's choices over them."""
    s, chosen = cell.scenario, {k: v for k, v in cell.choices.loop().items() if v is not None}
    return controllers.entry_of(s).options.model_validate(dict(s.loop.control) | chosen)


def controller(cell: Cell) -> Controller | None:
    """Return the control law of a cell; None of an open loop."""
    s = cell.scenario
    return controllers.entry_of(s).controller(options(cell)) if s.loop.controller else None


def reach(cell: Cell, overtaking: int, ticks: int) -> Reach:
    """Return the ticks of commands to keep behind and beyond.

    `back`: so that inputs since the oldest sample that may still be used again can be read, the actuator's delay included.
    `ahead`: past the end, until the last command acts.
    """
    s, delay = cell.scenario, times.actuator_delay(cell.scenario)
    believed_older = max(cell.times.error, 0)
    oldest = shared.oldest(shared.samples(cell.times.clocks, ticks), overtaking) + believed_older
    longest = float(np.max(delay(np.arange(ticks + 1) * s.dt)))
    return Reach(actuator.rows_needed(delay, s.dt, ticks, oldest + 1), times.whole(longest, s) + 2)


def close(cell: Cell, reach: Reach, ticks: int) -> tuple[Any, actuator.Line]:
    """Return the numbers of the control law and of the line, from `reach.back` ticks before 0 to `reach.ahead` past the end."""
    s, plant = cell.scenario, entry_of(cell.scenario)
    delay, params = times.actuator_delay(s), plant.prepare(numbers_of(s), s.dt, ticks)
    model, inverse = Partial(plant.model, params), Partial(plant.inverse, params)
    law = controllers.entry_of(s).prepare(options(cell), delay, s.dt, reach.back, ticks, model, inverse)
    return law, actuator.line(delay, s.dt, reach.back, ticks + reach.ahead)
