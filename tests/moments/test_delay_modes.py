"""Exact moments over random delays by a recursion over modes, against every sequence of delays one by one in NumPy."""

import jax
import numpy as np
import pytest
from harness import ODD
from reference import delays, irregular, linear, moments

import pcbench
from pcbench import planning
from pcbench.moments import delay_modes, events
from pcbench.moments.delay_modes import realisations_over_modes
from pcbench.moments.inputs import Mix
from pcbench.moments.realisations import Mode, realisation_over_losses
from pcbench.simulation.schedule import common_times, random_times
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

N, TICK, TE, LATE, STEPS, STAY = 39, 0.02, 7, 3, [0, 16], [0.6, 0.25]
NOISE, X0, XHAT0, PRIOR = [0.3, 0.2], [0.5, -0.2, 0.3], [0.1, 0.1, -0.2], [0.4, 0.3, 0.5]
R = [0.1, 0.05]
L = 0.4 * np.linalg.pinv(ODD.C)
STUDY = {
    "name": "modes",
    "observers": ["kf"],
    "lti": {
        "A": ODD.A.tolist(), "B": ODD.B.tolist(), "C": ODD.C.tolist(), "x0": X0, "xhat0": XHAT0, "prior_std": PRIOR,
        "tick": TICK, "duration": N * TICK, "steady_start": 0.4, "noise_std": NOISE, "sampling_period": TE * TICK,
        "delay": LATE * TICK, "delay_values": [s * TICK for s in STEPS], "delay_self_transition": STAY,
        "states": ["a", "b", "c"], "input": "sine,sawtooth",
    },
    "options": {"kf": {"R": R}},
}  # fmt: skip
SMALL = {
    "name": "small",
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "duration": 3.0,
        "steady_start": 1.0,
        "noise_std": 0.3, "sampling_period": 0.4, "delay": 0.1, "delay_values": [0.0, 0.2], "states": ["a"], "input": "sine",
    },
}  # fmt: skip


def study(observer="kf", **changes):
    given = {k: v for k, v in (STUDY["lti"] | changes).items() if v is not None}
    return STUDY | {
        "observers": [observer],
        "lti": given,
        "options": {k: v for k, v in STUDY["options"].items() if k == observer},
    }


def plan(*given, **changes):
    (p,) = planning.plan(parse.parse(study(*given, **changes), "modes"))
    return p


def estimates(observer, u, samples, xhat0):
    model = linear.Model(ODD.A, ODD.B, ODD.C, TICK)
    if observer == "kf":
        return irregular.kf(model, u, samples, xhat0, np.diag(np.square(PRIOR)), np.array(R))
    return irregular.pccebo(model, u, samples, xhat0, L)


def squares(observer, driven, times):
    """Expected squares [N+1, 3] of the errors on samples (taken, arrival or None) of both channels."""
    model, each = linear.Model(ODD.A, ODD.B, ODD.C, TICK), [times, times]

    def error_of(u, start, xhat0, noise):
        x, samples = irregular.simulate(model, u, start, each, noise)
        return x - estimates(observer, u, samples, xhat0)

    found = moments.error_map(error_of, driven, np.array(X0), np.array(XHAT0), [len(times)] * 2)
    variance = np.diagonal(moments.covariance(found, np.repeat(NOISE, len(times))), axis1=1, axis2=2)
    return found.base**2 + variance


def agrees(observer):
    """Mean squares of a study with their expected value over every sequence of delays; 1e-10: sums in double precision."""
    asked = study(observer)
    asked["options"] = {observer: {"R": R} if observer == "kf" else {"L": L.tolist()}}
    stats = pcbench.exact_moments(asked).stats.set_index(["metric", "signal"])
    driven = pcbench.simulate(asked, "model-only")[["u1", "u2"]].to_numpy()
    taken = list(range(0, N + 1, TE))
    mean = delays.mean_over(STEPS, STAY, taken, LATE, N, lambda times: squares(observer, driven, times))
    np.testing.assert_allclose(stats.loc["mse", "mean"], mean[:N].mean(0), rtol=1e-10)
    np.testing.assert_allclose(stats.loc["steady_mse", "mean"], mean[round(0.4 / TICK) : N].mean(0), rtol=1e-10)
    assert (stats.loc["mse"][["n", "se"]].to_numpy() == 0).all()


