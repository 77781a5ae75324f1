"""Random sampling: each run draws its own sampling instants, arrivals and losses.

Sample i of clock c uses these uniform numbers, addressed as all draws are, under the clock's first channel:

- stream `jitter`: three numbers, for its interval, its instant and its delay
- stream `loss`: one number
- stream `delay_chain`: one number
- stream `stamp`: one number for the timestamp error, addressed by the sampling tick and common to all clocks

So a change of one setting leaves the other draws alone. If the delay is a Markov chain over m values, the first sample is drawn
from the stationary distribution. Each next sample keeps its value with a given probability; else all other values are equally
likely. If losses come in bursts, the probability of a loss depends on whether the previous sample was lost.
All times are whole ticks. `ClockParams` is traced, so one compiled program covers every pattern, jitter, delay and loss.
"""

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import PyTree
from numpy.typing import NDArray

from pcbench.protocols import Leaf
from pcbench.simulation import rng
from pcbench.simulation.schedule import sampling
from pcbench.simulation.schedule.common_times import NEVER, Sample
from pcbench.simulation.schedule.sampling import Clock


class ClockParams(NamedTuple):
    """Parameters of C clocks, all traced. At most M samples per clock, q channels; times in ticks."""

    due: Leaf  # [C, M+1] instants before jitter, if intervals are not random
    low: Leaf  # [C] smallest random interval
    high: Leaf  # [C] largest random interval; 0: intervals are not random
    delay: Leaf  # [C]; -1: one interval
    jitter: Leaf  # [C] of the sampling instant
    delay_jitter: Leaf  # [C] jitter of the delay
    delay_values: Leaf  # [C, m] additional delays, of which each sample has one; m = 0: none
    n_delay_values: Leaf  # [C] how many of the m additional delays a clock has
    delay_self_transition: Leaf  # [C, m] probability that the next sample has the same one; m = 0: no clock has a chain
    delay_cdf: Leaf  # [C, m] cumulative probability of independent additional delays; 0: a chain; m = 0: all are chains
    loss: Leaf  # [C] probability of a loss
    bursts: Leaf  # [C, 2] probability of a loss after a received and after a lost sample; [C, 0]: the same
    outages: Leaf  # [C, 2] first tick and end of an outage, in which all samples are lost; [C, 0]: none
    channel: Leaf  # [C] first channel: address of the clock's draws
    clock_of: Leaf  # [q] the clock of each channel
    error: Leaf  # assumed age minus true age of a sample
    stamp: PyTree = ()  # Stamp, if timestamps are wrong


def clock_params(clocks: list[Clock], ticks: int, channels: int, error: int) -> ClockParams:
    """Return the parameters of clocks for a number of ticks."""
    count = max(_max_samples(clock, ticks) for clock in clocks) + 1
    due = np.full((len(clocks), count), NEVER)
    names = "delay_values", "delay_self_transition", "delay_weights"
    has_values, has_chain, has_weights = (any(map(attrgetter(name), clocks)) for name in names)
    limits = [sampling.uniform_range(c.period) if c.profile == "uniform" else (0, 0) for c in clocks]
    for row, clock in zip(due, clocks, strict=True):
        instants = sampling.instants(clock, ticks + clock.jitter)
        row[: len(instants)] = instants
    counts = [len(c.delay_values) or int(has_values) for c in clocks]
    weights = [c.delay_weights or (float(not c.delay_self_transition),) for c in clocks]
    clock_of = [next(i for i, c in enumerate(clocks) if j in c.channels) for j in range(channels)]
    return ClockParams(
        due=due,
        low=np.array([low for low, _ in limits]),
        high=np.array([high for _, high in limits]),
        delay=np.array([-1 if c.delay is None else c.delay for c in clocks]),
        jitter=np.array([c.jitter for c in clocks]),
        delay_jitter=np.array([c.delay_jitter for c in clocks]),
        delay_values=_pad_rows([c.delay_values or (0,) * has_values for c in clocks], max(counts), "edge").astype(int),
        n_delay_values=np.array(counts),
        delay_self_transition=_pad_rows([c.delay_self_transition or (0.0,) for c in clocks], max(counts) * has_chain),
        delay_cdf=np.cumsum(_pad_rows(weights, max(counts) * has_weights), 1),
        loss=np.array([c.loss for c in clocks], float),
        bursts=np.array(
            [sampling.loss_probabilities(c) if any(c.burst for c in clocks) else () for c in clocks], float
        ),
        outages=np.array([c.outage if any(any(c.outage) for c in clocks) else () for c in clocks], int),
        channel=np.array([c.channels[0] for c in clocks]),
        clock_of=np.array(clock_of),
        error=np.asarray(error),
        stamp=jax.tree.map(np.asarray, clocks[0].stamp) if any(clocks[0].stamp) else (),
    )


