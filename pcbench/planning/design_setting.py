"""What a designer is told of a cell: the model, the times, the noise."""

from functools import partial

import numpy as np
from jax.tree_util import Partial

from pcbench.dynamics import linear
from pcbench.errors import unknown
from pcbench.plants import PLANTS, numbers_of, parameters_of
from pcbench.scenarios import Scenario
from pcbench.simulation.schedule import per_lane, sampling, shared
from pcbench.study.cells import Cell
from pcbench.synthesis.certificate import Setting


def setting(cell: Cell) -> Setting:
    """Return what a designer is told: the nominal model and the believed delay, whatever is true of the plant."""
    s, clocks, n = cell.scenario, cell.times.clocks, cell.times.ticks
    period, delay = [0] * len(s.delay), [0] * len(s.delay)
    plant, many = PLANTS[s.plant], len(s.unknown_std)
    params = plant.prepare(numbers_of(s), s.dt, n) if plant.model else None
    for clock in clocks:
        for j in clock.channels:
            if isinstance(clock.profile, tuple):
                period[j] = round(sum(clock.profile) / len(clock.profile))
            else:
                period[j] = clock.period
            late = period[j] if clock.delay is None else clock.delay
            delay[j] = late + clock.spread // 2 + cell.times.error
    return Setting(
        s.name,
        plant.nominal(numbers_of(s)),
        s.dt,
        n,
        tuple(period),
        tuple(delay),
        tuple(std or spare for std, spare in zip(s.noise_std, s.assumed_noise_std or s.noise_std, strict=True)),
        np.diag(np.square(s.prior_std)),
        s.drift_intensity if s.drift else 0.0,
        _overtaking(clocks, n),
        s.process_std or s.assumed_process_std,
        cell.times.error,
        max(-(-late // every) for late, every in zip(delay, period, strict=True)),
        s.unknown_std,
        s.unknown0 or (0.0,) * many,
        plant.ranges or ((-np.inf, np.inf),) * many,
        Partial(plant.model, params) if plant.model else None,
        Partial(plant.parts, params) if plant.parts else None,
        partial(_variant, s),
        tuple(sampling.intervals(clocks[0], n)) if len(clocks) == 1 else (),
    )


def _variant(s: Scenario, parameters: dict[str, float]) -> linear.Model:
    """The model that observers would be told with other parameters."""
    for name in parameters:
        if name not in parameters_of(s.plant):
            raise unknown(f"{s.name}: parameter_range", f"parameter of plant {s.plant}", name, parameters_of(s.plant))
    return PLANTS[s.plant].nominal(numbers_of(s)._replace(**parameters))


def _overtaking(clocks: list[sampling.Clock], ticks: int) -> int:
    """How many newer samples may arrive before one; of one clock with samples of one age, none."""
    if sampling.any_random(clocks):
        return per_lane.overtaking(clocks, ticks)
    alone = len(clocks) == 1 and clocks[0].delay is not None and not any(clocks[0].swing)
    return 0 if alone else shared.overtaking(shared.samples(clocks, ticks))