@pytest.mark.nightly
def test_a_filter_with_out_of_sequence_samples_is_the_mean_over_every_sequence_of_delays():
    agrees("kf")


@pytest.mark.nightly
def test_an_observer_with_a_gain_of_its_own_is_too():
    agrees("pccebo")


SHAPES = {
    "out of sequence": {},
    "as the next is taken": {"delay_values": [0.0, 0.08]},
    "three": {"delay_values": [0.0, 0.32, 0.1], "delay_self_transition": [0.6, 0.3, 0.5]},
    "uneven": {"sampling_pattern": [0.1, 0.22, 0.14]},
    "jittered": {"delay_values": None, "delay_self_transition": None, "delay_jitter": 0.14},
    "both": {"delay_values": [0.0, 0.1], "delay_self_transition": 0.2, "delay_jitter": 0.02},
}


@pytest.mark.ci
@pytest.mark.parametrize("asked", [False, True], ids=["", "with the last arrival"])
@pytest.mark.parametrize("shape", list(SHAPES))
def test_in_each_interval_a_mode_has_what_every_run_with_these_delays_has(shape, asked, monkeypatch):
    monkeypatch.setattr(delay_modes, "uses_last_arrival", lambda layout, problem: asked)
    monkeypatch.setattr(delay_modes, "MOST_MODES", 5000)
    p = plan(**SHAPES[shape])
    clock = p.cell.times.clocks[0]
    chain, each = delay_modes._chain(clock), realisations_over_modes(p)
    length = round(np.log(len(each)) / np.log(len(chain.delays)))
    for seed in range(3):
        drawn = [s for s in random_times.draw_samples([clock], N, 2, 5, seed) if s.channel == 0]
        true = common_times.schedule(random_times.draw_samples([clock], N, 2, 5, seed), N, 2)
        late = [chain.delays.index(s.arrives - s.tick - clock.delay) for s in drawn]
        for i, s in enumerate(drawn):
            newest = [late[i - j] if i >= j else 0 for j in range(length)]
            mine = each[int(np.ravel_multi_index(newest, [len(chain.delays)] * length))].problem.schedule
            until = drawn[i + 1].tick if i + 1 < len(drawn) else N + 1
            slots = max(mine.arrive.shape[1], true.arrive.shape[1])
            for name in common_times.Schedule._fields:
                if name == "prefilled" or (name == "ticks_since_arrival" and not asked):
                    continue
                a, b = (getattr(common_times.pad_slots(x, slots), name)[s.tick : until] for x in (mine, true))
                if name == "next_event":
                    a, b = np.minimum(a, until), np.minimum(b, until)
                np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.ci
