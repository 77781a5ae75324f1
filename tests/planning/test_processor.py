"""A processor of limited speed makes the estimates of an observer late, and leaves out samples that it has no time for."""

from functools import cache
from math import inf

import jax
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from reference import processor as reference
from support import exports

import pcbench
from pcbench.errors import UserError
from pcbench.export import files
from pcbench.external import export_draws
from pcbench.planning import context_of, drafts, operation_counts, padding, processor, with_computing_time
from pcbench.planning.operation_counts import Cost
from pcbench.runtime import config
from pcbench.simulation.schedule import common_times
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study import parse
from pcbench.study.times import Timing

A = np.array([[0.0, 1.0], [1.0, -0.4]])
STUDY = {
    "name": "processor",
    "observers": ["kf"],
    "seeds": 4,
    "lti": {"A": A.tolist(), "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "tick": 0.1, "sampling_period": 0.4, "delay": 0.2,
            "noise_std": 0.1, "process_std": [0.02, 0.05], "duration": 8.0, "states": ["a", "b"], "input": "sine"},
}  # fmt: skip


def having(observers=("kf",), **given):
    return STUDY | {"lti": STUDY["lti"] | given, "observers": list(observers)}


def at(*speeds, observers=("kf",), **given):
    return having(observers, **given) | {"axes": {"processor_speed": list(speeds)}}


def load(speed, observer="kf", **given):
    """The ticks that a sample takes, and of how many one is used."""
    with config.float64():
        (cell,) = parse.grid_of(having([observer], processor_speed=speed, **given), {}, []).cells
        clock = with_computing_time(cell, observer).times.clocks[0]
    return clock.delay - cell.times.clocks[0].delay, clock.stride


@cache
def counter():
    """What `kf` costs, over the age of samples and the ticks between them."""
    with config.float64():
        (cell,) = parse.grid_of(having(), {}, []).cells
        (p,) = drafts([cell])
        return operation_counts.counter(p, *p.layout.observers[0])


def slow(every, waits=lambda wait: wait > 0):
    """A speed at which `kf` uses one sample of so many, and the ticks that it takes for it."""
    for speed in np.geomspace(1e4, 105.0, 400).tolist():
        found = processor.load_of(counter(), Clock((0,), 4, 2), 80, speed, 0.1)
        if found.stride == every and waits(found.wait):
            return speed, found.wait
    raise AssertionError("no such speed")


counts = st.integers(0, 4000)


