"""`delay = "in-turn:LOG"`: samples are taken, late and lost as in the log, one after the other, in all runs."""

import math

import numpy as np
import pytest
from logged import MOTOR, rows

from pcbench.errors import UserError
from pcbench.planning.build import samples_of
from pcbench.planning.design_context import context_of
from pcbench.scenarios import SCENARIOS
from pcbench.study import empirical_delays, parse

TICK = 0.01
NEVER = 10**8  # ticks; no sample that arrives is so late


def write_log(folder, many=30, channels=("y1",), seed=0):
    """A log from 3 s on with gaps, out-of-sequence samples and lost ones; returns (taken, arrives) in ticks from its start."""
    rng = np.random.default_rng(seed)
    taken = np.concatenate([[0], np.cumsum(rng.integers(4, 12, many - 1))])
    late = rng.integers(2, 40, many).astype(float)
    late[rng.random(many) < 0.2] = np.nan
    t = 3.0 + np.repeat(taken, len(channels)) * TICK
    each = np.repeat(late, len(channels)) * TICK
    rows(folder, {"channel": list(channels) * many, "sampled": t, "arrived": t + each, "value": t})
    return taken, late


def study(log, **more):
    lti = {k: v for k, v in MOTOR["lti"].items() if k != "sampling_period"}
    return MOTOR | {"lti": lti | {"delay": f"in-turn:{log}"} | more}


def of_the_log(taken, late, ticks):
    """(taken, arrives or None) up to a tick; the last sample is where the log begins again."""
    out, begins, length = [], 0, int(taken[-1])
    while begins <= ticks:
        each = zip(taken[:-1] + begins, late[:-1], strict=True)
        out += [(int(t), None if np.isnan(d) else int(t + d)) for t, d in each if t <= ticks]
        begins += length
    return out


@pytest.mark.parametrize("horizon", [0.5, 1.5, 6.0], ids=["a part", "most", "again and again"])
def test_samples_are_those_of_the_log(tmp_path, horizon):
    taken, late = write_log(tmp_path / "flight")
    _, cell = parse.one_cell(study(tmp_path / "flight", duration=horizon), ["kf"], [])
    found = [s for s in samples_of(cell) if s.tick <= cell.times.ticks]
    got = [(s.tick, None if s.arrives > NEVER else s.arrives) for s in found]
    assert got == of_the_log(taken, late, round(horizon / TICK))
    assert not cell.times.random


def test_an_observer_keeps_places_for_as_many_as_overtake(tmp_path):
    taken, late = write_log(tmp_path / "flight")
    _, cell = parse.one_cell(study(tmp_path / "flight"), ["kf"], [])
    each = [(t, a) for t, a in of_the_log(taken, late, cell.times.ticks) if a is not None]
    most = max(sum(newer > t and sooner < a for newer, sooner in each) for t, a in each)
    assert context_of(cell).oosm_lag == most > 1


def test_the_resolved_study_needs_no_log_and_channels_of_one_instant_are_one_sample(tmp_path):
    taken, late = write_log(tmp_path / "flight", channels=("y1", "y2"))
    two = {"C": [[1.0, 0.0], [0.0, 1.0]]}
    resolved = parse.grid_of(study(tmp_path / "flight", **two), {}, []).study.lti
    assert "in-turn:" not in str(resolved)
    assert resolved.delay == pytest.approx(np.nanmin(late[:-1]) * TICK)
    assert [v == "lost" for v in resolved.delay_sequence] == np.isnan(late[: len(resolved.delay_sequence)]).tolist()
    assert resolved.sampling_pattern == pytest.approx(np.diff(taken) * TICK)


def test_several_logs_are_several_scenarios(tmp_path):
    for name, seed in (("lab", 1), ("field", 2)):
        write_log(tmp_path / name, seed=seed)
    tables = {name: {"base": "cart/gaussian", "delay": f"in-turn:{tmp_path / name}"} for name in ("lab", "field")}
    grid = parse.grid({"name": "two", "scenarios": tables, "observers": ["kf"]}, "two", parse.FROM_HERE)
    lab, field = (cell.times.clocks[0] for cell in grid.cells)
    assert lab.delay_sequence != field.delay_sequence
    assert lab.profile != field.profile


