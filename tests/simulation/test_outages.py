"""An outage: a channel's samples that are taken within it never arrive. A phase: its first sample is taken then."""

import numpy as np
import pytest
from scipy.linalg import expm

import pcbench
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.simulation.schedule import common_times, random_times
from pcbench.study import parse, times

A = np.array([[0.0, 1.0], [1.0, -0.4]])
STUDY = {
    "name": "outage",
    "observers": ["kf"],
    "seeds": 2,
    "lti": {"A": A.tolist(), "B": [[0.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]], "tick": 0.1,
            "sampling_period": 0.5, "delay": 0.3, "noise_std": [0.1, 0.3], "duration": 6.0, "states": ["a", "b"]},
}  # fmt: skip
RANDOM = {"loss": [0.3, 0.2], "delay_jitter": 0.4, "sampling_jitter": 0.1}


def having(observers=("kf",), **given):
    return STUDY | {"lti": STUDY["lti"] | given, "observers": list(observers)}


def samples(**given):
    """By channel, what becomes of the samples of one run: (number, tick at which it is taken, tick at which it arrives)."""
    (cell,) = parse.grid_of(having(**given), {}, []).cells
    t = times.times_of(cell.scenario)
    every = (
        random_times.draw_samples(t.clocks, t.ticks, 2, 0, 1)
        if t.random
        else common_times.samples_of(t.clocks, t.ticks)
    )
    return [[(s.number, s.tick, s.arrives) for s in every if s.channel == j] for j in range(2)]


@pytest.mark.parametrize("network", [{}, RANDOM, {"delay_sequence": [0.0, 0.6]}], ids=["shared", "random", "in turn"])
def test_samples_taken_within_an_outage_never_arrive_and_no_others_change(network):
    usual = samples(**network)
    out = samples(outage_start=[1.0, 2.5], outage_duration=[2.0, 1.0], **network)
    for before, after, (first, end) in zip(usual, out, [(10, 30), (25, 35)], strict=True):
        expected = [(i, k, common_times.NEVER if first <= k < end else arrives) for i, k, arrives in before]
        assert after == expected
        assert after != before


@pytest.mark.parametrize("pattern", ["periodic", "sine", "uniform"])
@pytest.mark.parametrize("network", [{"loss": [0.0, 0.3]}, RANDOM], ids=["loss", "random"])
def test_a_phase_moves_all_samples_of_a_sensor_and_no_others(network, pattern):
    usual = samples(sampling_pattern=pattern, **network)
    moved = samples(sampling_pattern=pattern, sampling_phase=[0.0, 0.2], **network)
    assert moved[0] == usual[0]
    later = [(i, k + 2, min(arrives + 2, common_times.NEVER)) for i, k, arrives in usual[1] if k + 2 <= 60]
    assert moved[1] == later


def test_sensors_that_alternate_are_never_sampled_together():
    first, second = samples(sampling_phase=[0.0, 0.2])
    assert [k for _, k, _ in first] == list(range(0, 61, 5))
    assert [(k, arrives) for _, k, arrives in second] == [(k, k + 3) for k in range(2, 61, 5)]


@pytest.mark.ci
@pytest.mark.parametrize("network", [{}, RANDOM], ids=["shared", "random"])
def test_runs_without_an_outage_keep_their_bits(network):
    apart = pcbench.run(having(**network) | {"axes": {"outage_duration": [0.0, 2.0]}}).runs
    alone = pcbench.run(having(**network)).runs
    first = apart[apart.outage_duration == 0]
    np.testing.assert_array_equal(first.rmse, alone.rmse)
    assert (apart[apart.outage_duration > 0].rmse.to_numpy() != first.rmse.to_numpy()).all()


def test_an_error_grows_through_an_outage_as_the_plant_does():
    run = pcbench.simulate(having(outage_start=1.2, outage_duration=3.0), "kf", seed=3)
    error = run[["a", "b"]].to_numpy() - run[["kf.a", "kf.b"]].to_numpy()
    np.testing.assert_allclose(error[45], expm(A * 3.0) @ error[15], rtol=0, atol=1e-10)
    assert np.abs(error[48] - expm(A * 3.3) @ error[15]).max() > 1e-3


