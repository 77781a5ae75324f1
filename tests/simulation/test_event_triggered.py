"""Sensors that send a sample only if it has changed, or one output at a time: against NumPy, and against exit times."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, noise, problem, recorder, starts
from reference import event_triggered
from reference import linear as reference

import pcbench
from pcbench.dataset import block_files, storage
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.simulation import measurements, simulate_runs
from pcbench.simulation.measurements import Trigger
from pcbench.synthesis import send_on_delta
from pcbench.tables.layout import tables

ODD_CASE = Case(ODD, 5, 12, ticks=400, h=0.01, noise_std=0.2, seed=5, x0=[2.0, -4.0, 5.0], xhat0=[0.5, -1.0, 2.0])
CART_CASE = Case(CART, 60, 180, noise_std=0.7, x0=[2.0, 3.0], seed=3)
TRIGGERS = {
    "send on delta": (np.array([2.0, 0.5]), 0.0),
    "one channel": (np.array([0.0, 1.5]), 0.0),
    "try once, discard": (np.zeros(2), 1.0),
    "both": (np.array([1.0, 0.3]), 1.0),
}
WIENER = {
    "name": "wiener",
    "observers": ["kf", "kf-event"],
    "lti": {
        "A": [[0.0]],
        "B": [[1.0]],
        "C": [[1.0]],
        "states": ["x [1]"],
        "input": "zero",
        "noise_std": 0.001,
        "process_std": 0.1,  # of 0.01 s: dx = dw
        "tick": 0.01,
        "sampling_period": 0.01,
        "delay": 0.0,
        "duration": 200.0,
    },
    "axes": {"send_threshold": [1.0]},
}
pytestmark = pytest.mark.usefixtures("in_a_hurry")


def record(case, d, one):
    """One run of kf and kf-event, samples by the reference, and the variances that both assume."""
    known = context_of(case)._replace(send_threshold=() if one else tuple(d.tolist()))
    designs = {o: OBSERVERS[o].design(known, OBSERVERS[o].options()) for o in ("kf", "kf-event")}
    layout, p = problem(case, {"kf": {}, "kf-event": {}})
    p = p._replace(gains={o: each.gains for o, each in designs.items()}, trigger=Trigger(d, np.asarray(one)))
    found = recorder()(layout, p, np.asarray(0), np.asarray(case.seed))
    model, q = reference.Model(case.model.A, case.model.B, case.model.C, case.h), len(case.model.C)
    x, samples = reference.simulate(model, inputs(case), starts(case)[0], [case.te] * q, [case.d] * q, noise(case))
    return found, layout, p, model, x, samples, known


@pytest.mark.parametrize("name", TRIGGERS)
def test_what_is_sent_and_both_filters_equal_the_reference(name):
    d, one = TRIGGERS[name]
    found, _, p, model, x, samples, known = record(ODD_CASE, d, one)
    messages = event_triggered.sent(samples, d, bool(one))
    arrived = {
        (s.taken, s.channel): s.value
        for s in samples
        if s.arrival <= ODD_CASE.ticks and (s.taken, s.channel) in messages
    }
    brought = np.asarray(found.arrivals).reshape(ODD_CASE.ticks + 1, -1, 2)
    got = {(k - ODD_CASE.d, j): brought[k, slot, j] for k, slot, j in zip(*np.nonzero(~np.isnan(brought)), strict=True)}
    assert got == pytest.approx(arrived, rel=1e-10)
    assert 0.05 < len(arrived) / len(samples) < 0.95
    for label, silence in (("kf", False), ("kf-event", True)):
        R = np.asarray(p.gains[label].R)
        want = event_triggered.kf_event(
            model, inputs(ODD_CASE), samples, starts(ODD_CASE)[1], known.P0, R, d, bool(one), silence
        )
        np.testing.assert_allclose(found.estimates[label], want, rtol=0, atol=1e-10 * np.abs(x).max(), err_msg=label)
    same = np.allclose(found.estimates["kf"], found.estimates["kf-event"], rtol=0, atol=1e-10 * np.abs(x).max())
    assert same == bool(one), "silence is used, but not where another output has the turn"


@pytest.mark.parametrize("name", TRIGGERS)
def test_the_share_of_samples_that_are_sent_equals_the_reference(name):
    d, one = TRIGGERS[name]
    case = ODD_CASE._replace(d=0)
    _, layout, p, _, _, samples, _ = record(case, d, one)
    out = jax.jit(simulate_runs.simulate_run, static_argnums=0)(layout, p, jnp.asarray(0), jnp.asarray(case.seed))
    messages, taken = event_triggered.sent(samples, d, bool(one)), [s for s in samples if s.taken < case.ticks]
    share = len([s for s in taken if (s.taken, s.channel) in messages]) / len(taken)
    assert float(out.sent) == pytest.approx(share, abs=1e-12)


def test_a_threshold_of_zero_sends_all_and_changes_no_bit():
    found, *_ = record(CART_CASE, np.zeros(1), 0.0)
    layout, p = problem(CART_CASE, {"kf": {}})
    usual = recorder()(layout, p, np.asarray(0), np.asarray(CART_CASE.seed))
    for label in ("kf", "kf-event"):
        np.testing.assert_array_equal(found.estimates[label], usual.estimates["kf"])


def test_the_value_sent_is_held_until_the_next_one():
    t, y = Trigger(np.array([1.0]), np.asarray(0.0)), [0.0, 0.9, -0.9, 1.0, 1.9, 0.1, 0.0]
    sensors, out = measurements.first_sensors(1), []
    for each in y:
        sensors, value = measurements.send(t, sensors, np.array([each]), np.array([True]))
        out.append(float(value[0]))
    np.testing.assert_array_equal(out, [0.0, np.nan, np.nan, 1.0, np.nan, np.nan, 0.0])
    assert (float(sensors.n_samples), float(sensors.n_sent)) == (7, 3)


@pytest.mark.ci
def test_wiener_process_has_the_interval_and_variance_of_exit_times():
    """As simulated in steps by a program of its own; by symmetry silence changes no estimate."""
    result = pcbench.run(WIENER, seeds=256)
    runs = result.runs_of("lti", ["steady_mse", "sent_fraction"], 0)
    kf = runs[runs.observer == "kf"]
    simulated = send_on_delta.simulate(1.0, 0.01, 4_000_000, 0, shift=False)
    share, square = kf.sent_fraction, kf.steady_mse
    assert 0.01 / share.mean() == pytest.approx(simulated.interval, rel=4 * share.sem() / share.mean() + 0.005)
    # the mean over the ticks, at which the state is known where a sample is sent, is that over time less half a tick's growth
    assert square.mean() == pytest.approx(simulated.variance - 0.005, abs=4 * square.sem() + 0.001)
    both = runs.pivot(index="seed", columns="observer", values="steady_mse")
    np.testing.assert_allclose(both["kf"], both["kf-event"], rtol=1e-3)


DRIVEN = WIENER["lti"] | {
    "A": [[0.0, 1.0], [-1.0, -0.4]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0]],
    "states": ["x [m]", "v [m/s]"],
    "process_std": [0.0, 0.05],
    "noise_std": 0.01,
    "tick": 0.05,
    "sampling_period": 0.05,
    "duration": 40.0,
}


@pytest.mark.ci
def test_silence_is_information_but_not_as_much_as_the_covariance_says():
    """Half the error with as many messages; the errors of one silence after another are not independent."""
    study = WIENER | {
        "name": "silence",
        "lti": DRIVEN,
        "axes": {"send_threshold": [0.1]},
        "observers": ["kf", "kf-event", "kf-event-none"],
        "options": {
            "kf-event-none": {"threshold": 0.0},
            "scenario": {"random_initial_state": True, "consistency": True},
        },
    }
    stats = pcbench.run(study, seeds=128).stats.query("signal == 'x'").set_index(["metric", "observer"])
    mean, se = stats["mean"], stats["se"]
    assert mean["steady_rmse", "kf-event"] < 0.6 * mean["steady_rmse", "kf"]
    assert mean["steady_rmse", "kf-event-none"] == mean["steady_rmse", "kf"]
    assert mean["sent_fraction", "kf-event"] == mean["sent_fraction", "kf"]
    assert abs(mean["nees", "kf"] - 1) < 4 * se["nees", "kf"]
    assert mean["nees", "kf-event"] - 1 > 4 * se["nees", "kf-event"]


def test_exact_moments_say_why_there_are_none():
    stats = pcbench.run(WIENER | {"evaluation": "exact"}, seeds=1).stats
    assert stats["mean"].isna().all()
    assert stats.reason.str.contains("sent or not by what they measure").all()


REFUSED = {
    "one output": ({"try_once_discard": [1]}, {}, "which has one output, expected two or more"),
    "not 0 or 1": ({"try_once_discard": [0.5]}, {}, "1 (try-once-discard) or 0"),
    "negative": ({"send_threshold": [-1.0]}, {}, "at least 0"),
    "processor": (
        {"send_threshold": [1.0], "processor_speed": [1e6]},
        {},
        "with a processor_speed, expected one of them",
    ),
    "threshold of an observer": (
        {"send_threshold": [1.0]},
        {"options": {"kf-event": {"threshold": [1.0, 2.0]}}},
        "expected 1 numbers of 0 or more",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_mistakes_are_one_sentence(name):
    axes, more, words = REFUSED[name]
    with pytest.raises(UserError) as caught:
        pcbench.run(WIENER | {"axes": axes} | more, seeds=1)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_outputs_of_different_times_have_no_protocol():
    lti = ({**DRIVEN, "C": [[1.0, 0.0], [0.0, 1.0]], "delay": [0.0, 0.0], "noise_std": [0.01, 0.01]}) | {
        "sampling_period": [0.05, 0.1]
    }
    with pytest.raises(UserError, match="sampled at different times, expected one sampling_period"):
        pcbench.run(WIENER | {"lti": lti, "axes": {"try_once_discard": [1]}}, seeds=1)


TWO = DRIVEN | {"C": [[1.0, 0.0], [0.0, 1.0]], "noise_std": [0.05, 0.05], "delay": [0.1, 0.1], "duration": 6.0}
UNSURE = {
    "loss": ({"send_threshold": [0.1], "loss": [0.2]}, "loss with a send_threshold, expected a network that delivers"),
    "late": ({"send_threshold": [0.1], "delay_jitter": [0.05]}, "delay_jitter with a send_threshold"),
    "apart": (
        {"try_once_discard": [1], "sampling_jitter": [[0.0, 0.05]], "sampling_period": [0.3]},
        "delays that are equal if sampling times are random",
    ),
    "a threshold for one": (
        {"try_once_discard": [1], "send_threshold": [[0.1, 0.0]]},
        "all thresholds above 0, or none",
    ),
}


@pytest.mark.parametrize("name", UNSURE)
def test_silence_that_may_have_another_cause_is_refused(name):
    axes, words = UNSURE[name]
    with pytest.raises(UserError, match=words) as caught:
        pcbench.run(WIENER | {"lti": TWO, "axes": axes}, seeds=1)
    assert "\n" not in str(caught.value)


def test_a_threshold_of_an_observer_needs_one_of_a_sensor():
    study = WIENER | {"axes": {}, "options": {"kf-event": {"threshold": 0.5}}}
    with pytest.raises(UserError, match=r"threshold: got 0\.5, expected none, as no sensor has a send_threshold"):
        pcbench.run(study, seeds=1)


def test_a_change_of_one_step_of_rounding_is_sent():
    step = 0.1
    y, t = np.round(np.arange(1, 101) * step / step) * step, Trigger(np.array([step]), np.asarray(0.0))
    sensors, sent = measurements.first_sensors(1), []
    for each in y:
        sensors, value = measurements.send(t, sensors, np.array([each]), np.array([True]))
        sent.append(bool(np.isfinite(value[0])))
    assert all(sent)


@pytest.mark.ci
def test_filters_of_a_loop_have_the_inputs_since_the_last_sample_that_was_sent():
    scenario = {"base": "ncs-reactor/round-robin", "sampling_period": 0.05, "sampling_phase": 0.0, "duration": 2.0}
    study = {"name": "loop", "scenario": scenario | {"steady_start": 1.0}, "observers": ["kf", "ekf"], "seeds": 4}
    runs = pcbench.run(study | {"axes": {"send_threshold": [0.0, 0.2]}}).runs.set_index(
        ["cell", "observer", "signal", "seed"]
    )
    assert not runs.diverged.any()
    kf, ekf = (runs.xs(name, level="observer").rmse for name in ("kf", "ekf"))
    np.testing.assert_allclose(ekf, kf, rtol=1e-9)


@pytest.mark.ci
def test_observers_are_notified_of_samples_that_are_sent_and_know_when_the_last_one_came(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(COUNTS)
    monkeypatch.chdir(tmp_path)
    study = WIENER | {"lti": TWO, "axes": {"send_threshold": [0.3]}, "observers": ["mine.py:counts"]}
    run = pcbench.simulate(study, "mine.py:counts")
    came = np.flatnonzero(np.isfinite(run.y1) & (run[["y1", "y2"]].diff().abs().sum(axis=1) > 0) | (run.index == 2))
    assert 3 < len(came) < 50
    notified, since = run["counts.x"].to_numpy(), run["counts.v"].to_numpy()
    assert notified[-1] == pytest.approx(len(came), abs=2), "but for those on their way"
    np.testing.assert_array_equal(since[came], np.diff(came, prepend=0))


COUNTS = """
import jax.numpy as jnp
import pcbench


