"""Clocks drawn by hypothesis, and the oracle of their samples: a clock's own words, sample by sample, over the same draws."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st

from pcbench.simulation import rng
from pcbench.simulation.schedule import event_table, random_times, sampling
from pcbench.simulation.schedule.common_times import NEVER, Sample
from pcbench.simulation.schedule.sampling import Clock, Stamp

ROOM = 128  # samples a clock: one shape for every example
SEEDS = 8
LONGEST = 100  # ticks
QUICK = {"xla_backend_optimization_level": 0}  # whole numbers come out the same, compiled five times as fast
AGENDA = jax.jit(event_table.event_table, compiler_options=QUICK)
CLOCK_TIMES = jax.jit(random_times.clock_times, compiler_options=QUICK)
TIMES = random_times.clock_params


def roomy(*given):
    """`random_times.clock_params` in one shape for every horizon and period; that it changes nothing is tested below."""
    return random_times.pad_clock_params(TIMES(*given), ROOM + 1)


def draw_samples(clocks, ticks, seed, root=0, times=roomy):
    """`random_times.draw_samples`, compiled once for each number of clocks and channels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(random_times, "clock_params", times)
        patch.setattr(random_times, "clock_times", CLOCK_TIMES)
        return random_times.draw_samples(clocks, ticks, width(clocks), root, seed)


def width(clocks):
    return sum(len(clock.channels) for clock in clocks)


# the oracle: a clock's own words, sample by sample


@partial(jax.jit, compiler_options=QUICK)
def uniform_numbers(root, seed, channel):
    """Interval, instant, delay, loss, step of the delay of each sample, stamp of each tick [ROOM + 1, 6]: the addresses."""
    run = jax.random.fold_in(jax.random.key(root), seed)

    def numbers(stream, many, i):
        key = jax.random.fold_in(jax.random.fold_in(run, rng.STREAMS[stream]), channel)
        return jax.random.uniform(jax.random.fold_in(key, i), (many,), dtype=jnp.float64)

    many = {"jitter": 3, "loss": 1, "delay_chain": 1, "stamp": 1}
    return jax.vmap(lambda i: jnp.concatenate([numbers(s, n, i) for s, n in many.items()]))(jnp.arange(ROOM + 1))


