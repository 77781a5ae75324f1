"""Random delays as modes of a jump-linear system: the delays of the newest samples, with transitions between modes.

The additional delay w_i of sample i is a Markov chain over a few values (`delay_values`, `delay_self_transition`), independent
(`delay_weights`, `delay_gamma_mean`, `delay_jitter`), or both. The events between samples i and i + 1 depend on
w_i .. w_(i-L+1), if samples i - L and before have arrived by then. These L values are the mode. Within a mode the schedule is
known, and the error is affine in normals, with conditional mean m and covariance P. At the next sample

    m+_b = sum_a q(a | b) m_a,   P+_b = sum_a q(a | b) (P_a + d_a d_a'),   d_a = m_a - m+_b

with a the previous mode, and q(a | b) its probability given b (Costa, Fragoso, Marques, Discrete-Time Markov Jump Linear
Systems, 2005). The chain starts in its stationary distribution. So mode probabilities are the same at every tick, and a mean
over schedules is a mean over modes. Out-of-sequence samples are covered: L grows with the longest delay.

Conditions:

- one sensor with deterministic sampling instants
- at most `MOST_MODES` modes, which cost no more than the same number of drawn schedules
- the part of an observer's memory without noise (index of the newest sample, a covariance) depends on the mode alone; this is
  checked whenever modes merge (`events`)

A filter that puts samples in order meets the last condition, as all older samples have arrived. A filter whose covariance
depends on all delays (`kf-ignore-delay`) does not. Its moments are averaged over drawn schedules, with a standard error. The
same holds for losses or random instants in addition to such delays, and for more modes.
"""

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from pcbench.moments.affinity import uses_last_arrival
from pcbench.moments.inputs import Mix
from pcbench.moments.realisations import Mode, Realisation
from pcbench.planning.padding import Plan
from pcbench.simulation.schedule import common_times, sampling
from pcbench.simulation.schedule.common_times import Schedule
from pcbench.simulation.schedule.sampling import Clock

MOST_MODES = 64  # modes of a grid point: the default number of drawn schedules
Values = NDArray[np.float64]


class Chain(NamedTuple):
    """Additional delays of a clock's samples; m values."""

    delays: tuple[int, ...]  # [m] ticks
    stationary: Values  # [m] stationary and initial distribution
    transition: Values  # [m, m] transition matrix


def realisations_over_modes(p: Plan) -> list[Realisation] | None:
    """Return a grid point of one observer in each of its modes; None if its schedules are averaged or not random."""
    clock, ticks = p.cell.times.clocks[0], p.cell.times.ticks
    if not only_delays_random(p):
        return None
    chain = _chain(clock)
    layout = p.layout._replace(width=1, watch=False)
    length = _length(clock, chain, ticks, uses_last_arrival(layout, p.problem))
    if len(chain.delays) ** length > MOST_MODES:
        return None
    modes = [a for a in itertools.product(range(len(chain.delays)), repeat=length) if _mode_probability(chain, a) > 0]
    number_of = {mode: i for i, mode in enumerate(modes)}
    instants = sampling.instants(clock, ticks)[:-1]
    merge_ticks = np.isin(np.arange(ticks + 1), instants[1:])
    schedule_of = _schedules(p, clock, chain, length, instants)
    realisations = []
    for mode in modes:
        sources = [(*mode[1:], oldest) for oldest in range(len(chain.delays))]
        sources = [m for m in sources if m in number_of and chain.transition[m[0], mode[0]] > 0]
        weight = np.array([_mode_probability(chain, m) * chain.transition[m[0], mode[0]] for m in sources])
        source = tuple(number_of[m] for m in sources)
        weights = tuple((weight / weight.sum()).tolist())
        origin = Mode(number_of[mode], _mode_probability(chain, mode), source, weights, merge_ticks)
        realisations.append(Realisation(layout, p.problem._replace(schedule=schedule_of(mode)), (), mode=origin))
    return realisations


def mix_of(modes: list[Mode]) -> Mix:
    """Return the transitions between modes side by side; modes of one grid point are adjacent, and the last may be repeated."""
    n_sources = max(len(mode.source) for mode in modes)
    source, weight = np.zeros((n_sources, len(modes)), int), np.zeros((n_sources, len(modes)))
    first = 0
    for column, mode in enumerate(modes):
        if mode.number == 0:
            first = column
        sources = [first + number for number in mode.source]
        source[:, column] = sources + sources[:1] * (n_sources - len(sources))
        weight[: len(sources), column] = mode.weight
    return Mix(source, weight, np.stack([mode.merge_ticks for mode in modes], -1))