def _pad_rows(
    rows: list[tuple[float, ...]], width: int, mode: Literal["constant", "edge"] = "constant"
) -> NDArray[np.float64]:
    """Return rows of `width` numbers, padded with 0 or with the last number of each row."""
    return np.array([np.pad(row, (0, width - len(row)), mode) if width else () for row in rows], float)


def _max_samples(clock: Clock, ticks: int) -> int:
    """Return the largest number of samples that a clock takes at ticks 0 .. `ticks`."""
    if clock.profile == "uniform":
        return (ticks + clock.jitter) // sampling.uniform_range(clock.period)[0] + 1
    return len(sampling.instants(clock, ticks + clock.jitter)) - 1


def pad_clock_params(t: ClockParams, samples: int, values: int = 0) -> ClockParams:
    """Pad with instants that never come and with repeated delay values, so that the clocks of one study have one shape."""
    n_missing = samples - t.due.shape[1]
    t = t._replace(due=np.pad(t.due, [(0, 0), (0, n_missing)], constant_values=NEVER))
    if not (count := t.delay_cdf.shape[1]):
        return t
    width, stay = [(0, 0), (0, max(values - count, 0))], t.delay_self_transition
    return t._replace(
        delay_values=np.pad(t.delay_values, width, "edge"),
        delay_self_transition=np.pad(stay, width) if stay.shape[1] else stay,
        delay_cdf=np.pad(t.delay_cdf, width, "edge"),
    )


def clock_times(t: ClockParams, c: int, root_seed: Array, seeds: Array) -> tuple[Array, Array]:
    """Return the sampling tick and the arrival tick (NEVER: lost) of every sample of clock c, [M, L] each."""
    count = t.due.shape[1]
    timing = rng.uniforms(root_seed, seeds, "jitter", t.channel[c], count, 3)
    loss = rng.uniforms(root_seed, seeds, "loss", t.channel[c], count, 1)
    interval = t.low[c] + _integers_below(timing[:, 0], t.high[c] - t.low[c] + 1)
    random = jnp.cumsum(jnp.concatenate([jnp.full_like(interval[:1], t.due[c, 0]), interval[1:]]), 0)
    due = jnp.where(t.high[c] > 0, random, t.due[c][:, None])
    shift = _integers_below(timing[:, 1], 2 * t.jitter[c] + 1) - t.jitter[c]
    instants = due + jnp.where(jnp.arange(count)[:, None] > 0, shift, 0)
    delay = _integers_below(timing[:, 2], t.delay_jitter[c] + 1)
    if t.delay_values.shape[1]:
        delay = delay + t.delay_values[c][_delay_index(t, c, root_seed, seeds)]
    arrives = jnp.where(t.delay[c] < 0, instants[1:], instants[:-1] + t.delay[c]) + delay[:-1]
    is_lost = _is_lost(t, c, loss[:-1, 0])
    if t.outages.shape[1]:
        is_lost |= (instants[:-1] >= t.outages[c, 0]) & (instants[:-1] < t.outages[c, 1])
    return instants[:-1], jnp.where(is_lost, NEVER, jnp.minimum(arrives, NEVER))


def _is_lost(t: ClockParams, c: int, uniform: Array) -> Array:
    """Return which samples of clock c are lost, [M, L]; the probability depends on whether the previous sample was lost."""
    first = uniform < t.loss[c]
    if not t.bursts.shape[1]:
        return first

    def step(was_lost: Array, u: Array) -> tuple[Array, Array]:
        is_lost = u < jnp.where(was_lost, t.bursts[c, 1], t.bursts[c, 0])
        return is_lost, is_lost

    return jnp.concatenate([first[:1], lax.scan(step, first[0], uniform[1:])[1]])


def _delay_index(t: ClockParams, c: int, root_seed: Array, seeds: Array) -> Array:
    """Return the index of the additional delay of every sample of clock c, [M+1, L]."""
    uniform = rng.uniforms(root_seed, seeds, "delay_chain", t.channel[c], t.due.shape[1], 1)[:, 0]
    if not t.delay_cdf.shape[1]:
        return _chain(t, c, uniform)
    independent = jnp.searchsorted(t.delay_cdf[c][:-1], uniform, side="right")
    return (
        jnp.where(t.delay_cdf[c][-1] > 0, independent, _chain(t, c, uniform))
        if t.delay_self_transition.shape[1]
        else independent
    )


