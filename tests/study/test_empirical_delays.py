"""`delay = "from:LOG"`: a study draws delays and losses that are distributed as those of a log, and needs the log no more."""

import numpy as np
import pandas as pd
import pytest
from logged import MOTOR, rows

from pcbench.errors import UserError
from pcbench.simulation.schedule import random_times
from pcbench.study import empirical_delays, parse

TICK = 0.01


def write_log(folder, many=4000):
    """A log whose delays are a chain: short for a while, then long for a while; one in ten never arrives."""
    rng = np.random.default_rng(6)
    long = np.cumsum(rng.random(many) < 0.1) % 2 == 1
    ticks = np.where(long, rng.integers(9, 13, many), rng.integers(3, 6, many))
    t = np.arange(many) * 0.05
    late = np.where(rng.random(many) < 0.1, np.nan, ticks * TICK)
    rows(folder, {"channel": ["y1"] * many, "sampled": t, "arrived": t + late, "value": t})
    return np.rint(late[~np.isnan(late)] / TICK).astype(int)


def study(log):
    return MOTOR | {"lti": MOTOR["lti"] | {"delay": f"from:{log}", "duration": 50.0}}


@pytest.mark.ci
def test_delays_of_runs_are_distributed_as_those_of_the_log(tmp_path):
    late = write_log(tmp_path / "flight")
    _, cell = parse.one_cell(study(tmp_path / "flight"), ["kf"], [])
    found = [
        s for seed in range(12) for s in random_times.draw_samples(cell.times.clocks, cell.times.ticks, 1, 0, seed)
    ]
    lost = np.array([s.arrives >= 2**29 for s in found])
    ages = np.array([s.arrives - s.tick for s in found])[~lost]
    assert lost.mean() == pytest.approx(0.1, abs=0.015)
    assert set(ages) == set(late)
    for each in set(late):
        assert np.mean(ages == each) == pytest.approx(np.mean(late == each), abs=0.02)


def test_the_resolved_study_needs_no_log(tmp_path):
    write_log(tmp_path / "flight")
    found = parse.grid_of(study(tmp_path / "flight"), {}, []).study.lti
    assert found.delay == 0.03
    assert max(found.delay_values) == pytest.approx(0.09)
    assert 0.08 < found.loss < 0.12
    assert "from:" not in str(found)


def test_a_log_is_found_beside_its_study(tmp_path):
    import tomli_w

    write_log(tmp_path / "flight")
    (tmp_path / "late.toml").write_text(tomli_w.dumps(study("flight")))
    assert parse.grid_of(str(tmp_path / "late.toml"), {}, []).study.lti.delay == 0.03


def test_channels_that_are_sampled_together_stay_as_long_as_one_does(tmp_path):
    write_log(tmp_path / "flight", 400)
    one = pd.read_csv(tmp_path / "flight" / "measurements.csv")
    both = pd.concat([one, one.assign(channel="y2")]).sort_values("sampled", kind="stable")
    rows(tmp_path / "both", both.to_dict("list"))
    outputs = {"C": [[1.0, 0.0], [0.0, 1.0]]}
    alone, found = (
        parse.grid_of(study(tmp_path / log) | {"lti": study(tmp_path / log)["lti"] | more}, {}, []).study.lti
        for log, more in (("flight", {}), ("both", outputs))
    )
    assert found.delay_self_transition == alone.delay_self_transition
    assert (found.delay_values, found.loss) == (alone.delay_values, alone.loss)


def test_the_first_of_a_channel_follows_none_of_another():
    found = empirical_delays.fit_delay_chain(np.array([3.0, 9.0, 9.0, 3.0]), np.array([0, 0, 1, 1]), TICK)
    assert found == {"delay": 0.03, "delay_values": [0.0, 0.06], "delay_self_transition": [0.0, 0.0]}