def only_delays_random(p: Plan) -> bool:
    """Return whether the delays of one sensor are all that is random in addition to the noise."""
    clocks = p.cell.times.clocks
    if len(clocks) > 1 or not clocks[0].random or p.layout.drifting or p.problem.network:
        return False
    return not (_without_delays(clocks[0]).random or clocks[0].early or any(clocks[0].outage))


def _without_delays(clock: Clock) -> Clock:
    """Return a clock whose samples all have its delay."""
    return clock._replace(delay_jitter=0, delay_values=(), delay_self_transition=(), delay_weights=())


def _chain(clock: Clock) -> Chain:
    """Return the chain of additional delays: dependent or independent steps, plus independent jitter."""
    delay_values, m = clock.delay_values or (0,), len(clock.delay_values) or 1
    if clock.delay_weights or not clock.delay_values:
        stationary = np.array(clock.delay_weights or (1.0,))
        transition = np.tile(stationary, (m, 1))
    else:
        stay = np.array(clock.delay_self_transition)
        stationary = np.array(sampling.stationary(clock.delay_self_transition))
        transition = np.where(np.eye(m, dtype=bool), stay[:, None], (1 - stay[:, None]) / max(m - 1, 1))
    jitter = np.full(clock.delay_jitter + 1, 1 / (clock.delay_jitter + 1))
    delays = tuple(step + jitter_ticks for step in delay_values for jitter_ticks in range(clock.delay_jitter + 1))
    return Chain(delays, np.kron(stationary, jitter), np.kron(transition, np.tile(jitter, (len(jitter), 1))))


def _length(clock: Clock, chain: Chain, ticks: int, last_arrival: bool) -> int:
    """Return how many of the newest samples determine the events until the next one, and the last arrival if `last_arrival`."""
    instants = np.array(sampling.instants(clock, ticks))
    nominal = instants[1:] if clock.delay is None else instants[:-1] + clock.delay
    first, last, instants = nominal + min(chain.delays), nominal + max(chain.delays), instants[:-1]
    M = len(instants)
    length = next(n for n in range(1, M + 1) if (last[: M - n] < instants[n:]).all())
    if not last_arrival:
        return length
    longer = range(length + 1, M + length + 1)
    return next(n for n in longer if (first[n - length :][: M - n] >= last[: M - n]).all())


def _mode_probability(chain: Chain, mode: tuple[int, ...]) -> float:
    """Return the probability of a mode; the newest sample's value comes first."""
    old = mode[::-1]
    return float(chain.stationary[old[0]] * math.prod(chain.transition[a, b] for a, b in itertools.pairwise(old)))


def _schedules(
    p: Plan, clock: Clock, chain: Chain, length: int, instants: list[int]
) -> Callable[[tuple[int, ...]], Schedule]:
    """Return a function that gives the schedule of a mode: the events at every tick if the newest samples have its delays.

    A sequence of L delays that repeats has the events of one mode in every L-th interval.
    """
    ticks, channels, error = p.cell.times.ticks, len(p.problem.noise_std), p.cell.times.error

    @cache
    def repeating(values: tuple[int, ...]) -> Schedule:
        delays = tuple(chain.delays[v] for v in values)
        samples = common_times.samples_of([_without_delays(clock)._replace(delay_sequence=delays)], ticks)
        return common_times.schedule(samples, ticks, channels, error)

    newest = np.searchsorted(instants, np.arange(ticks + 1), "right") - 1

    # arrays without a tick axis are common to all
    def by_interval(*arrays: NDArray[np.generic]) -> NDArray[np.generic]:
        return arrays[0] if len(arrays[0]) != ticks + 1 else np.stack(arrays)[newest % length, np.arange(ticks + 1)]

    def schedule_of(mode: tuple[int, ...]) -> Schedule:
        schedules = [repeating(tuple(mode[(last - i) % length] for i in range(length))) for last in range(length)]
        slots = max(schedule.arrive.shape[1] for schedule in schedules)
        schedules = [common_times.pad_slots(schedule, slots) for schedule in schedules]
        return jax.tree.map(by_interval, *schedules)

    return schedule_of
