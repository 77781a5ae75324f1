"""The setup of a closed loop: controller parameters, actuator or network, and room for the delays of a schedule."""

from typing import NamedTuple

import jax
import numpy as np
from jax.tree_util import Partial
from pydantic import BaseModel

from pcbench import controllers
from pcbench.controllers import ControllerContext
from pcbench.controllers.parts.common import Options, matrix
from pcbench.controllers.parts.set_points import reference
from pcbench.errors import UserError, describe_exception
from pcbench.plants import entry_of, numbers_of
from pcbench.protocols import Controller, Params
from pcbench.simulation import command_network, controller_shape_checks, metrics
from pcbench.simulation.schedule import common_times, random_times
from pcbench.study import controller_table, times
from pcbench.study.grid import Cell


class Reach(NamedTuple):
    """How many ticks a closed loop needs before and after a run."""

    back: int  # stored commands
    lookahead: int


def options(cell: Cell) -> BaseModel:
    """Return the options of a closed loop's controller: the scenario's, overridden by the study's."""
    s, choices = cell.scenario, {k: v for k, v in cell.choices.loop().items() if v is not None}
    return controllers.entry_of(s).options.model_validate(dict(s.loop.control) | choices)


def controller(cell: Cell) -> Controller | None:
    """Return the controller of a grid point; None for an open loop."""
    s = cell.scenario
    return controllers.law_of(controllers.entry_of(s), options(cell)) if s.loop.controller else None


def reach(cell: Cell, oosm_lag: int, ticks: int) -> Reach:
    """Return the ticks of commands to store.

    - `back`: enough to read all inputs since the oldest sample that may still be used, including the actuator's delay.
    - `lookahead`: past the end, until the last command acts.
    """
    s, delay = cell.scenario, times.actuator_delay(cell.scenario)
    age = oldest(cell, oosm_lag, ticks)
    max_delay = float(np.max(delay(np.arange(ticks + 1) * s.dt)))
    back = command_network.rows_needed(delay, s.dt, ticks, age + 1)
    return Reach(back, times.to_ticks(max_delay, s) + 2 + times.to_ticks(s.loop.command_jitter, s))


def oldest(cell: Cell, oosm_lag: int, ticks: int) -> int:
    """Return the largest age [ticks] of an input that an observer may read, as old as the oldest usable sample."""
    if cell.scenario.sampling.sensors_decide:  # the last sample sent may have any age
        age = ticks
    elif cell.times.random:
        age = min(random_times.max_input_age(cell.times.clocks, ticks, oosm_lag), ticks)
    else:
        age = common_times.max_input_age(common_times.samples_of(cell.times.clocks, ticks), oosm_lag)
    return age + max(cell.times.error, 0) + cell.times.clocks[0].stamp.max_errors(ticks)[0]


def make_controller_context(cell: Cell, reach: Reach, ticks: int) -> ControllerContext:
    """Return the design context of a controller at a grid point, with room for `reach`."""
    s, plant = cell.scenario, entry_of(cell.scenario)
    params = plant.prepare(numbers_of(s), s.dt, ticks)
    return controller_table.controller_context(s)._replace(
        ticks=ticks,
        rows=reach.back,
        lookahead=reach.lookahead,
        field=Partial(plant.model, params) if plant.model else None,
        inverse=Partial(plant.inverse, params) if plant.inverse else None,
    )


def close(cell: Cell, reach: Reach, ticks: int) -> tuple[Params, command_network.DelayLine]:
    """Return the parameters of controller and actuator line, from `reach.back` ticks before 0 to `lookahead` past the end.

    Raises UserError if a user-defined controller violates the protocol.
    """
    s, context = cell.scenario, make_controller_context(cell, reach, ticks)
    entry, name = controllers.entry_of(s), s.loop.controller
    if "controller" not in s.user_code:
        control = entry.prepare(options(cell), context)
    else:
        try:
            control = entry.prepare(options(cell), context)
            arrays = jax.tree.map(np.asarray, control)
        except UserError:
            raise
        except Exception as error:
            raise UserError(
                f"controller {name}: prepare: got {describe_exception(error)}, expected a pytree of arrays; correct that line."
            ) from error
        (n, m), signals = context.model.B.shape, len(s.scoring.settle_band)
        sizes = controller_shape_checks.Sizes(n, signals - n, m)
        controller_shape_checks.check(name, controllers.law_of(entry, options(cell)), arrays, sizes)
    if controller_table.has_generic_controller(s):
        return control, command_network.constant_delay_line(context.late, reach.back, ticks + reach.lookahead)
    return control, command_network.delay_line(context.delay, s.dt, reach.back, ticks + reach.lookahead)


def max_pending(cell: Cell) -> int:
    """Return the number of commands that the network to the plant can hold; 0 for an actuator delay common to all runs."""
    numbers = network(cell)
    return command_network.room(int(numbers.period_ticks), int(numbers.delay), int(numbers.jitter)) if numbers else 0


def network(cell: Cell) -> command_network.NetworkParams | tuple[()]:
    """Return the parameters of the network to the plant; () if there is no network."""
    s, loop = cell.scenario, cell.scenario.loop
    if not (loop.command_jitter or loop.command_loss or loop.command_std):
        return ()
    context = controller_table.controller_context(s)
    return command_network.NetworkParams(
        period_ticks=np.asarray(context.period_ticks(getattr(options(cell), "period", None))),
        delay=np.asarray(times.to_ticks(loop.actuator_delay or 0.0, s)),
        jitter=np.asarray(times.to_ticks(loop.command_jitter, s)),
        loss=np.asarray(loop.command_loss),
        std=np.full(context.model.B.shape[1], loop.command_std),
    )


def weights(cell: Cell) -> metrics.Weights | tuple[()]:
    """Return the weights of the cost; () for an open loop, or if no table shows the cost."""
    s = cell.scenario
    if not controller_table.has_generic_controller(s):
        return ()
    law_options, context = options(cell), controller_table.controller_context(s)
    n, m = context.model.B.shape
    no_refs = np.zeros((0, n)), np.zeros((0, m))
    Q1, Q2 = getattr(law_options, "Q1", None), getattr(law_options, "Q2", None)
    if Q1 is None:
        return metrics.Weights(np.zeros((0, 0)), np.zeros((0, 0)), *no_refs)
    points = law_options.set_point if isinstance(law_options, Options) else {}
    refs = reference(points, context.states, context.tick, context.dt, cell.times.ticks + 1) if points else no_refs
    sizes = controller_table.sizes(s, "controller")
    return metrics.Weights(matrix(Q1, (n, n), "Q1", sizes), matrix(Q2, (m, m), "Q2", sizes), *refs)
