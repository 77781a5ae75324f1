"""A processor of limited speed: the computing time of an observer, and the samples that it has time for.

Each observer has a processor of its own, which makes v multiplications a second (`operation_counts`). At every tick of h
seconds it first moves the estimate: c_t multiplications. What is left of the tick goes to one sample, of c_s multiplications:

    computing time  tau = c_s / (v - c_t / h),   in ticks w, the nearest
    used            every m-th sample, m = max(1, ceil(w / p)) of a period of p ticks, so that none waits for the processor
    usable          w ticks after its arrival: its age is then d + w of a delay of d ticks

So a sample that is used takes part in the estimate when its arithmetic is done; until then the estimate is the prediction from
the samples before it. The schedule is fixed before the run, as a control engineer plans it, and designs know m and w. A
processor that ignores samples while it is busy has the same schedule. An observer that goes on tick by tick has more to do
with an older sample (age a = d + w), and after a longer interval i = m p. So c_s depends on w, the least that suffices:

    c_s(a, i) = c(d, p) + (c(d + p, p) - c(d, p)) (a - d) / p + (c(d, 2p) - c(d, p)) (i - p) / p

with counts c, and no slope below 0. An observer that needs more than a run, or all multiplications of a tick to move its
estimate, uses no sample; its estimate is then the prediction from the start.

Not claimed: the time of additions, of memory, of random numbers; a processor that several observers share, or a controller;
the time of the prediction itself, whose result is usable in its tick. Gains are those for the scenario's own delay when c is
counted. A w below half a tick is 0: a shorter tick resolves it.
"""

from collections.abc import Callable
from math import floor, inf
from typing import NamedTuple

from pcbench.planning.operation_counts import Cost
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study.grid import Cell
from pcbench.study.times import Timing, times_of


class Load(NamedTuple):
    """What a processor has time for."""

    wait: int  # ticks, computing time of a sample; NEVER: it does not end within a run
    every: int  # of the samples every so many-th is used


NEVER = -1
IDLE = Load(0, 1)


def computing_time(sample: float, tick: int, speed: float, dt: float) -> float:
    """Return how long a sample takes [s] when each tick needs its own multiplications; inf if they leave no time."""
    left = speed - tick / dt
    return sample / left if left > 0 else inf


def load_of(cost: Callable[[int, int], Cost], clock: Clock, ticks: int, speed: float, dt: float) -> Load:
    """Return what a processor of a speed [multiplications/s] has time for, of the samples of a clock over a horizon.

    `cost` is what an observer costs over the age of samples and the ticks between them.
    """
    period, delay = clock.period, clock.period if clock.delay is None else clock.delay
    own, older, rarer = (cost(*at) for at in ((delay, period), (delay + period, period), (delay, 2 * period)))
    by_age, by_interval = (max(each.sample - own.sample, 0) for each in (older, rarer))
    load = IDLE
    while delay + load.wait <= ticks:
        sample = own.sample + (by_age * load.wait + by_interval * (load.every - 1) * period) / period
        need = computing_time(sample, own.tick, speed, dt) / dt
        if not need <= ticks:
            break
        if (wait := floor(need + 0.5)) <= load.wait:
            return load
        load = Load(wait, -(-wait // period))
    return Load(NEVER, 1)


def slowed(times: Timing, load: Load) -> Timing:
    """Return the times of a cell as they are to an observer whose processor has time for so much."""
    if load == IDLE:
        return times
    return times._replace(clocks=[_slowed(clock, load, times.ticks) for clock in times.clocks])


def _slowed(clock: Clock, load: Load, ticks: int) -> Clock:
    if load.wait == NEVER:  # as if all samples were lost
        return clock._replace(outage=(0, ticks + 1))
    delay = clock.period if clock.delay is None else clock.delay
    return clock._replace(period=load.every * clock.period, delay=delay + load.wait, stride=load.every)


def times_in(cell: Cell) -> tuple[float, int]:
    """Return how long a sample takes an observer in its slowed cell [s], inf if too long; and of how many one is used."""
    (usual, mine), N = (times.clocks[0] for times in (times_of(cell.scenario), cell.times)), cell.times.ticks
    if mine.outage == (0, N + 1):
        return inf, mine.stride
    delays = (each.period if each.delay is None else each.delay for each in (mine, usual))
    return (next(delays) - next(delays)) * cell.scenario.dt, mine.stride
