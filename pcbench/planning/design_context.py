"""The design context of a grid point: the assumed model, times and noise from which gains are designed."""

from functools import partial

import jax
import numpy as np
from jax.tree_util import Partial

from pcbench.dynamics import linear
from pcbench.errors import unknown
from pcbench.planning import memo
from pcbench.plants import PlantSpec, entry_of, numbers_of, parameters_in, replace_numbers
from pcbench.protocols import Params
from pcbench.scenarios import Scenario
from pcbench.simulation.schedule import common_times, random_times, sampling
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import DesignContext
from pcbench.value_cache import key_of


def prepare_params(plant: PlantSpec, numbers: Params, dt: float, ticks: int, cache: memo.Cache) -> Params:
    """Return a plant's parameters, prepared for a number of ticks."""
    try:
        key = plant.prepare, key_of(numbers), dt, ticks
    except TypeError:
        return plant.prepare(numbers, dt, ticks)

    def make() -> Params:  # device arrays are copied to the host once instead of per grid point
        to_host = lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf  # noqa: E731
        return jax.tree.map(to_host, plant.prepare(numbers, dt, ticks))

    return cache("params", key, make)


def context_of(cell: Cell, cache: memo.Cache = memo.no_cache) -> DesignContext:
    """Return the design context: the nominal model and the assumed delay and noise, independent of the true plant."""
    s, clocks, n = cell.scenario, cell.times.clocks, cell.times.ticks
    belief, noise = s.belief, s.sampling.noise_std
    period, delay = [0] * len(noise), [0] * len(noise)
    plant, n_unknowns = entry_of(s), len(belief.unknown_std)
    functions = (plant.model, plant.successor, plant.sensor, plant.parts, plant.output_residual)
    params = prepare_params(plant, numbers_of(s), s.dt, n, cache) if any(functions) else None
    field, successor, sensor, parts, residual = (Partial(f, params) if f else None for f in functions)
    for clock in clocks:
        pattern = clock.profile if isinstance(clock.profile, tuple) else (clock.period,)
        for j in clock.channels:
            period[j] = round(sum(pattern) / len(pattern))
            delay[j] = (period[j] if clock.delay is None else clock.delay) + clock.mean_extra_delay + cell.times.error

    def oosm_lag() -> int:
        """Return the largest number of newer samples that arrive before an older one; 0 for one clock with a constant delay."""
        if sampling.any_random(clocks):
            return random_times.max_oosm_lag(clocks, n)
        is_regular = (
            len(clocks) == 1
            and clocks[0].delay is not None
            and not any(clocks[0].delay_sine)
            and not clocks[0].delay_sequence
        )
        return 0 if is_regular else common_times.max_oosm_lag(common_times.samples_of(clocks, n))

    def intervals() -> tuple[int, ...]:
        return tuple(sampling.intervals(clocks[0], n))

    defaults = belief.assumed_noise_std or noise
    latest = max(sampling.ages(clock, n)[1] for clock in clocks) + clocks[0].stamp.max_errors(n)[0]
    return DesignContext(
        scenario=s.name,
        model=plant.nominal(numbers_of(s)),
        dt=s.dt,
        ticks=n,
        period=tuple(period),
        delay=tuple(delay),
        noise_std=tuple(belief.assumed_noise_scale * (a or b) for a, b in zip(noise, defaults, strict=True)),
        noise_correlation=s.sampling.noise_correlation,
        send_threshold=() if s.sampling.try_once_discard else s.sampling.send_threshold,
        in_loop=bool(s.loop.controller),
        sensors=len(clocks),
        P0=np.diag(np.square(belief.prior_std)),
        input_intensity=belief.drift_intensity if s.truth.parameter_drift else 0.0,
        oosm_lag=cache("oosm_lag", (tuple(clocks), n), oosm_lag),
        random_schedule=sampling.any_random(clocks),
        process_std=belief.assumed_process_std or s.truth.process_std,
        error=cell.times.error,
        reach=max(-(-d // p) for d, p in zip(delay, period, strict=True)),
        flight=random_times.room(clocks, n, cell.times.error),
        latest=latest + cell.times.error,
        unknown_std=belief.unknown_std,
        unknown0=belief.unknown0 or (0.0,) * n_unknowns,
        unknown_range=plant.ranges or ((-np.inf, np.inf),) * n_unknowns,
        field=field,
        successor=successor,
        sensor=sensor,
        residual=residual,
        parts=parts,
        variant=partial(_variant, s),
        xhat0=belief.xhat0,
        intervals=() if len(clocks) > 1 else cache("intervals", (clocks[0], n), intervals),
    )


def _variant(s: Scenario, parameters: dict[str, float]) -> linear.Model:
    """Return the model assumed by observers for other parameters."""
    valid = parameters_in(s)
    for name in parameters:
        if name not in valid:
            raise unknown(f"{s.name}: parameter_range", f"parameter of plant {s.plant}", name, valid)
    return entry_of(s).nominal(replace_numbers(numbers_of(s), parameters))
