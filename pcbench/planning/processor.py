"""A processor of limited speed: the computing time of an observer, and the samples that it has time for.

Each observer has a processor of its own with v multiplications per second (`operation_counts`). At every tick of h seconds it
first predicts the estimate with c_t multiplications. It uses the rest of the tick for one sample of c_s multiplications:

    computing time  tau = c_s / (v - c_t / h),   in ticks w, the nearest
    used            every m-th sample, m = max(1, ceil(w / p)) for a period of p ticks, so that none waits for the processor
    usable          w ticks after its arrival: its age is then d + w for a delay of d ticks

The estimate includes a sample when its arithmetic is complete. Until then it is the prediction from the samples before. The
schedule is fixed before the run, and designs use m and w. A processor that ignores samples while it is busy has the same
schedule. An observer that predicts tick by tick needs more multiplications for an older sample (age a = d + w), and after a
longer interval i = m p. So c_s depends on w, and w is the smallest value that is sufficient:

    c_s(a, i) = c(d, p) + (c(d + p, p) - c(d, p)) (a - d) / p + (c(d, 2p) - c(d, p)) (i - p) / p

with counts c, and no slope below 0. An observer that needs more time than a run, or all multiplications of a tick for the
prediction, uses no sample. Its estimate is then the prediction from the start.

Not included: the time of additions, memory access and random numbers; a processor that several observers or a controller share;
the time of the prediction itself, whose result is usable in its tick. The counts c are for the gains of the scenario's own
delay. A w below half a tick is 0: a shorter tick resolves it.
"""

from collections.abc import Callable
from math import floor, inf
from typing import NamedTuple

from pcbench.planning.operation_counts import Cost
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study.grid import Cell
from pcbench.study.times import Timing, times_of


class Load(NamedTuple):
    """The samples that a processor can process."""

    wait: int  # ticks, computing time of a sample; NEVER: longer than a run
    stride: int  # m: every m-th sample is used


NEVER = -1
IDLE = Load(0, 1)


def computing_time(sample: float, tick: int, speed: float, dt: float) -> float:
    """Return how long a sample takes [s] when each tick needs its own multiplications; inf if they leave no time."""
    free_speed = speed - tick / dt
    return sample / free_speed if free_speed > 0 else inf


def load_of(cost: Callable[[int, int], Cost], clock: Clock, ticks: int, speed: float, dt: float) -> Load:
    """Return the load of a processor of a speed [multiplications/s], for the samples of a clock over a run.

    `cost` returns the operations of an observer for the age of a sample and the ticks between samples.
    """
    period, delay = clock.period, clock.period if clock.delay is None else clock.delay
    base, older, rarer = (cost(*at) for at in ((delay, period), (delay + period, period), (delay, 2 * period)))
    by_age, by_interval = (max(c.sample - base.sample, 0) for c in (older, rarer))
    load = IDLE
    while delay + load.wait <= ticks:
        sample = base.sample + (by_age * load.wait + by_interval * (load.stride - 1) * period) / period
        ticks_needed = computing_time(sample, base.tick, speed, dt) / dt
        if not ticks_needed <= ticks:
            break
        if (wait := floor(ticks_needed + 0.5)) <= load.wait:
            return load
        load = Load(wait, -(-wait // period))
    return Load(NEVER, 1)


def with_load(times: Timing, load: Load) -> Timing:
    """Return the times of a grid point for an observer with this load of its processor."""
    if load == IDLE:
        return times
    return times._replace(clocks=[_clock_with_load(clock, load, times.ticks) for clock in times.clocks])


def _clock_with_load(clock: Clock, load: Load, ticks: int) -> Clock:
    if load.wait == NEVER:  # equivalent to the loss of all samples
        return clock._replace(outage=(0, ticks + 1))
    delay = clock.period if clock.delay is None else clock.delay
    return clock._replace(period=load.stride * clock.period, delay=delay + load.wait, stride=load.stride)


def times_in(cell: Cell) -> tuple[float, int]:
    """Return the computing time of a sample at a grid point [s] (inf: too long), and m: every m-th sample is used."""
    (sensor_clock, clock), N = (times.clocks[0] for times in (times_of(cell.scenario), cell.times)), cell.times.ticks
    if clock.outage == (0, N + 1):
        return inf, clock.stride
    delays = (c.period if c.delay is None else c.delay for c in (clock, sensor_clock))
    return (next(delays) - next(delays)) * cell.scenario.dt, clock.stride
