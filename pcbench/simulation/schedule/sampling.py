"""Clocks: when samples are taken, in whole ticks, by profiles of the intervals between them."""

from typing import NamedTuple

import numpy as np

LOST = -1  # among the turns of a clock: that sample never arrives


class Stamp(NamedTuple):
    """How wrong the time is that a sample's stamp says: later by offset + drift k +- jitter, of a sample taken at tick k."""

    offset: int = 0  # ticks
    drift: float = 0.0  # ticks a tick
    jitter: int = 0  # ticks, at most

    def ahead(self, tick: int) -> int:
        """Return by how much the stamp of a sample taken at a tick is later than that, without jitter."""
        return self.offset + round(self.drift * tick)

    def reach(self, ticks: int) -> tuple[int, int]:
        """Return by how much a stamp may be too early and too late over ticks 0 .. `ticks`."""
        ends = [self.ahead(tick) for tick in (0, ticks)]
        return max(self.jitter - min(ends), 0), max(max(ends) + self.jitter, 0)


class Clock(NamedTuple):
    """One sensor: channels that are sampled, delayed and lost together. Times in ticks."""

    channels: tuple[int, ...]
    period: int  # the mean where intervals vary
    delay: int | None  # None: one interval, a sample arrives when the next is taken
    profile: str | tuple[int, ...] = "periodic"  # of the intervals: a name in PROFILES, or intervals in turn
    jitter: int = 0  # a sample (but the first) is taken up to this much early or late
    spread: int = 0  # jitter of the delay: a sample arrives up to this much later
    loss: float = 0.0  # probability that a sample never arrives
    stride: int = 1  # samples are numbered 0, stride, 2 stride, ...: those between are not used, and draw nothing
    early: bool = False  # measuring began before tick 0: `period` is between arrivals, the first of them at tick 0
    swing: tuple[float, float] = (0.0, 0.0)  # (a [ticks], w [rad a tick]) of an age delay + a sin(w k), at arrival k
    steps: tuple[int, ...] = ()  # a sample arrives later by one of them, which a Markov chain chooses; empty: by none
    stay: tuple[float, ...] = ()  # of each: probability that the next sample has the same one, below 1
    share: tuple[float, ...] = ()  # of each: how often it is, drawn for each sample by itself; empty: they are a chain
    turns: tuple[int, ...] = ()  # samples arrive later by these in turn, or never (LOST); then nothing of it is random
    burst: float = 0.0  # mean number of samples lost in a row; 0: each is lost by itself
    phase: int = 0  # tick of the first sample
    outage: tuple[int, int] = (0, 0)  # a sample taken from the first tick on, but before the second, never arrives
    stamp: Stamp = Stamp()  # of all clocks of a scenario the same: one recorder stamps them all

    @property
    def random(self) -> bool:
        """Whether every run has times of its own."""
        return self.profile == "uniform" or max(self.jitter, self.spread, *self.steps, self.loss, self.stamp.jitter) > 0

    @property
    def plain(self) -> bool:
        """Whether samples are a period apart, each as late as the others, and stamped when they are taken."""
        return self == Clock(self.channels, self.period, self.delay, stride=self.stride)

    @property
    def latest(self) -> int:
        """How much later than its delay a sample may arrive."""
        return self.spread + max(self.steps, default=0) + max(self.known_turns, default=0)

    @property
    def earliest(self) -> int:
        """How much later than its delay a sample arrives at least."""
        return min(self.steps, default=0) + min(self.known_turns, default=0)

    @property
    def known_turns(self) -> list[int]:
        """The turns of samples that arrive."""
        return [turn for turn in self.turns if turn != LOST]

    @property
    def later(self) -> int:
        """How much later than its delay a sample arrives in the mean."""
        mean = sum(p * step for p, step in zip(self.share or stationary(self.stay), self.steps, strict=True))
        turns = self.known_turns
        return self.spread // 2 + round(mean) + round(sum(turns) / max(len(turns), 1))


def stationary(stay: tuple[float, ...]) -> list[float]:
    """Return how often a chain is at each value that it keeps with these probabilities, or else changes for any other alike.

    It goes from any value to any other as often as back, so it is there in proportion to 1 / (1 - stay).
    """
    weights = [1 / (1 - p) for p in stay]
    return [w / sum(weights) for w in weights]


