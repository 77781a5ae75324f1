"""Maximum-likelihood delay of each channel of a recording, with a 95 % interval from the profile likelihood.

d_c is the time from the physical sampling instant of channel c to its timestamp, in addition to the recording: positive if
samples are older than their timestamps. The search moves along each channel, and along all together, on a grid that is refined
to one tick. A cubic spline through ticks then gives the point between ticks:

    s(j) = exp(-2 l_p(j) / N),   d_c = j_c h + mean of (timestamp - its tick) - the same of inputs

s is the innovation variance of the fitted noise for N samples. It is nearly quadratic in j, unlike l_p. For one channel, the
interval is 2 (max l_p - l_p) < 3.84 (chi-square, one degree of freedom). For several, l_p along one channel has the other
delays at their optimum. To second order it is the slice through the optimum, widened by sqrt((H^-1)_cc H_cc), with H the
curvature of s.

Interval ends at the limits of the search range are marked. Rounding of timestamps to ticks is corrected on average; its
variation acts as noise. Not claimed: intervals for a wrong model or a few dozen samples; that delays are constant. Source:
Venzon, Moolgavkar, Applied Statistics 37 (1988), 87-94.
"""

from collections.abc import Iterable
from itertools import combinations, combinations_with_replacement, product
from typing import NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.playback.delay_profile import Delays, Profile
from pcbench.playback.setup import Playback
from pcbench.recordings.log import Floats, Ints

INTERVALS = 10  # default search range, in sampling intervals of the slowest channel
SHARE = 0.25  # largest delay relative to the length of the recording
FINER = 6  # refinement factor of the grid
SWEEPS = 6  # passes over all channels
LEVEL = 1.920729410347062  # half the 95 % quantile of chi-square with one degree of freedom
SIDE = 6  # points of a profile on each side of its maximum
FLAT = 8  # common shifts of all delays, over the range
APART = 10.0  # ratio of interval to slice width above which only differences of delays are known


class ChannelDelay(NamedTuple):
    """The delay of one channel [s]."""

    channel: str
    estimate: float
    low: float  # 95 % interval
    high: float
    at_end: str  # "low" or "high" if the estimate is at that limit of the search range, else ""
    search_range: tuple[float, float]
    delays: list[float]  # of the profile
    drops: list[float]  # log-likelihood below the maximum


def search_range(playback: Playback, longest: float | None, where: str) -> tuple[Ints, Ints]:
    """Return the smallest and the largest delay of each channel [ticks]; no sample is taken after it arrived."""
    channels, dt = playback.survey.channels.values(), playback.clock.dt
    upper = SHARE * playback.last_tick * dt
    if longest is None:
        longest = min(INTERVALS * max(c.intervals.median for c in channels if c.intervals.many), upper)
    if not dt <= longest <= upper:
        raise UserError(
            f"{where}: --max-delay: got {longest:g} s, expected one tick of {dt:g} s to a quarter of the recording, "
            f"{upper:.4g} s; write a number between them."
        )
    high = round(longest / dt)
    shortest = [int(np.floor(c.delays.least / dt + 1e-6)) if c.delays.many else 0 for c in channels]
    return np.array([-min(max(ticks, 0), high) for ticks in shortest]), np.full(len(shortest), high)


class Slice(NamedTuple):
    """l_p along one channel with the others at the optimum; in ticks."""

    ticks: Ints
    drops: Floats  # of l_p below its maximum
    peak: float  # between ticks
    low: float  # 95 % interval; NaN: beyond the search range
    high: float