def test_delays_in_turn_are_an_axis_which_tables_show_as_text(tmp_path):
    axes = {"axes": {"delay_sequence": [[0.0, 0.05, "lost"], [0.0]]}}
    grid = parse.grid(MOTOR | {"observers": ["kf"]} | axes, "motor", parse.FROM_HERE)
    assert [cell.values["delay_sequence"] for cell in grid.cells] == ["0, 0.05, lost", "0"]
    late = [s.arrives - s.tick for s in samples_of(grid.cells[0])][:4]
    assert [v if v < NEVER else None for v in late] == [10, 15, None, 10]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"sampling_period": 0.05}, "lti.sampling_period: got 0.05 with the delays of a recording, expected one"),
        ({"delay_sequence": [0.1]}, "lti.delay_sequence: got [0.1] with the delays of a recording"),
        ({"loss": 0.1}, "lti.loss: got 0.1 with the delays of a recording"),
        ({"delay": "in-turn:none"}, "no such file or folder"),
        (
            {"delay_sequence": [math.inf], "delay": 0.1, "sampling_period": 0.1},
            "delay_sequence[0]: got inf, expected a finite number or 'lost'",
        ),
        ({"timestamp_jitter": 0.01}, "got timestamp_jitter with delay_sequence in lti, expected one of them"),
    ],
)
def test_what_does_not_fit_is_one_sentence(tmp_path, more, sentence):
    write_log(tmp_path / "flight")
    with pytest.raises(UserError) as caught:
        parse.grid(study(tmp_path / "flight", **more) | {"observers": ["kf"]}, "motor", parse.FROM_HERE)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("measured", "sentence"),
    [
        ({"channel": ["y1"], "sampled": [1.0], "arrived": [1.1]}, "too few arrivals to be replayed, expected two"),
        ({"channel": ["y1", "y2"] * 2, "sampled": [1.0, 1.0, 2.0, 2.0], "arrived": [1.1, 1.1, 2.1, 2.2]},
         "whose samples at 2 s have different delays, expected one delay per tick"),
        ({"channel": ["y1", "y2"] * 2, "sampled": [1.0, 1.0, 2.0, 2.0], "arrived": [1.1, np.nan, 2.1, 2.1]},
         "whose samples at 1 s have different delays"),
    ],
    ids=["one sample", "late", "lost"],
)  # fmt: skip
def test_a_log_that_cannot_be_replayed_is_one_sentence(tmp_path, measured, sentence):
    rows(tmp_path / "flight", measured | {"value": np.zeros(len(measured["channel"]))})
    with pytest.raises(UserError) as caught:
        parse.grid_of(study(tmp_path / "flight"), {}, [])
    assert sentence in str(caught.value)


def test_a_log_is_as_long_as_it_is_beside_a_scenario_that_is_not_read_yet():
    assert empirical_delays.duration_of({"base": "mine.py:delayed_camera"}) == np.inf
    assert empirical_delays.duration_of({"base": "reactor/batch"}) == SCENARIOS["reactor/batch"].duration != 10.0
    assert empirical_delays.duration_of({"base": "reactor/batch", "duration": 3.0}) == 3.0
    assert empirical_delays.duration_of({}) == 10.0


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (["lost"], "of which all are 'lost', expected a delay among them"),
        (["never"], "got 'never', expected a finite number"),
        ([0.0151], "expected a whole number of ticks"),
        ([-0.1], "-0.1"),
        (0.1, "expected a list of seconds and 'lost'"),
    ],
)
def test_an_axis_that_cannot_be_is_one_sentence(value, sentence):
    with pytest.raises(UserError) as caught:
        parse.grid(
            MOTOR | {"observers": ["kf"], "axes": {"delay_sequence": [value] if isinstance(value, list) else value}},
            "m",
            parse.FROM_HERE,
        )
    assert sentence in str(caught.value)


def test_a_log_as_a_value_of_an_axis_is_told_where_it_belongs():
    with pytest.raises(UserError, match=r"axes\.delay\[0\]: got 'in-turn:flight', expected no recording among"):
        parse.grid(MOTOR | {"observers": ["kf"], "axes": {"delay": ["in-turn:flight"]}}, "m", parse.FROM_HERE)