def design(context, options):
    return pcbench.Design((), pcbench.no_certificate("it counts"))


counts = pcbench.Observer(
    init=lambda gains, xhat0: jnp.zeros(2),
    snapshot=lambda gains, memory, now: jnp.zeros(0),
    jump=lambda gains, memory, now, arrival: memory.at[1].set(arrival.ticks_since_arrival),
    flow=lambda gains, memory, now: memory,
    estimate=lambda gains, memory: memory,
    on_sample=lambda gains, memory, now, mask: memory.at[0].add(jnp.any(mask) * 1.0),
)
"""


@pytest.mark.ci
def test_record_of_a_study_names_the_engine_that_computes_it(tmp_path):
    study = WIENER | {"lti": DRIVEN | {"duration": 2.0}, "axes": {"send_threshold": [0.1]}}
    found = pcbench.run(study, seeds=2, out=tmp_path / "out")
    assert found.provenance["engines"] == ["definition"]
    assert {
        block_files.about_block(t, b)["engine"]
        for t in [storage.target(str(tmp_path / "out"))]
        for b in block_files.present(t)
    } == {"definition"}
    assert pcbench.run(study | {"axes": {}}, seeds=2, out=tmp_path / "all").provenance["engines"] == ["steps"]


@pytest.mark.ci
def test_one_number_per_run_has_one_table_whatever_signal_is_named():
    """It is in the row of the first signal, which is not the one in the headline here."""
    scenario = {"base": "quadruple-tank/delayed", "delay": [0.0, 0.0], "duration": 100.0, "steady_start": 50.0}
    study = {"name": "tank", "scenario": scenario, "observers": ["kf"], "axes": {"send_threshold": [0.0, 0.5]}}
    result = pcbench.run(study, seeds=2)
    shown = [tables(result, "sent_fraction", signals) for signals in (None, [], ["level_2"], ["level_1", "level_4"])]
    assert [len(each) for each in shown] == [1, 1, 1, 1]
    assert len({str(each) for each in shown}) == 1
    assert len(tables(result, "rmse", [])) == 4
    for signals in (["levl_2"], ["level_1", "levl_2"]):
        with pytest.raises(UserError, match="levl_2"):
            tables(result, "sent_fraction", signals)
    first, second = result.stats[result.stats.metric == "sent_fraction"]["mean"]
    assert first == 1 > second
