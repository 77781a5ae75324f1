"""Clocks: sampling instants in whole ticks, by pattern of the intervals."""

from typing import NamedTuple

import numpy as np

LOST = -1  # in `Clock.delay_sequence`: the sample is lost


class Stamp(NamedTuple):
    """Timestamp error: the timestamp of a sample taken at tick k is later by offset + drift k +- jitter."""

    offset: int = 0  # ticks
    drift: float = 0.0  # ticks per tick
    jitter: int = 0  # largest absolute value, ticks

    def error_at(self, tick: int) -> int:
        """Return timestamp minus sampling tick for a sample taken at a tick, without jitter."""
        return self.offset + round(self.drift * tick)

    def max_errors(self, ticks: int) -> tuple[int, int]:
        """Return how many ticks a timestamp may be too early and too late over ticks 0 .. `ticks`."""
        ends = [self.error_at(tick) for tick in (0, ticks)]
        return max(self.jitter - min(ends), 0), max(max(ends) + self.jitter, 0)


class Clock(NamedTuple):
    """One sensor: channels that are sampled, delayed and lost together. Times in ticks."""

    channels: tuple[int, ...]
    period: int  # the mean if intervals vary
    delay: int | None  # None: one interval, a sample arrives when the next is taken
    profile: str | tuple[int, ...] = "periodic"  # of the intervals: a name in PROFILES, or intervals that repeat
    jitter: int = 0  # every sample except the first is taken up to this much early or late
    delay_jitter: int = 0  # a sample arrives up to this much later
    loss: float = 0.0  # probability that a sample never arrives
    stride: int = 1  # sample numbers are 0, stride, 2 stride, ...; the numbers between are unused and draw nothing
    early: bool = False  # sampling began before tick 0: `period` is between arrivals, the first arrival at tick 0
    delay_sine: tuple[float, float] = (
        0.0,
        0.0,
    )  # (a [ticks], w [rad a tick]) of an age delay + a sin(w k), at arrival k
    delay_values: tuple[int, ...] = ()  # additional delays, by a Markov chain or by `delay_weights`; empty: none
    delay_self_transition: tuple[float, ...] = ()  # probability per value that the next sample has it too, below 1
    delay_weights: tuple[float, ...] = ()  # probability per value, drawn independently for each sample; empty: a chain
    # additional delays that repeat in order; LOST: the sample is lost. Nothing is then random
    delay_sequence: tuple[int, ...] = ()
    burst: float = 0.0  # mean number of samples lost in a row; 0: losses are independent
    phase: int = 0  # tick of the first sample
    outage: tuple[int, int] = (0, 0)  # a sample taken from the first tick on, but before the second, is lost
    stamp: Stamp = Stamp()  # the same for all clocks of a scenario: one recorder stamps all samples

    @property
    def random(self) -> bool:
        """Whether each run has its own sampling times."""
        ranges = self.jitter, self.delay_jitter, *self.delay_values, self.loss, self.stamp.jitter
        return self.profile == "uniform" or max(ranges) > 0

    @property
    def plain(self) -> bool:
        """Whether the interval and the delay are constant and timestamps are correct."""
        return self == Clock(self.channels, self.period, self.delay, stride=self.stride)

    @property
    def max_extra_delay(self) -> int:
        """Largest additional delay of a sample."""
        return self.delay_jitter + max(self.delay_values, default=0) + max(self.sent_delays, default=0)

    @property
    def min_extra_delay(self) -> int:
        """Smallest additional delay of a sample."""
        return min(self.delay_values, default=0) + min(self.sent_delays, default=0)

    @property
    def sent_delays(self) -> list[int]:
        """The values of `delay_sequence` without the lost samples."""
        return [delay for delay in self.delay_sequence if delay != LOST]

    @property
    def mean_extra_delay(self) -> int:
        """Mean additional delay of a sample."""
        weights = self.delay_weights or stationary(self.delay_self_transition)
        mean = sum(p * delay for p, delay in zip(weights, self.delay_values, strict=True))
        delays = self.sent_delays
        return self.delay_jitter // 2 + round(mean) + round(sum(delays) / max(len(delays), 1))