def gamma(mean: float, shape: float) -> tuple[float, ...]:
    """Return how often a delay of a gamma distribution is nearest to 0, 1, 2 ... ticks; mean in ticks.

    The last one has all that is later, 1e-4 of samples or fewer.
    """
    from scipy.special import gammainc

    last = max(int(np.ceil(latest_of_gamma(mean, shape))), 1)
    below = gammainc(shape, (np.arange(last) + 0.5) * shape / mean)
    return tuple(np.diff(below, prepend=0.0, append=1.0).tolist())


def latest_of_gamma(mean: float, shape: float) -> float:
    """Return what a delay of a gamma distribution exceeds in 1e-4 of samples, in the unit of its mean."""
    from scipy.special import gammaincinv

    return float(gammaincinv(shape, 1 - 1e-4)) * mean / shape


def breaks(clock: Clock) -> tuple[float, float]:
    """Return the probability that a sample is lost after one that was not, and after one that was (Gilbert 1960).

    So that a share `loss` is lost, and `mean_burst_length` in a row in the mean.
    """
    if not clock.burst:
        return clock.loss, clock.loss
    return clock.loss / (1 - clock.loss) / clock.burst, 1 - 1 / clock.burst


PROFILES = {
    "periodic": "every interval the period",
    "sine": "T_i = period (1 + 0.5 sin(0.6 i)), i = 1, 2, ...: the profile of Li, Wang, Tian as decided",
    "uniform": "every interval uniform over 0.5 to 1.5 periods, for each seed",
}


def any_random(clocks: list[Clock]) -> bool:
    """Return whether every run has a schedule of its own."""
    return any(clock.random for clock in clocks)


def interval(clock: Clock, i: int) -> int:
    """Return the interval between samples i-1 and i of a clock whose intervals are not random."""
    if isinstance(clock.profile, tuple):
        return clock.profile[(i - 1) % len(clock.profile)]
    return max(1, round(clock.period * (1 + 0.5 * np.sin(0.6 * i)))) if clock.profile == "sine" else clock.period


def uniform_range(period: int) -> tuple[int, int]:
    """Return the least and the largest interval of the profile `uniform`."""
    low = max(1, -(-period // 2))
    return low, max(low, 3 * period // 2)


def instants(clock: Clock, ticks: int) -> list[int]:
    """Return when samples are due, from the first to the first beyond `ticks`; the mean where they are random."""
    if clock.profile in ("periodic", "uniform"):
        return list(range(clock.phase, max(clock.phase, ticks + clock.period) + 1, clock.period))
    out = [clock.phase]
    while out[-1] <= ticks:
        out.append(out[-1] + interval(clock, len(out)))
    return out


def intervals(clock: Clock, ticks: int) -> list[int]:
    """Return every interval between successive samples that can occur, lost ones counted as taken."""
    if clock.profile == "uniform":
        low, high = uniform_range(clock.period)
        due = list(range(low, high + 1))
    elif clock.profile == "periodic":
        due = [clock.period]
    else:
        last = max(ticks + clock.jitter, clock.phase)  # jitter may bring one in from beyond; the first may be beyond
        due = sorted(set(np.diff(instants(clock, last)).tolist()))
    j = 2 * clock.jitter
    return list(range(max(due[0] - j, 1), due[-1] + j + 1)) if j else due


def age(clock: Clock, arrives: int) -> int:
    """Return the age, in whole ticks, of the sample that arrives at a tick, of a clock with a delay of the time."""
    swing, pace = clock.swing
    return round((clock.delay or 0) + swing * np.sin(pace * arrives))


def ages(clock: Clock, ticks: int) -> tuple[int, int]:
    """Return the least and the largest age of a sample when it arrives."""
    if any(clock.swing):
        found = sorted(age(clock, arrives) for arrives in instants(clock, max(ticks, clock.phase))[:-1])
    else:
        found = intervals(clock, ticks) if clock.delay is None else [clock.delay]
    return found[0] + clock.earliest, found[-1] + clock.latest