def _chain(t: ClockParams, c: int, uniform: Array) -> Array:
    """Return the states of a Markov chain driven by uniform numbers, [M+1, L]."""
    m, stay = t.n_delay_values[c], t.delay_self_transition[c]
    weights = jnp.where(jnp.arange(len(stay)) < m, 1 / (1 - stay), 0.0)
    ends = jnp.cumsum(weights / jnp.sum(weights))
    first = jnp.minimum(jnp.sum(uniform[0][None] >= ends[:, None], 0), m - 1)

    def step(state: Array, u: Array) -> tuple[Array, Array]:
        v = (u - stay[state]) / (1 - stay[state])  # given that the chain leaves its state, uniform on [0, 1)
        target = (state + 1 + jnp.clip(_integers_below(v, m - 1), 0, jnp.maximum(m - 2, 0))) % m
        new = jnp.where(u < stay[state], state, target)
        return new, new

    return jnp.concatenate([first[None], lax.scan(step, first, uniform[1:])[1]])


def timestamp(t: ClockParams, root_seed: Array, seeds: Array, instants: Array) -> Array:
    """Return the assumed sampling ticks of samples taken at the ticks `instants`, [E, L]."""
    if not t.stamp:
        return instants - t.error
    key = rng.run_keys(root_seed, seeds, "stamp", 1)
    uniform = lax.map(lambda tick: rng.uniforms_of(key, [tick])[0], instants)
    offset = t.stamp.offset + jnp.round(t.stamp.drift * instants).astype(int)
    return instants - t.error + offset + _integers_below(uniform, 2 * t.stamp.jitter + 1) - t.stamp.jitter


def _integers_below(uniform: Array, n: Array) -> Array:
    return jnp.floor(uniform * n).astype(int)


def draw_samples(clocks: list[Clock], ticks: int, channels: int, root_seed: int, seed: int) -> list[Sample]:
    """Return the samples of one run, as `common_times.samples_of` does for clocks without randomness."""
    t = jax.tree.map(jnp.asarray, clock_params(clocks, ticks, channels, 0))
    out = []
    for c, clock in enumerate(clocks):
        address = jnp.asarray(root_seed), jnp.asarray([seed])
        instants, arrives = clock_times(t, c, *address)
        offset = timestamp(t, *address, instants) - instants
        samples = enumerate(zip(*(a[:, 0].tolist() for a in (instants, arrives, offset)), strict=True))
        out += [Sample(j, i, *times) for i, times in samples if times[0] <= ticks for j in clock.channels]
    return out


def room(clocks: Sequence[Clock], ticks: int, error: int) -> int:
    """Return an upper limit of the packets on the network at one time, for any draws."""
    back = 0
    while (reach := abs(error) + max(clocks[0].stamp.max_errors(ticks + back))) > back:
        back = reach  # a snapshot may be due for a sample taken this long after the last tick; timestamp errors grow
    longest = max(sampling.ages(c, ticks)[1] for c in clocks) + back
    return sum(longest // sampling.intervals(c, ticks)[0] + 1 for c in clocks)


def max_input_age(clocks: list[Clock], ticks: int, oosm_lag: int) -> int:
    """Return an upper limit of the age [ticks] of an input that an observer may need, for any delays.

    It covers the sample before the newest and before all that may arrive out of sequence. If samples are lost, it covers the
    longest burst in 1e12 samples.
    """
    age = max(sampling.ages(c, ticks)[1] for c in clocks)
    interval = max(sampling.intervals(c, ticks)[-1] for c in clocks)
    loss = max(sampling.loss_probabilities(c)[1] for c in clocks)
    burst = math.ceil(math.log(1e-12) / math.log(loss)) if 0 < loss < 1 else ticks * int(loss > 0)
    longest = max(c.outage[1] - c.outage[0] for c in clocks)
    return age + sum(clocks[0].stamp.max_errors(ticks)) + (2 * oosm_lag + 1 + burst) * interval + longest


def max_oosm_lag(clocks: list[Clock], ticks: int) -> int:
    """Return an upper limit of the newer samples that arrive before an older one, at most all others of a run."""
    least = [sampling.intervals(c, ticks)[0] for c in clocks]
    wrong = sum(clocks[0].stamp.max_errors(ticks)) if clocks[0].stamp.drift or clocks[0].stamp.jitter else 0

    def newer(i: int, j: int) -> int:
        if i == j:  # one clock: its ages differ by at most latest - earliest
            spread = clocks[i].max_extra_delay - clocks[i].min_extra_delay
            return max(spread - 1, 0) // least[i]
        span = sampling.ages(clocks[i], ticks)[1] - sampling.ages(clocks[j], ticks)[0] - 1 + wrong
        return span // least[j] + 1 if span >= 1 else 0

    indices = range(len(clocks))
    most = max(sum(_max_samples(c, ticks) for c in clocks) - 1, 0)
    return min(max(sum(newer(i, j) for j in indices) for i in indices), most)