@pytest.mark.parametrize("shape", list(SHAPES))
def test_modes_are_as_often_there_after_a_sample_as_before(shape, monkeypatch):
    monkeypatch.setattr(delay_modes, "MOST_MODES", 5000)
    each = [one.mode for one in realisations_over_modes(plan(**SHAPES[shape]))]
    share, W = np.array([mode.probability for mode in each]), np.zeros((len(each), len(each)))
    for mode in each:
        W[mode.number, list(mode.source)] = mode.weight
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(W.sum(1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(share @ W, share, rtol=1e-12)


def test_what_cannot_be_is_no_mode():
    """A chain that never has the same value twice: of four pairs two are left, each from the other."""
    each = realisations_over_modes(plan(delay_self_transition=0.0, delay_values=[0.0, 0.1]))
    assert [(one.mode.probability, one.mode.source) for one in each] == [(0.5, (1,)), (0.5, (0,))]


NOT = {
    "losses": {"loss": 0.2},
    "instants": {"sampling_jitter": 0.02},
    "stamps": {"timestamp_jitter": 0.02},
    "sensors": {"delay": [LATE * TICK, (LATE + 1) * TICK]},
    "many": {"delay_values": [0.02 * i for i in range(9)], "delay_self_transition": None},
}


@pytest.mark.ci
@pytest.mark.parametrize("why", list(NOT))
def test_what_is_random_besides_or_has_many_modes_is_averaged_over_schedules(why):
    assert realisations_over_modes(plan()) is not None
    assert realisations_over_modes(plan(**NOT[why])) is None


def test_modes_of_several_cells_take_over_each_in_their_own():
    none = np.zeros(1, bool)
    a, b = (
        [Mode(i, 0.5, (1 - i,), (1.0,), none) for i in range(2)],
        [Mode(i, 0.5, (0, 1), (0.3, 0.7), none) for i in range(2)],
    )
    mix = delay_modes.mix_of([*a, *b, b[-1], b[-1]])
    assert mix.source.tolist() == [[1, 0, 2, 2, 2, 2], [1, 0, 3, 3, 3, 3]]
    assert mix.weight.tolist() == [[1.0, 1.0, 0.3, 0.3, 0.3, 0.3], [0.0, 0.0, 0.7, 0.7, 0.7, 0.7]]


def test_modes_that_meet_differ_by_how_much_the_largest_number_does():
    mix = Mix(np.array([[0, 0, 2], [1, 0, 2]]), np.ones((2, 3)), ())
    off = events.mode_differences(mix, np.array([[1.0, 1.0, np.nan], [-4.0, -4.002, 1.0]]))
    np.testing.assert_allclose(off[:2], [0.0005, 0.0], rtol=1e-12)
    assert not off[2] <= 1.0
    assert events.mode_differences(mix, np.array([[3, 4, 5]])).tolist() == [1 / 3, 0.0, 0.0]


RESTLESS = """
import jax.numpy as jnp
from pcbench import Certificate, Design, Observer, ObserverSpec
from pydantic import BaseModel

class Options(BaseModel): pass
def start(gains, xhat0): return xhat0, jnp.asarray(0)
def note(gains, memory, now): return jnp.zeros(0)
def jump(gains, memory, now, arrival):
    x, ages = memory
    share = {share}
    return x + share * jnp.where(arrival.mask[0], arrival.value[0] - x, 0.0), {ages}
def flow(gains, memory, now): return memory[0] * 0.95 + 0.05 * now.u, memory[1]
def estimate(gains, memory): return memory[0]
def design(context, options): return Design((), Certificate("none", 1.0, "none", "as it is", {{}}))
OWN = ObserverSpec(Observer(start, note, jump, flow, estimate), Options, design, False, "as told", "any schedule")
"""


def own(folder, share, ages="ages"):
    (folder / "mine.py").write_text(RESTLESS.format(share=share, ages=ages))
    return SMALL | {"observers": ["own"], "custom_observers": {"own": f"{folder}/mine.py:OWN"}}


def alone(driven, times):
    """Expected squares [N+1] of the error of the observer `own` at a share of 0.3, which takes what comes as of now."""
    ticks, a = len(driven), np.exp(-0.05)
    mean, noise, x = np.zeros(ticks), np.zeros((ticks, len(times))), np.zeros(ticks)
    now, xhat, late = 1.0, 0.5, np.zeros(len(times))
    for k in range(ticks):
        x[k] = now
        for i in sorted(i for i, (_, arrives) in enumerate(times) if arrives == k):
            xhat, late = xhat + 0.3 * (x[times[i][0]] - xhat), 0.7 * late + 0.3 * (np.arange(len(times)) == i)
        mean[k], noise[k] = now - xhat, late
        now, xhat, late = a * now + (1 - a) / 0.5 * driven[k], 0.95 * xhat + 0.05 * driven[k], 0.95 * late
    return mean**2 + np.square(0.3 * noise).sum(1)


@pytest.mark.ci
def test_an_observer_whose_samples_overtake_is_the_mean_over_every_sequence_of_delays(tmp_path):
    asked = own(tmp_path, "0.3") | {
        "lti": SMALL["lti"] | {"delay_values": [0.0, 0.9], "delay_self_transition": [0.6, 0.25]}
    }
    stats = pcbench.exact_moments(asked).stats.set_index("metric")
    driven = pcbench.simulate(asked, "model-only")["u1"].to_numpy()
    mean = delays.mean_over([0, 9], [0.6, 0.25], range(0, 31, 4), 1, 30, lambda times: alone(driven, times))
    np.testing.assert_allclose(
        stats.loc[["mse", "steady_mse"], "mean"], [mean[:30].mean(), mean[10:30].mean()], rtol=1e-10
    )
    assert (stats.loc[["mse", "steady_mse"], ["n", "se"]].to_numpy() == 0).all()


@pytest.mark.ci
def test_who_remembers_every_delay_there_was_is_averaged_over_schedules(tmp_path):
    """Its gain goes by the sum of all ages: modes meet with different sums."""
    asked = own(tmp_path, "0.5 / (1.0 + ages % 5)", "ages + arrival.age[0]")
    stats = pcbench.exact_moments(asked, schedules=5).stats.query("metric == 'mse'")
    assert (stats.method == "exact").all()
    assert (stats.n == 5).all()
    assert (stats.se > 0).all()


def test_who_asks_when_the_last_arrival_was_has_modes_that_say_so(tmp_path):
    for share, length in (("0.3", 1), ("0.3 + 0.01 * arrival.ticks_since_arrival", 2)):
        (p,) = planning.plan(parse.parse(own(tmp_path, share), "own"))
        each = realisations_over_modes(p)
        assert len(each) == 2**length
        for one in each:
            assert jax.tree.structure(one.problem) == jax.tree.structure(each[0].problem)


def test_who_asks_when_the_last_arrival_was_has_no_recursion_over_losses(tmp_path):
    lossy = {"lti": {k: v for k, v in SMALL["lti"].items() if k != "delay_values"} | {"loss": 0.3}}
    for share, there in (("0.3", True), ("0.3 + 0.01 * arrival.ticks_since_arrival", False)):
        (p,) = planning.plan(parse.parse(own(tmp_path, share) | lossy, "own"))
        assert (realisation_over_losses(p) is not None) is there


@pytest.mark.nightly
@pytest.mark.parametrize(
    "changes",
    [{}, {"delay_values": None, "delay_self_transition": None, "delay_jitter": 0.1}],
    ids=["chain", "sampling_jitter"],
)
def test_drawn_schedules_come_to_it_within_their_error(changes, monkeypatch):
    """64 of them; four standard errors, of means, squares and what is believed; 1e-12 is rounding of states of size 1."""
    asked = study(**changes)
    asked["options"] |= {"scenario": {"random_initial_state": True, "consistency": True}}
    sure = pcbench.exact_moments(asked).stats
    monkeypatch.setattr(delay_modes, "MOST_MODES", 0)
    key = ["observer", "signal", "metric"]
    both = sure.merge(pcbench.exact_moments(asked, schedules=64).stats, on=key, suffixes=("", "_drawn"))
    both = both[(both.method == "exact") & (both.method_drawn == "exact")]
    assert {"mse", "steady_mse", "final_error", "pooled_rmse", "nees", "signal_nees"} <= set(both.metric)
    assert (both.se == 0).all()
    off = (both["mean"] - both.mean_drawn).abs()
    assert (off <= 4 * both.se_drawn + 1e-12).all(), both[off > 4 * both.se_drawn + 1e-12]
    assert (both[both.metric == "mse"].se_drawn > 0).all()