@given(
    work=st.tuples(counts, counts, counts, st.integers(0, 300)),
    period=st.integers(1, 12),
    late=st.integers(0, 20) | st.none(),
    phase=st.integers(0, 9),
    ticks=st.integers(2, 90),
    speed=st.integers(1, 60_000),
    fine=st.integers(1, 8),
)
@example(work=(1000, 0, 1300, 0), period=1, late=0, phase=0, ticks=90, speed=1000, fine=1)  # fewer if older
def test_the_schedule_is_that_of_a_processor_that_computes_one_sample_at_a_time(
    work, period, late, phase, ticks, speed, fine
):
    own, older, rarer, tick = reference.Work(*work)
    delay, h = period if late is None else late, 2.0**-fine
    w, close = reference.time_set_aside(reference.Work(*work), delay, period, ticks, speed, h)
    assume(not close)
    at_ages = {(delay, period): own, (delay + period, period): older, (delay, 2 * period): rarer}

    def cost(age, interval):
        return Cost(at_ages[age, interval], tick, 0)

    clock = Clock((0, 1), period, late, phase=phase)
    found = processor.load_of(cost, clock, ticks, float(speed), h)
    times = processor.with_load(Timing(ticks, 0, 0, [clock]), found)
    samples = common_times.samples_of(times.clocks, ticks)
    want = [s for s in reference.used(w, delay, period, phase, ticks) if s[2] <= ticks]
    for channel in (0, 1):
        assert [(s.number, s.tick, s.arrives) for s in samples if s.channel == channel and s.arrives <= ticks] == want
    by_loops = common_times.schedule(samples, ticks, 2)
    if times.clocks[0].plain:
        for a, b in zip(common_times.plain_clock(times.clocks[0], ticks, 2)[0], by_loops, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_schedule_one_tick_early_is_another():
    work = reference.Work(900, 1200, 1500, 20)
    w, _ = reference.time_set_aside(work, 2, 4, 80, 2000, 0.125)
    assert w > 4, "more than a period"
    early = reference.used(w - 1, 2, 4, 0, 80)
    assert early != reference.used(w, 2, 4, 0, 80)


def test_half_the_speed_takes_twice_the_time_and_more_where_every_tick_has_work():
    assert processor.computing_time(600, 0, 1000.0, 0.1) == 0.6
    assert processor.computing_time(600, 0, 500.0, 0.1) == 1.2
    assert processor.computing_time(600, 20, 1000.0, 0.1) == 0.75  # 200 of 1000 in a second are for the ticks
    assert processor.computing_time(600, 20, 500.0, 0.1) == 2.0
    assert processor.computing_time(600, 20, 200.0, 0.1) == inf


def test_the_time_of_an_observer_is_that_of_its_operations():
    """A sample of `kf` in a run of 80 ticks; moving the model and g over a tick takes 10 products."""
    row = pcbench.operation_counts(having()).iloc[0]
    assert row.tick == 10
    speed = 10 / 0.1 + row["sample"] / 0.3  # three ticks for a sample
    assert load(speed * 1.001) == (3, 1)
    assert load(speed * 0.99) == (3, 1), "the nearest"
    waits = [processor.load_of(counter(), Clock((0,), 4, 2), 80, v, 0.1).wait for v in (200.0, 500.0, 1e3, 1e4)]
    assert waits == sorted(waits, reverse=True)
    assert waits[-1] == 0


@pytest.mark.ci
def test_a_table_of_operations_says_how_long_a_sample_takes():
    (once, w), (third, later) = slow(1), slow(3)
    table = pcbench.operation_counts(at(inf, once, third, 100.0)).set_index("processor_speed")
    assert table.computing_time.tolist() == pytest.approx([0.0, 0.1 * w, 0.1 * later, inf])
    assert table.stride.tolist() == [1, 1, 3, 1]
    assert "computing_time" not in pcbench.operation_counts(having())


@pytest.mark.ci
def test_without_a_limit_all_bits_are_those_of_a_study_without_the_axis():
    axis = pcbench.run(at(inf, 1e12, observers=["kf", "ekf", "pccebo"])).runs
    plain = pcbench.run(having(["kf", "ekf", "pccebo"])).runs
    for speed in (inf, 1e12):
        mine = axis[axis.processor_speed == speed]
        assert (mine.observer.to_numpy() == plain.observer.to_numpy()).all()
        for metric in ("rmse", "steady_rmse", "final_error", "max_abs_error"):
            np.testing.assert_array_equal(mine[metric], plain[metric])


@pytest.mark.ci
@pytest.mark.parametrize("engine", ["steps", "definition"])
def test_a_sample_that_is_computed_within_a_period_is_one_with_a_longer_delay(engine):
    speed, wait = slow(1)
    limited = pcbench.run(at(speed) | {"engine": engine}).runs
    late = pcbench.run(having(delay=round(0.2 + 0.1 * wait, 10)) | {"engine": engine}).runs
    np.testing.assert_array_equal(limited.rmse, late.rmse)
    assert (limited.rmse.to_numpy() != pcbench.run(having()).runs.rmse.to_numpy()).all()


def test_the_samples_that_are_used_are_those_of_every_observer():
    """Which sample is taken at a tick, and its noise, do not depend on the processor."""
    speed, wait = slow(3)
    late = pcbench.simulate(having(processor_speed=speed), "kf", seed=3)
    usual = pcbench.simulate(having(), "kf", seed=3)
    np.testing.assert_array_equal(late.a, usual.a)
    taken = range(0, 81 - 2 - wait, 12)
    np.testing.assert_array_equal([late.y1[k + 2 + wait] for k in taken], [usual.y1[k + 2] for k in taken])
    assert late.y1[: 2 + wait].isna().all()
    assert late.y1.nunique() == len(taken)


@pytest.mark.ci
def test_an_observer_has_the_same_bits_beside_one_that_has_less_time():
    both = pcbench.run(at(500.0, observers=["kf", "ekf"])).runs
    assert load(500.0) != load(500.0, "ekf")
    for name in ("kf", "ekf"):
        alone = pcbench.run(at(500.0, observers=[name])).runs
        np.testing.assert_array_equal(both[both.observer == name].rmse, alone.rmse)


@pytest.mark.ci
def test_an_observer_without_time_is_the_model_alone():
    runs = pcbench.run(at(101.0, observers=["kf", "model-only"])).runs
    kf, model = (runs[runs.observer == name].rmse.to_numpy() for name in ("kf", "model-only"))
    np.testing.assert_allclose(kf, model, rtol=0, atol=1e-12)


@pytest.mark.ci
def test_the_bound_is_that_of_a_processor_without_a_limit():
    stats = pcbench.run(at(inf, 500.0)).stats
    rows = stats[(stats.metric == "rms_efficiency") & (stats.signal == "a")].set_index("processor_speed")["mean"]
    rmse = stats[(stats.metric == "steady_pooled_rmse") & (stats.signal == "a")].set_index("processor_speed")["mean"]
    np.testing.assert_allclose(rows[inf] * rmse[inf], rows[500.0] * rmse[500.0], rtol=1e-12)
    assert rows[500.0] < rows[inf]


def test_designs_know_what_the_processor_has_time_for():
    speed, wait = slow(2)
    limited = pcbench.design(having(["pccebo"], processor_speed=1e12), "pccebo")
    usual = pcbench.design(having(["pccebo"]), "pccebo")
    jax.tree.map(np.testing.assert_array_equal, limited.gains, usual.gains)
    with config.float64():
        (cell,) = parse.grid_of(having(processor_speed=speed), {}, []).cells
        known = context_of(with_computing_time(cell, "kf"))
    assert known.period == (8,)
    assert known.delay == (2 + wait,)


@pytest.mark.ci
def test_exact_moments_are_those_of_the_schedule():
    speed, wait = slow(2)
    exact = pcbench.run(at(speed) | {"evaluation": "exact"}).stats
    same = having(delay=round(0.2 + 0.1 * wait, 10), sampling_period=0.8) | {"evaluation": "exact"}
    want = pcbench.run(same).stats
    for metric in ("steady_pooled_rmse", "pooled_rmse"):
        np.testing.assert_array_equal(exact[exact.metric == metric]["mean"], want[want.metric == metric]["mean"])


@pytest.mark.ci
def test_a_closed_loop_has_an_estimate_of_its_observers_own_time():
    loop = {"controller": {"use": "state-feedback", "K": [[3.0, 2.0]], "actuator_delay": 0.1}}
    speed, wait = slow(1)
    limited = pcbench.run(at(speed) | loop).runs
    late = pcbench.run(having(delay=round(0.2 + 0.1 * wait, 10)) | loop).runs
    np.testing.assert_array_equal(limited.rmse, late.rmse)


@pytest.mark.ci
def test_an_export_runs_with_the_samples_that_there_is_time_for():
    speed, _ = slow(2)
    found = files.export_observer(having(processor_speed=speed), "kf")
    assert exports.off(found, exports.program_output(found)) < 1e-12
    want = pcbench.simulate(having(processor_speed=speed), "kf")[["kf.a", "kf.b"]]
    np.testing.assert_allclose(exports.estimates(found), want, rtol=0, atol=1e-12)
    assert (pcbench.simulate(having(), "kf")["kf.a"] != want["kf.a"]).any()


def test_programs_share_a_shape_over_speeds():
    with config.float64():
        cells = parse.grid_of(at(inf, 200.0, 400.0, 2000.0, observers=["kf", "ekf"]), {}, []).cells
        programs = {padding.key_of(p) for p in padding.fit(list(drafts(cells)))}
    assert len(programs) == 2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"loss": 0.2}, "loss"),
        ({"sampling_jitter": 0.1}, "sampling_jitter"),
        ({"sampling_pattern": "sine"}, "sampling_pattern"),
        ({"delay_sequence": [0.0, 0.1]}, "delay_sequence"),
        ({"C": [[1.0, 0.0], [0.0, 1.0]], "delay": [0.2, 0.3]}, "channels that differ"),
    ],
)
def test_what_has_no_regular_samples_of_one_sensor_is_refused(given, words):
    with pytest.raises(UserError, match=rf"got processor_speed = 1000 with .*{words}.*, expected regular samples"):
        pcbench.run(having(processor_speed=1e3, **given))


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_speed_is_above_0(value):
    with pytest.raises(UserError, match="got"):
        pcbench.run(at(value))


def test_commands_that_have_no_use_for_a_speed_refuse_it_in_one_sentence(tmp_path):
    with pytest.raises(UserError, match="got 2 observers with a processor_speed, expected one"):
        pcbench.simulate(having(["kf", "ekf"], processor_speed=1e3), ["kf", "ekf"])
    with pytest.raises(UserError, match="got the axis processor_speed, whose larger values are better"):
        pcbench.find_limit(having(), axis="processor_speed", threshold=0.5)
    with pytest.raises(UserError, match="the arithmetic of another program is not counted"):
        export_draws.write(parse.grid_of(having(processor_speed=1e3), {}, []), tmp_path / "out")