def stationary(stay: tuple[float, ...]) -> list[float]:
    """Return the stationary distribution of a chain that keeps a value with probability `stay`, else takes another.

    All other values are equally likely. Transitions between two values are as frequent either way, so the distribution is
    proportional to 1 / (1 - stay).
    """
    weights = [1 / (1 - p) for p in stay]
    return [w / sum(weights) for w in weights]


def gamma(mean: float, shape: float) -> tuple[float, ...]:
    """Return the probabilities of 0, 1, 2 ... ticks of a gamma-distributed delay rounded to ticks; mean in ticks.

    The last one includes the rest of the tail, at most 1e-4.
    """
    from scipy.special import gammainc

    last = max(int(np.ceil(gamma_quantile(mean, shape))), 1)
    below = gammainc(shape, (np.arange(last) + 0.5) * shape / mean)
    return tuple(np.diff(below, prepend=0.0, append=1.0).tolist())


def gamma_quantile(mean: float, shape: float) -> float:
    """Return the 1 - 1e-4 quantile of a gamma-distributed delay, in the unit of its mean."""
    from scipy.special import gammaincinv

    return float(gammaincinv(shape, 1 - 1e-4)) * mean / shape


def loss_probabilities(clock: Clock) -> tuple[float, float]:
    """Return the probability of a loss after a received sample and after a lost one (Gilbert 1960).

    A share `loss` of all samples is then lost, in bursts of mean length `burst`.
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
    """Return whether each run has its own schedule."""
    return any(clock.random for clock in clocks)


def interval(clock: Clock, i: int) -> int:
    """Return the interval between samples i-1 and i of a clock with deterministic intervals."""
    if isinstance(clock.profile, tuple):
        return clock.profile[(i - 1) % len(clock.profile)]
    return max(1, round(clock.period * (1 + 0.5 * np.sin(0.6 * i)))) if clock.profile == "sine" else clock.period


def uniform_range(period: int) -> tuple[int, int]:
    """Return the smallest and the largest interval of the pattern `uniform`."""
    low = max(1, -(-period // 2))
    return low, max(low, 3 * period // 2)


def instants(clock: Clock, ticks: int) -> list[int]:
    """Return the sampling instants from the first up to the first after `ticks`; the mean ones if intervals are random."""
    if clock.profile in ("periodic", "uniform"):
        return list(range(clock.phase, max(clock.phase, ticks + clock.period) + 1, clock.period))
    out = [clock.phase]
    while out[-1] <= ticks:
        out.append(out[-1] + interval(clock, len(out)))
    return out


def intervals(clock: Clock, ticks: int) -> list[int]:
    """Return every possible interval between successive samples, counting lost ones."""
    if clock.profile == "uniform":
        low, high = uniform_range(clock.period)
        due = list(range(low, high + 1))
    elif clock.profile == "periodic":
        due = [clock.period]
    else:
        # jitter may move a later sample in; the first sample may be after `ticks`
        last = max(ticks + clock.jitter, clock.phase)
        due = sorted(set(np.diff(instants(clock, last)).tolist()))
    j = 2 * clock.jitter
    return list(range(max(due[0] - j, 1), due[-1] + j + 1)) if j else due


def age(clock: Clock, arrives: int) -> int:
    """Return the age, in whole ticks, of the sample that arrives at a tick, if the delay varies with time."""
    amplitude, rate = clock.delay_sine
    return round((clock.delay or 0) + amplitude * np.sin(rate * arrives))


def ages(clock: Clock, ticks: int) -> tuple[int, int]:
    """Return the smallest and the largest age of a sample at its arrival."""
    if any(clock.delay_sine):
        values = sorted(age(clock, arrives) for arrives in instants(clock, max(ticks, clock.phase))[:-1])
    else:
        values = intervals(clock, ticks) if clock.delay is None else [clock.delay]
    return values[0] + clock.min_extra_delay, values[-1] + clock.max_extra_delay
