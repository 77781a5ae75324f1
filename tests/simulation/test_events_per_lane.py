"""Lanes on schedules of their own: each gets its own samples, has the reference's numbers, and the same bits among any others.

Of forty lanes sixteen are taken out at once here (`random_schedules.CHUNK`), so events of one tick come in up to three parts.
"""

from functools import cache, partial

import hurried
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, LINEAR, Case, context_of, inputs, problem, starts
from reference import irregular as reference
from reference import linear as by_hand

from pcbench.engine import event_loop, random_schedules, runner
from pcbench.observers import OBSERVERS
from pcbench.protocols import Observer, Plant
from pcbench.simulation import rng
from pcbench.simulation.schedule import random_times
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.sampling import Clock
from pcbench.simulation.types import GridPointParams, Layout

WIDE = 40
QUICK = hurried.options()
CLOCK_TIMES = jax.jit(random_times.clock_times, compiler_options=QUICK)
TIMES = random_times.clock_params


@pytest.fixture(scope="module", autouse=True)
def small_chunks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(random_schedules, "CHUNK", 16)
        yield


def times_of(clocks, ticks, channels, error):
    """One shape for every period."""
    return random_times.pad_clock_params(TIMES(clocks, ticks, channels, error), ticks + 20)


def samples_of(clocks, ticks, channels, seed):
    """`random_times.draw_samples`, compiled once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(random_times, "clock_params", times_of)
        patch.setattr(random_times, "clock_times", CLOCK_TIMES)
        return random_times.draw_samples(clocks, ticks, channels, 0, seed)


# an observer that keeps accounts

PRIME, BASE = 1_000_003.0, 8191.0  # every product is a multiple of 1/4 below 2^53: exact


def fold_digest(digest, numbers):
    """Equal for equal numbers in an equal order."""
    for number in numbers:
        digest = (digest * BASE + number + 1) % PRIME
    return digest


def account(gains, memory, now, arrival):
    """Count and sum what arrives on each channel, and digest all that is said of it."""
    came = arrival.mask * 1.0
    said = (
        now.tick * 1.0,
        arrival.age * 1.0,
        arrival.index * 1.0,
        arrival.snapshot[0],
        arrival.ticks_since_arrival * 1.0,
    )
    return {
        "tick": memory["tick"],
        "sampled": memory["sampled"],
        "count": memory["count"] + came,
        "ages": memory["ages"] + came * arrival.age,
        "indices": memory["indices"] + came * arrival.index,
        "values": memory["values"] + came * (arrival.index + 1) * arrival.value,
        "digest": jnp.where(arrival.mask, fold_digest(memory["digest"], said), memory["digest"]),
        "order": fold_digest(memory["order"], [came @ jnp.array([1.0, 2.0, 4.0])]),
    }


def digest_samples(gains, memory, now, mask):
    """Digest which channels are sampled at which tick."""
    return memory | {
        "sampled": fold_digest(memory["sampled"], [now.tick * 1.0, (mask * 1.0) @ jnp.array([1.0, 2.0, 4.0])])
    }


ACCOUNTS = ("count", "ages", "indices", "digest", "values")
SPY = Observer(
    init=lambda gains, xhat0: (
        {k: jnp.zeros(3) for k in ACCOUNTS} | {k: jnp.zeros(()) for k in ("sampled", "order", "tick")}
    ),
    snapshot=lambda gains, memory, now: memory["tick"][None] + 0.25,
    jump=account,
    flow=lambda gains, memory, now: memory | {"tick": memory["tick"] + 1.0},
    on_sample=digest_samples,
    estimate=lambda gains, memory: jnp.concatenate(
        [memory["sampled"][None], memory["order"][None], *(memory[k] for k in ACCOUNTS)]
    ),
)
STATES = 2 + 3 * len(ACCOUNTS)
CLOCKWORK = Plant(step=lambda params, now, x: x, output=lambda params, now, x: now.tick + jnp.array([0.0, 1e3, 2e3]))
NOISE = np.array([0.3, 0.5, 0.7])
PAIRS = {  # channels 0 and 2 are one clock's
    "nothing random but losses": [Clock((0, 2), 7, 4, loss=0.3), Clock((1,), 5, None, "sine", loss=0.5)],
    "sampling_jitter": [Clock((0, 2), 9, None, "uniform", 2), Clock((1,), 6, 3, (5, 8, 6), 2)],
    "disorder and loss": [Clock((0, 2), 5, 2, "uniform", 1, 25, 0.2), Clock((1,), 4, None, "periodic", 1, 30, 0.4)],
    "together": [Clock((0, 2), 6, 4, loss=0.3), Clock((1,), 3, 4, delay_jitter=3, loss=0.2)],
    "always": [Clock((0, 2), 1, 3, "periodic", 0, 2), Clock((1,), 1, 0, "periodic", 0, 2)],
}


@partial(jax.jit, compiler_options=QUICK)
def noise_of(seed):
    return rng.measurement_noise(0, seed, 100, 3)


def reference_digest(clocks, ticks, error, seed):
    """What the accounts of one run must say at tick N - 1, from its samples."""
    found = samples_of(clocks, ticks, 3, seed)
    noise = np.asarray(noise_of(seed))
    came, on_sample = {}, {}
    for s in found:
        if s.tick < ticks:
            on_sample.setdefault(s.tick, []).append(s.channel)
        if s.arrives < ticks:
            came.setdefault((s.arrives, s.tick), []).append(s)
    count, ages, indices, digest, values = np.zeros((len(ACCOUNTS), 3))
    order, last, sampled = 0.0, (0, 0), 0.0
    for taken, channels in sorted(on_sample.items()):
        sampled = fold_digest(sampled, [taken, sum(2**j for j in channels)])
    for (arrives, taken), packet in sorted(came.items()):
        last = last if arrives == last[1] else (last[1], arrives)
        believed = max(taken - error, 0)
        for s in packet:
            j, number = s.channel, s.number
            count[j] += 1
            ages[j] += arrives - believed
            indices[j] += number
            said = (arrives, arrives - believed, number, believed + 0.25, arrives - last[0])
            digest[j] = fold_digest(digest[j], said)
            values[j] += (number + 1) * (taken + 1e3 * j + NOISE[j] * noise[j, number])
        order = fold_digest(order, [sum(2**s.channel for s in packet)])
    return np.concatenate([[sampled, order], count, ages, indices, digest, values])


@cache
def spying(width):
    layout = Layout(CLOCKWORK, (("spy", SPY),), width, 128, False, False)
    run = lambda p, seeds: event_loop.simulate(layout, p, jnp.asarray(0), seeds).final["spy"]  # noqa: E731
    return jax.jit(run, compiler_options=QUICK)


@pytest.mark.parametrize("error", [0, 13, -1])
@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("width", [pytest.param(8, marks=pytest.mark.nightly), WIDE])
def test_every_run_is_delivered_exactly_its_own_samples(width, name, error):
    ticks, clocks = 90, PAIRS[name]
    if error < 0:  # no age may fall below 0
        clocks = [clock._replace(delay=(clock.delay or 0) + 1) for clock in clocks]
    assert random_times.room(clocks, ticks, error) <= 128
    zero = np.zeros(STATES)
    p = GridPointParams(
        (), {"spy": ()}, times_of(clocks, ticks, 3, error), np.zeros((ticks + 1, 1)), np.asarray(1.0),
        zero, zero, np.eye(STATES), NOISE, zero, np.asarray(np.inf),
        np.array([[0, 30], [30, ticks - 1], [ticks - 1, ticks]]),
    )  # fmt: skip
    seeds = np.random.default_rng(width).integers(0, 1000, width)
    got = -np.asarray(spying(width)(jax.tree.map(np.asarray, p), seeds))
    want = np.stack([reference_digest(clocks, ticks, error, seed) for seed in seeds[:8]], -1)
    np.testing.assert_array_equal(got[:-3, :8], want[:-3])
    np.testing.assert_allclose(got[-3:, :8], want[-3:], rtol=1e-12, err_msg="the noise is not that of the sample")
    assert want[2:5].min() > 3, "something arrives on every channel of every run"


# pcbench's observers on the cart

CASE = Case(CART, 30, 30, ticks=300, noise_std=0.3, x0=[5.0, 10.0], xhat0=[1.0, 0.0])
CLOCKS = {
    "sampling_jitter": Clock((0,), 30, None, "uniform", 5),
    "loss": Clock((0,), 30, 25, "sine", loss=0.4),
    "disorder": Clock((0,), 30, 20, "periodic", 5, 45, 0.2),
}
OPTIONS = {"pccebo": {}, "pco": {"Kp": -61.0}, "pi-pco": {"Kp": -61.0, "Ki": 12.2}, "kf": {}}  # model-only never jumps
MORE = ("eso", "super-twisting", "finite-time", "interval")  # a perfect start alone
OPTIONS |= {
    "eso": {},
    "super-twisting": {},
    "interval": {},
    "finite-time": {"samples": 8},
}  # few samples amplify rounding
RUN = ("pccebo", "pi-pco", "kf")  # pco is pi-pco with other numbers: the same program
PROGRAMS = {2: ("pi-pco", "kf"), 1: ("pccebo", "pi-pco")}  # devices: who runs there; both run pi-pco


@cache
def gains_of():
    """One design for all clocks: for their mean interval, with room for the most disorder of them."""
    most = max(random_times.max_oosm_lag([clock], CASE.ticks) for clock in CLOCKS.values())
    known = context_of(CASE)._replace(oosm_lag=most)
    return {o: OBSERVERS[o].design(known, OBSERVERS[o].options(**given)).gains for o, given in OPTIONS.items()}


def job(clock, seeds, error=0, swap=False, observers=RUN, **numbers):
    """Some runs on one clock; with `swap` pi-pco has the numbers of pco."""
    _, p = problem(CASE, {})
    gains = {o: gains_of()["pco" if swap and o == "pi-pco" else o] for o in observers}
    times = times_of([CLOCKS[clock]], CASE.ticks, 1, error)
    p = p._replace(gains=gains, schedule=times, **{k: np.asarray(v) for k, v in numbers.items()})
    return runner.Job(jax.tree.map(np.asarray, p), 0, np.asarray(seeds))


def outcomes(jobs, devices, observers=None):
    """What each job leaves: by observer, streams and last error with arrays [..., L]."""
    names = observers or PROGRAMS[devices]
    each = tuple((o, OBSERVERS[o].observer) for o in names)
    layout = Layout(LINEAR, each, WIDE, 32, False, False)
    jobs = [j._replace(problem=j.problem._replace(gains={o: j.problem.gains[o] for o in names})) for j in jobs]
    done = runner.run(layout, jobs, devices)
    return [{o: (out.streams[o], out.final[o]) for o in names} for _, out in done]


def everyone(jobs):
    """The same for all observers."""
    return [a | b for a, b in zip(*(outcomes(jobs, devices) for devices in PROGRAMS), strict=True)]


def same(a, b):
    """Bit for bit."""
    for (path, x), y in zip(jax.tree.leaves_with_path(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y, err_msg=jax.tree_util.keystr(path))


def lanes(out, which):
    """Some of the runs."""
    return jax.tree.map(lambda a: a[..., which], out)


@pytest.fixture(scope="module")
def block():
    """Forty runs on each clock."""
    clocks = list(CLOCKS)
    return dict(zip(clocks, everyone([job(clock, np.arange(WIDE)) for clock in clocks]), strict=True))


@pytest.mark.nightly
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_run_has_the_same_bits_alone_among_others_and_in_another_order(block, clock):
    order = np.random.default_rng(1).permutation(WIDE)
    others = np.array([900, 7, 901, 23])
    alone, shuffled, among = everyone([job(clock, seeds) for seeds in ([7], order, others)])
    same(lanes(block[clock], [7]), alone)
    same(lanes(block[clock], order), shuffled)
    same(lanes(block[clock], [7, 23]), lanes(among, [1, 3]))
    for _, final in block[clock].values():
        assert len(set(final[0])) == WIDE, "every run has its own numbers"


@pytest.mark.nightly
def test_one_device_has_the_bits_of_two_whoever_else_runs():
    """Three jobs on two devices: the last call has one of them twice."""
    jobs = [job(clock, np.arange(WIDE)) for clock in CLOCKS]
    for one, two in zip(outcomes(jobs, 1), outcomes(jobs, 2), strict=True):
        same(one["pi-pco"], two["pi-pco"])


@pytest.mark.nightly
def test_one_device_has_the_bits_of_two_for_every_observer(block):
    for devices in (1, 2):
        for clock, got in zip(CLOCKS, outcomes([job(c, np.arange(WIDE)) for c in CLOCKS], devices, RUN), strict=True):
            same({o: block[clock][o] for o in RUN}, got)


@pytest.mark.nightly  # test_variable_sampling has the reference for every observer
@pytest.mark.parametrize("clock", CLOCKS)
def test_every_run_has_the_numbers_of_the_reference(block, clock):
    model, u = by_hand.Model(CART.A, CART.B, CART.C, CASE.h), inputs(CASE)
    x0, xhat0 = starts(CASE)
    for seed in (0, 33):
        found = samples_of([CLOCKS[clock]], CASE.ticks, 1, seed)
        times = [(s.tick, None if s.arrives == NEVER else s.arrives) for s in found]
        noise = [CASE.noise_std * np.asarray(noise_of(seed))[0]]
        x, samples = reference.simulate(model, u, x0, [times], noise)
        g = gains_of()
        want = {
            "pccebo": reference.pccebo(model, u, samples, xhat0, g["pccebo"].L),
            "pi-pco": reference.pco(model, u, samples, xhat0, g["pi-pco"].T, g["pi-pco"].Kp, g["pi-pco"].Ki),
            "kf": reference.kf(model, u, samples, xhat0, context_of(CASE).P0, g["kf"].R),
        }
        for name, xhat in want.items():
            e, (stream, final) = (x - xhat)[:-1], lanes(block[clock][name], seed)
            np.testing.assert_allclose(final, e[-1], rtol=0, atol=1e-10 * np.abs(x).max())
            np.testing.assert_allclose(stream.absolute.sum(0), np.abs(e).sum(0), rtol=1e-9)
            np.testing.assert_allclose(stream.peak.max(0), np.abs(e).max(0), rtol=1e-9)


@cache
def streams_of():
    """The streams of all observers, compiled in a hurry."""
    layout = Layout(LINEAR, tuple((o, OBSERVERS[o].observer) for o in (*RUN, *MORE)), WIDE, 32, False, False)
    run = lambda p, seeds: event_loop.simulate(layout, p, jnp.asarray(0), seeds).streams  # noqa: E731
    return jax.jit(run, compiler_options=QUICK)


def peaks(clock, **numbers):
    """The largest error of each observer over all runs and ticks, relative to the largest state."""
    start = {"x0": CASE.x0, "xhat0": CASE.x0, "noise_std": [0.0], "observers": (*RUN, *MORE)} | numbers
    jobs = [job(clock, np.arange(WIDE), swap=swap, **start) for swap in (False, True)]
    found, swapped = (streams_of()(each.problem, each.seeds) for each in jobs)
    found["pco"] = swapped["pi-pco"]
    return {name: np.asarray(stream.peak).max() / max(CASE.x0) for name, stream in found.items()}


@pytest.mark.ci
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_perfect_start_is_zero_for_every_observer_that_knows_its_schedule(clock):
    found = peaks(clock)
    assert set(found) >= {o for o, entry in OBSERVERS.items() if entry.knows_schedule and entry.takes == "one clock"}
    assert max(found.values()) < 1e-12


@pytest.mark.ci
@pytest.mark.parametrize("error", [-1, 1])
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_tick_of_slip_in_what_is_believed_is_caught(clock, error):
    assert min(peaks(clock, error=error).values()) > 1e-4