def shortest(clock):
    """The shortest interval before jitter, over any horizon."""
    if isinstance(clock.profile, tuple):
        return min(clock.profile)
    if clock.profile == "sine":
        return min(sampling.interval(clock, i) for i in range(1, ROOM + 1))
    return max(1, (clock.period + 1) // 2) if clock.profile == "uniform" else clock.period


def chain(clock, uniform):
    """The step of each sample's delay: by how often it is there in the long run, then from one to the next."""
    many = len(clock.delay_values)
    if not many:
        return [0] * len(uniform)
    if clock.delay_weights:
        return [clock.delay_values[min(int(np.sum(u >= np.cumsum(clock.delay_weights))), many - 1)] for u in uniform]
    moves = np.array(
        [
            [p if i == j else (1 - p) / (many - 1) for j in range(many)]
            for i, p in enumerate(clock.delay_self_transition)
        ]
    )
    share = np.linalg.matrix_power(moves + 1e-3 * (np.eye(many) - moves), 2**40)[0]  # lazier, so that it forgets
    now = int(np.searchsorted(np.cumsum(share)[:-1], uniform[0], side="right"))
    out = [clock.delay_values[now]]
    for u in uniform[1:]:
        stay = clock.delay_self_transition[now]
        if u >= stay:
            others = [(now + 1 + k) % many for k in range(many - 1)]
            now = others[int((u - stay) / (1 - stay) * (many - 1))]
        out.append(clock.delay_values[now])
    return out


def one_clock(clock, ticks, root, seed):
    """(taken, arrives) of every sample taken at tick 0 .. `ticks`."""
    u = np.asarray(uniform_numbers(root, seed, clock.channels[0])).tolist()
    due, taken, out = clock.phase, [clock.phase], []
    for i in range(1, ROOM + 1):
        if clock.profile == "uniform":
            low, high = shortest(clock), max(shortest(clock), 3 * clock.period // 2)
            due += low + int(u[i][0] * (high - low + 1))
        elif clock.profile == "sine":
            due += max(1, round(clock.period * (1 + 0.5 * np.sin(0.6 * i))))
        else:
            due += clock.period if clock.profile == "periodic" else clock.profile[(i - 1) % len(clock.profile)]
        taken.append(due + int(u[i][1] * (2 * clock.jitter + 1)) - clock.jitter)
    steps, lost = chain(clock, [each[4] for each in u]), False
    for i in range(ROOM):
        late = int(u[i][2] * (clock.delay_jitter + 1)) + steps[i]
        arrives = (taken[i + 1] if clock.delay is None else taken[i] + clock.delay) + late
        lost = u[i][3] < chance(clock, lost if i else None)
        interrupted = clock.outage[0] <= taken[i] < clock.outage[1]
        if taken[i] <= ticks:
            out.append((taken[i], NEVER if lost or interrupted else arrives))
    return out


def chance(clock, lost_before):
    """That a sample is lost, after one that was or was not (None: it is the first)."""
    if not clock.burst or lost_before is None:
        return clock.loss
    return 1 - 1 / clock.burst if lost_before else clock.loss / ((1 - clock.loss) * clock.burst)


def ahead(clocks, root, seed):
    """By how much the stamp of what is taken at each tick is later than that."""
    offset, drift, jitter = clocks[0].stamp
    u = np.asarray(uniform_numbers(root, seed, 0))[:, 5]
    return [offset + round(drift * k) + int(u[k] * (2 * jitter + 1)) - jitter for k in range(ROOM + 1)]


def every_sample(clocks, ticks, root, seed):
    late = ahead(clocks, root, seed)
    return [
        Sample(j, i, taken, arrives, late[taken])
        for clock in clocks
        for i, (taken, arrives) in enumerate(one_clock(clock, ticks, root, seed))
        for j in clock.channels
    ]


@st.composite
def any_clock(draw, channels):
    profile = draw(st.sampled_from(["periodic", "sine", "uniform", "list"]))
    each = st.integers(1, 30)
    period = draw(each)
    if profile == "list":
        profile = tuple(draw(st.lists(each, min_size=1, max_size=4)))
    delay = draw(st.none() | st.integers(0, 40))
    clock = Clock(channels, period, delay, profile)
    return clock._replace(
        jitter=draw(st.integers(0, (shortest(clock) - 1) // 2)),
        delay_jitter=draw(st.sampled_from([0, 0, 1, 7, 30])),
        loss=draw(st.sampled_from([0.0, 0.0, 0.3, 0.9, 1.0])),
        phase=draw(st.sampled_from([0, 0, 1, 13])),
        outage=draw(st.sampled_from([(0, 0), (0, 0), (10, 45)])),
    )


@st.composite
def any_clocks(draw):
    steps = {"delay_values": (4, 25, 1)}
    chained, shared = steps | {"delay_self_transition": (0.0, 0.5, 0.9)}, steps | {"delay_weights": (0.2, 0.3, 0.5)}
    pair, one_of_two = (
        {"delay_values": (0, 9), "delay_self_transition": (0.3, 0.8)},
        {"delay_values": (3, 7), "delay_weights": (0.4, 0.6)},
    )
    laws = [[{}], [{}], [chained], [shared], [chained, pair], [pair, {}], [chained, one_of_two], [one_of_two, chained]]
    channels = draw(st.sampled_from([[(0,)], [(0, 1)], [(0,), (1,)], [(0, 2), (1,)]]))
    law = draw(st.sampled_from(laws))
    clocks = [draw(any_clock(each))._replace(**law[j % len(law)]) for j, each in enumerate(channels)]
    return with_faults(draw, clocks) if any("delay_weights" in each for each in law) else clocks


def with_faults(draw, clocks):
    """Losses in bursts, and stamps that stay in order and before arrivals."""
    stamp = draw(st.sampled_from([Stamp(-3, -0.06, 2), Stamp(2, 0.02, 1), Stamp(0, -0.1, 0)]))
    if 2 * stamp.jitter >= 0.9 * min(shortest(c) - 2 * c.jitter for c in clocks) - 1:
        stamp = stamp._replace(jitter=0)
    if stamp.max_errors(LONGEST)[1] > youngest(clocks):
        stamp = Stamp(-1)
    return [c._replace(stamp=stamp, burst=9.5, loss=min(c.loss, 0.9) or 0.1) for c in clocks]


def youngest(clocks):
    return min(shortest(c) - 2 * c.jitter if c.delay is None else c.delay for c in clocks)


def delay_errors(data, clocks):
    """A delay error that leaves every age at 0 or more."""
    least = max(youngest(clocks) - clocks[0].stamp.max_errors(LONGEST)[1], 0)
    return data.draw(st.sampled_from([0, 0, -least, 1, 25]))


ticks_of = st.integers(1, LONGEST)
seed_of = st.integers(0, 2**31 - 1)