def test_delays_that_are_all_alike_are_one_delay(tmp_path):
    t = np.arange(20) * 0.05
    rows(tmp_path / "flight", {"channel": ["y1"] * 20, "sampled": t, "arrived": t + 0.07, "value": t})
    found = parse.grid_of(study(tmp_path / "flight"), {}, []).study.lti
    assert (found.delay, found.delay_values, found.loss) == (0.07, None, 0.0)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"loss": 0.1}, "lti.loss: got 0.1 with the delays of a recording"),
        ({"delay_gamma_mean": 0.1}, "lti.delay_gamma_mean: got 0.1 with the delays of a recording"),
        ({"delay_weights": [1.0, 2.0]}, "lti.delay_weights: got [1.0, 2.0] with the delays of a recording"),
        ({"delay": "from:none"}, "no such file or folder"),
    ],
)
def test_what_does_not_fit_is_one_sentence(tmp_path, more, sentence):
    write_log(tmp_path / "flight", 50)
    given = study(tmp_path / "flight")
    with pytest.raises(UserError) as caught:
        parse.grid_of(given | {"lti": given["lti"] | more}, {}, [])
    assert sentence in str(caught.value)


def two_channels(folder, first, second, lost=(0.0, 0.0), many=600):
    """A log of two channels with delays of so many ticks; some are lost."""
    rng, t = np.random.default_rng(3), np.arange(many) * 0.05
    columns = {"channel": [], "sampled": [], "arrived": [], "value": []}
    for name, late, loss in (("y1", first, lost[0]), ("y2", second, lost[1])):
        ticks = np.where(rng.random(many) < loss, np.nan, late(rng, many))
        columns["channel"] += [name] * many
        columns["sampled"] += t.tolist()
        columns["arrived"] += (t + ticks * TICK).tolist()
        columns["value"] += t.tolist()
    rows(folder, columns)
    outputs = {"C": [[1.0, 0.0], [0.0, 1.0]], "noise_std": [0.1, 0.1]}
    return MOTOR | {"lti": MOTOR["lti"] | {"delay": f"from:{folder}"} | outputs}


def constant(ticks):
    return lambda rng, many: np.full(many, float(ticks))


def delay_sampler(least):
    return lambda rng, many: least + rng.choice([0.0, 2.0, 5.0], many, p=[0.5, 0.3, 0.2])


def test_channels_with_constant_delays_have_each_its_own(tmp_path):
    """One that is never late and one that always is, which were pooled to one that is late by a coin."""
    found = parse.grid_of(two_channels(tmp_path / "net", constant(0), constant(10)), {}, []).study.lti
    assert (found.delay, found.loss) == ([0.0, 0.1], 0.0)
    assert not found.delay_values


def test_channels_share_what_varies_and_keep_their_least_delay_and_loss(tmp_path):
    found = parse.grid_of(
        two_channels(tmp_path / "net", delay_sampler(1), delay_sampler(9), (0.0, 0.3)), {}, []
    ).study.lti
    assert found.delay == [0.01, 0.09]
    assert found.delay_values == pytest.approx([0.0, 0.02, 0.05])
    assert found.loss == pytest.approx([0.0, 0.3], abs=0.06)


def test_channels_whose_delays_vary_differently_have_a_law_each(tmp_path):
    found = parse.grid_of(two_channels(tmp_path / "net", constant(4), delay_sampler(3)), {}, []).study.lti
    assert found.delay == [0.04, 0.03]
    assert found.delay_values == [[], pytest.approx([0.0, 0.02, 0.05])]
    assert [len(row) for row in found.delay_self_transition] == [0, 3]


@pytest.mark.ci
def test_delays_of_each_channel_are_drawn_as_in_its_own_recording(tmp_path):
    one = lambda rng, many: 1 + rng.choice([0.0, 7.0], many, p=[0.8, 0.2])  # noqa: E731
    _, cell = parse.one_cell(two_channels(tmp_path / "net", one, delay_sampler(3), many=2000), ["kf"], [])
    drawn = [
        s for seed in range(40) for s in random_times.draw_samples(cell.times.clocks, cell.times.ticks, 2, 0, seed)
    ]
    recorded = pd.read_csv(tmp_path / "net" / "measurements.csv")
    for channel, mine in recorded.groupby("channel"):
        ages = np.array([s.arrives - s.tick for s in drawn if s.channel == int(channel[1]) - 1])
        there = np.rint((mine.arrived - mine.sampled) / TICK)
        assert set(ages) == set(there)
        for each in set(there):
            assert np.mean(ages == each) == pytest.approx(np.mean(there == each), abs=0.04)