def find(profile: Profile) -> tuple[list[ChannelDelay], list[str]]:
    """Return the delay of each channel, and sentences on what the recording does not determine."""
    channels, dt = profile.playback.survey.channels.values(), profile.playback.clock.dt
    steps = [max(int(c.intervals.median / dt) // 2, 1) if c.intervals.many else 1 for c in channels]
    directions = [*np.eye(len(steps), dtype=int)]
    directions += [np.ones(len(steps), int)] * (len(steps) > 1)  # moves all together
    best: Delays = (0,) * len(steps)
    for sweep in range(SWEEPS):
        for direction, step in zip(directions, [*steps, max(steps)], strict=False):
            best = _search(profile, best, direction, step, full_range=sweep == 0)
        slices = [_slice(profile, best, direction) for direction in directions[: len(steps)]]
        peak, widening = _joint(profile, best, slices)
        profile.ask([_inside(profile, corner) for corner in product(*zip(np.floor(peak), np.ceil(peak), strict=True))])
        if profile.best == best:
            break
        best = profile.best
    if len(steps) > 1 and (nearest := _if_flat(profile, best)) is not None:
        best = nearest
        slices = [_slice(profile, best, direction) for direction in directions[: len(steps)]]
        peak, widening = np.array([s.peak for s in slices]), np.full(len(steps), np.inf)
    return _results(profile, best, slices, peak, widening)


def _if_flat(profile: Profile, best: Delays) -> Delays | None:
    """Return the delays nearest to 0 with the same differences, if only differences are determined; else None."""
    first, last = int((profile.low - best).max()), int((profile.high - best).min())
    moves, values = _ask(profile, best, np.ones(len(best), int), np.linspace(first, last, FLAT).astype(int))
    if len(moves) < 2 or values.max() - values.min() > LEVEL:
        return None
    shifts = np.arange(first, last + 1)
    shift = shifts[np.argmin(np.abs(np.array(best) + shifts[:, None]).sum(1))]
    return tuple((np.array(best) + shift).tolist())


def _inside(profile: Profile, delays: Iterable[float]) -> Delays:
    return tuple(np.clip(np.asarray(tuple(delays)), profile.low, profile.high).astype(int).tolist())


def _ask(profile: Profile, best: Delays, direction: Ints, by: Ints) -> tuple[Ints, Floats]:
    """Return the moves along a direction that stay in the range, in order and including 0, with l_p there."""
    moves = np.unique(np.append(by, 0))
    points = np.array(best) + moves[:, None] * direction
    inside = ((points >= profile.low) & (points <= profile.high)).all(1)
    return moves[inside], np.array(profile.ask([tuple(delays) for delays in points[inside].tolist()]))


def _search(profile: Profile, best: Delays, direction: Ints, step: int, full_range: bool) -> Delays:
    """Return the best point along a direction, on a grid of the range or near the best point, refined to one tick."""
    widest = int((profile.high - profile.low).max())
    moves = np.arange(-(widest // step) * step, widest + 1, step) if full_range else step * np.arange(-2, 3)
    while True:
        moves, values = _ask(profile, best, direction, moves)
        best = tuple((np.array(best) + moves[np.argmax(values)] * direction).tolist())
        if step == 1:
            return best
        finer = max(step // FINER, 1)
        moves, step = finer * np.arange(-(step // finer), step // finer + 1), finer


def _slice(profile: Profile, best: Delays, direction: Ints) -> Slice:
    """Return the profile along one channel over its interval, and its maximum between ticks."""
    from scipy.interpolate import CubicSpline

    (c,) = np.flatnonzero(direction)
    reach = 2 ** np.arange(int(profile.high[c] - profile.low[c]).bit_length() + 1)
    ends = np.array([profile.low[c], profile.high[c]]) - best[c]
    moves, values = _ask(profile, best, direction, np.concatenate([-reach, reach, ends]))
    beyond = moves[values < values.max() - LEVEL]
    far = max(-beyond[beyond < 0].max(initial=ends[0]), beyond[beyond > 0].min(initial=ends[1]))
    step = max(-(-int(far) // SIDE), 1)
    moves, values = _ask(profile, best, direction, step * np.arange(-min(SIDE, far) - 1, min(SIDE, far) + 2))
    i, N = int(np.argmax(values)), profile.samples
    if len(moves) < 3:
        return Slice(moves + best[c], values[i] - values, float(moves[i] + best[c]), np.nan, np.nan)
    spline = CubicSpline(moves, np.exp(2 * (values[i] - values) / N))
    turns = spline.derivative().roots(extrapolate=False)
    near = (turns > moves[max(i - 1, 0)]) & (turns < moves[min(i + 1, len(moves) - 1)])
    peak = float(min([*turns[near], moves[i]], key=spline))
    level = spline.solve(float(spline(peak)) * np.exp(2 * LEVEL / N), extrapolate=False)
    low, high = level[level < peak].max(initial=-np.inf), level[level > peak].min(initial=np.inf)
    low, high = (best[c] + float(end) if np.isfinite(end) else np.nan for end in (low, high))
    top = values[i] - 0.5 * N * np.log(float(spline(peak)))
    return Slice(moves + best[c], top - values, peak + best[c], low, high)


def _joint(profile: Profile, best: Delays, slices: list[Slice]) -> tuple[Floats, Floats]:
    """Return the joint maximum of all delays [q] ticks, and the ratio of each interval to its slice.

    A quadratic is fitted to s at the best point, at its neighbours along each channel, and at the corners of each pair. Points
    with lower likelihood have smaller weights. A channel whose maximum is at the end of its range is left out. Infinite:
    unknown.
    """
    peak, widening = np.array([s.peak for s in slices]), np.ones(len(best))
    N, h = profile.samples, np.zeros(len(best), int)
    for c, s in enumerate(slices):
        sides = np.array([s.peak - s.low, s.high - s.peak])
        if np.isfinite(sides).any():
            room = min(best[c] - profile.low[c], profile.high[c] - best[c])
            h[c] = min(max(round(float(np.nanmean(sides))), 1), room)
    inner = np.flatnonzero(h)
    if len(inner) < 2:
        return peak, widening
    e = np.eye(len(best), dtype=int)[inner]
    moves = [0 * e[0], *e, *-e]
    moves += [a * e[i] + b * e[j] for i, j in combinations(range(len(inner)), 2) for a in (1, -1) for b in (1, -1)]
    x = np.array(moves)
    drop = profile.cache[best].value - np.array(profile.ask([tuple((best + h * step).tolist()) for step in x]))
    x, weight = x[:, inner], 1.0 / (1.0 + np.abs(drop))
    pairs = list(combinations_with_replacement(range(len(inner)), 2))
    columns = np.column_stack([np.ones(len(x)), x, *(x[:, i] * x[:, j] for i, j in pairs)])
    coefficients = np.linalg.lstsq(weight[:, None] * columns, weight * np.expm1(2 * drop / N), rcond=None)[0]
    slope, B = coefficients[1 : len(inner) + 1], np.zeros((len(inner), len(inner)))
    for (i, j), value in zip(pairs, coefficients[len(inner) + 1 :], strict=True):
        B[i, j] += value
        B[j, i] += value
    if np.linalg.eigvalsh(B)[0] <= 0:
        widening[inner] = np.inf
        return peak, widening
    inverse = np.linalg.inv(B)
    peak[inner] = np.array(best)[inner] - h[inner] * (inverse @ slope)
    widening[inner] = np.sqrt(np.diag(inverse) * np.diag(B))
    return peak, widening


def _results(
    profile: Profile, best: Delays, slices: list[Slice], peak: Floats, widening: Floats
) -> tuple[list[ChannelDelay], list[str]]:
    """Return delays in seconds with their intervals, and sentences."""
    dt, out, remarks, rounding = profile.playback.clock.dt, [], [], _rounding(profile)
    for c, (name, channel) in enumerate(profile.playback.survey.channels.items()):
        s, first, last = slices[c], int(profile.low[c]), int(profile.high[c])
        scale = widening[c] if np.isfinite(widening[c]) else 1.0
        low, high = (peak[c] + widening[c] * (end - s.peak) for end in (s.low, s.high))
        low = max(low, first) if np.isfinite(low) else first
        high = min(high, last) if np.isfinite(high) else last
        ends = np.array([low, np.clip(peak[c], first, last), high, first, last]) * dt + rounding[c]
        shortest = -channel.delays.least  # with a shorter delay a sample would be taken after it arrived
        if first * dt - dt < shortest:
            ends[[0, 3]] = np.where(ends[[0, 3]] <= first * dt + rounding[c], shortest, ends[[0, 3]])
        ends = (np.maximum(ends, shortest) + 0.0).tolist()
        channel_delay = ChannelDelay(
            channel=name,
            estimate=ends[1],
            low=ends[0],
            high=ends[2],
            at_end="low" if best[c] == first else "high" if best[c] == last else "",
            search_range=(ends[3], ends[4]),
            delays=(ends[1] + scale * dt * (s.ticks - s.peak)).tolist(),
            drops=s.drops.tolist(),
        )
        out.append(channel_delay)
        remarks += _remarks(channel_delay, dt)
    ambiguous = [delay.channel for delay, factor in zip(out, widening, strict=True) if factor > APART]
    if ambiguous:
        remarks.append(
            f"{' and '.join(ambiguous)}: the recording determines the differences of these delays, but hardly each delay; "
            "record an input that moves the plant."
        )
    return out, remarks


def _remarks(delay: ChannelDelay, dt: float) -> list[str]:
    """Return sentences on one delay."""
    name, out, (first, last) = delay.channel, [], delay.search_range
    if delay.low <= first and delay.high >= last:
        out.append(
            f"{name}: the recording does not determine the delay: the interval is the whole search range; record more, "
            "or with inputs that move the plant."
        )
    elif delay.at_end == "high":
        out.append(
            f"{name}: the most likely delay is the longest that was searched, {last:.4g} s; give a larger --max-delay."
        )
    elif delay.at_end == "low":
        out.append(
            f"{name}: the most likely delay is the shortest that is possible, {first:.4g} s: with a shorter one a sample "
            "would be taken after it arrived, or be farther from its stamp than --max-delay."
        )
    if delay.high - delay.low < dt:
        out.append(
            f"{name}: the interval of the delay is narrower than a tick of {dt:g} s: it is interpolated between ticks."
        )
    return out


def _rounding(profile: Profile) -> Floats:
    """Return the mean of timestamp minus tick of each channel, less the same of the inputs, [q] s."""
    clock, log, q = profile.playback.clock, profile.playback.log, len(profile.low)

    def beyond(times: Floats) -> Floats:
        return times - clock.start - clock.dt * clock.ticks(times)

    sums, many = np.zeros(q), np.zeros(q)
    for b in profile.batches:
        arrived = np.isfinite(b.arrived)
        sums += np.bincount(b.channel[arrived], beyond(b.sampled[arrived]), q)
        many += np.bincount(b.channel[arrived], minlength=q)
    inputs = [beyond(rows.t) for rows in log.inputs.read()] if log.inputs else []
    return sums / np.maximum(many, 1) - (float(np.concatenate(inputs).mean()) if inputs else 0.0)