@pytest.mark.ci
@pytest.mark.parametrize("network", [{}, RANDOM], ids=["shared", "random"])
def test_a_perfect_start_stays_perfect_through_an_outage_in_both_engines(network):
    study = having(
        ["kf", "ekf"], sampling_phase=[0.0, 0.2], outage_start=[1.0, 0.0], outage_duration=[2.0, 1.5], **network
    ) | {"seeds": 4}
    runs = {engine: pcbench.run(study | {"engine": engine}).runs.rmse for engine in ("steps", "definition")}
    np.testing.assert_allclose(runs["steps"], runs["definition"], rtol=0, atol=1e-11)
    study["lti"] |= {"noise_std": 0.0, "x0": [1.0, -0.5], "xhat0": [1.0, -0.5], "prior_std": 1.0}
    for engine in ("steps", "definition"):
        assert pcbench.run(study | {"engine": engine}).runs.max_abs_error.max() < 1e-12


ALL = [name for name, o in OBSERVERS.items() if o.knows_schedule and o.takes != "constant delays" and not o.nonlinear]


@pytest.mark.ci
def test_every_observer_that_knows_the_schedule_starts_perfect():
    lti = {"C": [[1.0, 0.0]], "noise_std": 0.0, "x0": [1.0, -0.5], "xhat0": [1.0, -0.5], "prior_std": 1.0}
    able = [name for name in ALL if name not in ("smo", "pio")]  # these need an unknown input
    study = having(able, **lti, sampling_phase=0.2, outage_start=1.0, outage_duration=2.0) | {"seeds": 1}
    runs = pcbench.run(study).runs
    assert set(runs.observer) == set(able)
    assert runs.max_abs_error.max() < 1e-12


@pytest.mark.parametrize("observer", ["chain", "equal-delay", "no-delay"])
def test_observers_that_count_samples_from_the_start_refuse_a_phase(observer):
    with pytest.raises(
        UserError, match=r"a sampling_phase of 0.1, 0 s, expected regular samples .* the first at t = 0"
    ):
        parse.grid_of(having([observer], delay=0.5, sampling_phase=[0.1, 0.0]), {}, [])


@pytest.mark.ci
@pytest.mark.parametrize(
    "network",
    [
        {"outage_duration": 2.0},
        {"outage_duration": 2.0, "loss": 0.3},
        {"outage_duration": 2.0, "delay_values": [0.0, 0.6]},
        {"outage_duration": 0.0, "delay_values": [0.0, 0.6]},
    ],
    ids=["shared", "loss", "chain", "chain without an outage"],
)
def test_exact_moments_agree_with_many_runs(network):
    study = having(["kf"], sampling_phase=0.2, outage_start=1.0, **network)
    exact = pcbench.exact_moments(study, schedules=64).stats
    runs = pcbench.run(study | {"seeds": 8192}).stats
    both = exact[exact.method == "exact"].merge(runs, on=["cell", "signal", "metric"], suffixes=("", "_runs"))
    both = both[both.metric.isin(["mse", "steady_mse"])]
    off = np.abs(both["mean"] - both.mean_runs) / np.hypot(both.se, both.se_runs)
    assert len(off) == 4
    assert off.max() < 4, both.loc[off.idxmax()]


def test_an_outage_from_start_to_end_leaves_the_model():
    runs = pcbench.run(having(["kf", "model-only"], outage_duration=6.0)).runs
    errors = [runs[runs.observer == name].rmse.to_numpy() for name in ("kf", "model-only")]
    np.testing.assert_allclose(*errors, rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"outage_duration": -1.0}, "lti.outage_duration: got -1.0, expected a number of at least 0"),
        ({"outage_duration": [1.0, 2.0, 3.0]}, r"lti.outage_duration: got 3 values, expected one or 2"),
        ({"observers": ["pccebo"], "outage_duration": [0.0, 1.0]}, r"channels that differ \(outage_duration = "),
    ],
)
def test_an_impossible_outage_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        parse.grid_of(having(**given), {}, [])
    assert "\n" not in str(caught.value)
