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
- at most `MOST` modes, which cost no more than the same number of drawn schedules
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

from pcbench.moments.affinity import asks_last_arrival
from pcbench.moments.inputs import Mix
from pcbench.moments.realisations import Mode, Realisation
from pcbench.planning.padding import Plan
from pcbench.simulation.schedule import common_times, sampling
from pcbench.simulation.schedule.common_times import Schedule
from pcbench.simulation.schedule.sampling import Clock

MOST = 64  # modes of a grid point: the default number of drawn schedules
Values = NDArray[np.float64]


class Chain(NamedTuple):
    """Additional delays of a clock's samples; m values."""

    later: tuple[int, ...]  # [m] ticks
    often: Values  # [m] stationary and initial distribution
    following: Values  # [m, m] transition matrix


def over_modes(p: Plan) -> list[Realisation] | None:
    """Return a grid point of one observer in each of its modes; None if its schedules are averaged or not random."""
    clock, ticks = p.cell.times.clocks[0], p.cell.times.ticks
    if not delays_alone(p):
        return None
    chain = _chain(clock)
    layout = p.layout._replace(width=1, watch=False)
    length = _length(clock, chain, ticks, asks_last_arrival(layout, p.problem))
    if len(chain.later) ** length > MOST:
        return None
    every = [a for a in itertools.product(range(len(chain.later)), repeat=length) if _share(chain, a) > 0]
    number = {mode: i for i, mode in enumerate(every)}
    taken = sampling.instants(clock, ticks)[:-1]
    merged = np.isin(np.arange(ticks + 1), taken[1:])
    schedule_of = _schedules(p, clock, chain, length, taken)
    out = []
    for mode in every:
        before = [(*mode[1:], oldest) for oldest in range(len(chain.later))]
        before = [each for each in before if each in number and chain.following[each[0], mode[0]] > 0]
        weight = np.array([_share(chain, each) * chain.following[each[0], mode[0]] for each in before])
        source = tuple(number[each] for each in before)
        about = Mode(number[mode], _share(chain, mode), source, tuple((weight / weight.sum()).tolist()), merged)
        out.append(Realisation(layout, p.problem._replace(schedule=schedule_of(mode)), (), mode=about))
    return out


def mix_of(modes: list[Mode]) -> Mix:
    """Return the transitions between modes side by side; modes of one grid point are adjacent, and the last may be repeated."""
    many = max(len(mode.source) for mode in modes)
    source, weight = np.zeros((many, len(modes)), int), np.zeros((many, len(modes)))
    first = 0
    for at, mode in enumerate(modes):
        if mode.number == 0:
            first = at
        mine = [first + number for number in mode.source]
        source[:, at] = mine + mine[:1] * (many - len(mine))
        weight[: len(mine), at] = mode.weight
    return Mix(source, weight, np.stack([mode.merged for mode in modes], -1))


def delays_alone(p: Plan) -> bool:
    """Return whether the delays of one sensor are all that is random in addition to the noise."""
    clocks = p.cell.times.clocks
    if len(clocks) > 1 or not clocks[0].random or p.layout.drifting or p.problem.network:
        return False
    return not (_sure(clocks[0]).random or clocks[0].early or any(clocks[0].outage))


def _sure(clock: Clock) -> Clock:
    """Return a clock whose samples all have its delay."""
    return clock._replace(spread=0, steps=(), stay=(), share=())


def _chain(clock: Clock) -> Chain:
    """Return the chain of additional delays: dependent or independent steps, plus independent jitter."""
    steps, many = clock.steps or (0,), len(clock.steps) or 1
    if clock.share or not clock.steps:
        often = np.array(clock.share or (1.0,))
        T = np.tile(often, (many, 1))
    else:
        often, stay = np.array(sampling.stationary(clock.stay)), np.array(clock.stay)
        T = np.where(np.eye(many, dtype=bool), stay[:, None], (1 - stay[:, None]) / max(many - 1, 1))
    jitter = np.full(clock.spread + 1, 1 / (clock.spread + 1))
    later = tuple(step + more for step in steps for more in range(clock.spread + 1))
    return Chain(later, np.kron(often, jitter), np.kron(T, np.tile(jitter, (len(jitter), 1))))


def _length(clock: Clock, chain: Chain, ticks: int, asked: bool) -> int:
    """Return how many of the newest samples determine the events until the next one; with the last arrival if `asked`."""
    taken = np.array(sampling.instants(clock, ticks))
    usual = taken[1:] if clock.delay is None else taken[:-1] + clock.delay
    first, last, taken = usual + min(chain.later), usual + max(chain.later), taken[:-1]
    many = len(taken)
    back = next(n for n in range(1, many + 1) if (last[: many - n] < taken[n:]).all())
    if not asked:
        return back
    return next(
        n for n in range(back + 1, many + back + 1) if (first[n - back :][: many - n] >= last[: many - n]).all()
    )


def _share(chain: Chain, mode: tuple[int, ...]) -> float:
    """Return the probability of a mode; the newest sample's value comes first."""
    old = mode[::-1]
    return float(chain.often[old[0]] * math.prod(chain.following[a, b] for a, b in itertools.pairwise(old)))


def _schedules(
    p: Plan, clock: Clock, chain: Chain, length: int, taken: list[int]
) -> Callable[[tuple[int, ...]], Schedule]:
    """Return a function that gives the schedule of a mode: the events at every tick if the newest samples have its delays.

    A sequence of L delays that repeats has the events of one mode in every L-th interval.
    """
    ticks, channels, error = p.cell.times.ticks, len(p.problem.noise_std), p.cell.times.error

    @cache
    def in_turn(values: tuple[int, ...]) -> Schedule:
        turns = tuple(chain.later[v] for v in values)
        return common_times.schedule(
            common_times.samples([_sure(clock)._replace(turns=turns)], ticks), ticks, channels, error
        )

    newest = np.searchsorted(taken, np.arange(ticks + 1), "right") - 1

    def by_interval(*each: NDArray[np.generic]) -> NDArray[np.generic]:  # arrays without a tick axis are common to all
        return each[0] if len(each[0]) != ticks + 1 else np.stack(each)[newest % length, np.arange(ticks + 1)]

    def of(mode: tuple[int, ...]) -> Schedule:
        each = [in_turn(tuple(mode[(last - i) % length] for i in range(length))) for last in range(length)]
        slots = max(one.arrive.shape[1] for one in each)
        each = [common_times.pad_slots(one, slots) for one in each]
        return jax.tree.map(by_interval, *each)

    return of
