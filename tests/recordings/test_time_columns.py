"""Times, units and truth of a table that cannot be right: each is said in one sentence, and nothing is guessed instead."""

import re

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import contents, readers

PLANT = {
    "name": "cart",
    "lti": {
        "A": [[0.0, 1.0], [0.0, -0.5]],
        "B": [[0.0], [1.0]],
        "C": [[1.0, 0.0]],
        "states": ["x [m]", "v [m/s]"],
        "tick": 0.01,
        "sampling_period": 0.05,
        "delay": 0.0,
        "noise_std": 0.02,
        "process_std": [0.0, 0.01],
        "duration": 20.0,
    },
}
CHANNEL = {"field": "y", "unit": "m", "delay": 0.0}


def table(folder, t, **columns):
    """A CSV of times and a position."""
    frame = pd.DataFrame({"t": t, "y": np.sin(np.arange(len(t))).round(4), "z": 1.5, **columns})
    frame.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def toml(folder, channel=(), **whole):
    """A TOML of that CSV with an input that it does not have."""
    lines = [f"{key} = {value!r}" for key, value in {"log": "log.csv", **whole}.items()]
    lines += ["[channels.y1]", *(f"{key} = {value!r}" for key, value in {**CHANNEL, **dict(channel)}.items())]
    (folder / "log.toml").write_text("\n".join(lines) + "\n")
    return folder / "log.toml"


RISING = [round(0.05 * i, 2) for i in range(40)]
WRONG = {
    "swapped": ([*RISING[:9], RISING[10], RISING[9], *RISING[11:]], "does not rise in 1 row: sort"),
    "doubled": ([*RISING[:9], *RISING[8:]], "does not rise in 1 row: sort"),
    "reversed": (RISING[::-1], "does not rise in 39 rows"),
    "empty": ([*RISING[:9], None, None, *RISING[11:]], "is empty in 2 rows: remove them"),
    "durations": ([f"PT{t}S" for t in RISING], "contains text that is not a time"),
    "zone by its name": ([f"2026-03-01 12:00:{t:06.3f} CEST" for t in RISING], "contains text that is not a time"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_column_of_times_is_named_and_never_replaced_by_a_period(name, tmp_path):
    times, words = WRONG[name]
    log = table(tmp_path, times)
    (found,) = contents.contents(log)
    assert found.stamp == "t"
    assert words in found.problem
    text = contents.starter_toml(log, [found], tmp_path)
    assert "period" not in text
    (tmp_path / "start.toml").write_text(text)
    if name in ("swapped", "doubled", "reversed"):  # measurements may be out of order
        assert pcbench.info(tmp_path / "start.toml").samples.tolist() == [len(times)]
    else:
        with pytest.raises(UserError):
            pcbench.info(tmp_path / "start.toml")


def two_columns(folder, zones, blank=""):
    """A CSV of dates, each with its zone, and a position."""
    dates = [f"2026-03-01 12:00:{t:06.3f}{blank}{zone}" for t, zone in zip(RISING, zones, strict=True)]
    (folder / "log.csv").write_text("t,y\n" + "".join(f"{date},1.0\n" for date in dates))
    return folder / "log.csv"


@pytest.mark.parametrize("zone", ["CEST", "Europe/Berlin", "GMT+2", "UTC", "+0200", "-03:30"])
def test_blanks_within_a_date_separate_no_columns(zone, tmp_path):
    log = two_columns(tmp_path, [zone] * len(RISING), " ")
    (found,) = contents.contents(log)
    assert (found.stamp, found.topic.numbers) == ("t", ["y"])
    assert (
        found.problem
        == "column 't' contains text that is not a time, expected seconds or ISO 8601; convert its values."
    )
    with pytest.raises(
        UserError, match=rf"t: got '2026-03-01 12:00:00.000 {re.escape(zone)}', expected numbers, or times"
    ):
        pcbench.info(toml(tmp_path))


def test_blanks_separate_dates_and_numbers_of_a_table_without_commas(tmp_path):
    (tmp_path / "log.csv").write_text("day t y\n" + "".join(f"2026-03-01 12:00:{t:06.3f} {t}\n" for t in RISING))
    (found,) = contents.contents(tmp_path / "log.csv")
    assert found.topic.numbers == ["y"]
    assert found.topic.times == ["day", "t"]


@pytest.mark.parametrize("first", ["", "Z", "+02:00"])
@pytest.mark.parametrize("later", [1, 39, 3000])  # the last is behind the lines by which the types are found
def test_times_with_and_without_a_zone_are_refused(first, later, tmp_path):
    other = "" if first else "+02:00"
    dates = np.datetime64("2026-03-01T12:00:00.000") + 50 * np.arange(max(later, 39) + 1).astype("timedelta64[ms]")
    lines = [f"{date}{other if i == later else first},1.0\n" for i, date in enumerate(dates)]
    (tmp_path / "log.csv").write_text("t,y\n" + "".join(lines))
    got, expected = ("with", "none") if other else ("without", "one")
    words = (
        f"log.csv: row {later + 1}: got '{dates[later]}{other}' {got} a time zone as t, expected {expected} as in the rows "
        "before; give all times a time zone, or none."
    )
    for read in (lambda: contents.contents(tmp_path / "log.csv"), lambda: pcbench.info(toml(tmp_path))):
        with pytest.raises(UserError, match=rf"^{re.escape(words)}$"):
            read()


def test_different_zones_are_one_time(tmp_path):
    """An hour later on a clock that is two hours ahead is an hour earlier."""
    (tmp_path / "log.csv").write_text("t,y\n2026-03-01T12:00:00Z,1.0\n2026-03-01T14:00:01+02:00,2.0\n")
    (found,) = contents.contents(tmp_path / "log.csv")
    assert found.problem == ""
    assert pcbench.info(toml(tmp_path)).samples.tolist() == [2]


def test_columns_of_one_name_are_named(tmp_path):
    (tmp_path / "log.csv").write_text("t,y,y,z\n" + "".join(f"{t},1,2,{t}\n" for t in RISING))
    (found,) = contents.contents(tmp_path / "log.csv")
    assert found.problem == "2 columns 'y': left out, as their names are the same; rename them."


@pytest.mark.parametrize(
    ("whole", "channel", "words"),
    [
        ({"period": 0.1}, {}, "got a period and the column 't' of times in log.csv"),
        ({"period": 0.1}, {"sampled": "t"}, "got a period and times of channels.y1"),
        ({}, {"period": 0.1}, "got a period and the column 't' of times"),
    ],
)
def test_a_period_and_times_are_refused(whole, channel, words, tmp_path):
    table(tmp_path, RISING)
    with pytest.raises(UserError, match=words):
        readers.open_log(toml(tmp_path, channel, **whole))


def test_a_period_of_a_channel_alone_is_refused(tmp_path):
    pd.DataFrame({"y": RISING, "u": RISING, "seconds": RISING}).to_csv(tmp_path / "log.csv", index=False)
    file = toml(tmp_path, {"period": 0.05})
    file.write_text(file.read_text() + '[inputs.u1]\nfield = "u"\nunit = "V"\n')
    with pytest.raises(UserError, match=r"got a period of channels.y1 and no time of inputs.u1"):
        readers.open_log(file)


def test_a_period_alone_is_taken(tmp_path):
    pd.DataFrame({"y": RISING}).to_csv(tmp_path / "log.csv", index=False)
    assert pcbench.info(toml(tmp_path, period=0.05)).samples.tolist() == [40]


@pytest.mark.parametrize("unit", ["mm", "rad"])
def test_another_unit_than_the_plants_is_refused(unit, tmp_path):
    table(tmp_path, RISING)
    with pytest.raises(UserError, match=rf"channels.y1: got the unit {unit}, expected m as in the plant"):
        pcbench.replay(toml(tmp_path, {"unit": unit}), PLANT, "kf")


@pytest.mark.ci
def test_an_unknown_unit_is_taken(tmp_path):
    table(tmp_path, RISING)
    assert len(pcbench.replay(toml(tmp_path, {"unit": "1"}), PLANT, "kf").innovations) == 1


def frames(truth):
    """A recording of 2 s with a truth."""
    t = np.arange(0, 2.01, 0.05)
    measured = pd.DataFrame({"channel": "y1", "sampled": t, "arrived": t, "value": np.sin(t)})
    return {"measurements": measured, "truth": truth}


def of_truth(t, name="x"):
    return pd.DataFrame({"t": t, name: np.sin(t)})


@pytest.mark.ci
def test_truth_where_there_are_no_measurements_is_not_compared():
    """A truth that goes on for 3 s after the last measurement gives the errors of one that ends with it."""
    short, long = (pcbench.replay(frames(of_truth(np.arange(0, end, 0.01))), PLANT, "kf") for end in (2.255, 5.0))
    pd.testing.assert_frame_equal(short.metrics, long.metrics)
    assert any("truth before -0.25 s and after 2.25 s is left out" in each for each in long.summary["notes"])
    assert not any("truth" in each for each in short.summary["notes"])


@pytest.mark.ci
def test_truth_of_another_time_or_name_or_without_values():
    with pytest.raises(UserError, match=r"got truth from 1000 to 1002 s and measurements from 0 to 2 s"):
        pcbench.replay(frames(of_truth(1000 + np.arange(0, 2.001, 0.01))), PLANT, "kf")
    both = of_truth(np.arange(0, 2, 0.01)).assign(pos=1.0)
    assert (
        "truth: pos: no state of the plant (x, v); left out."
        in pcbench.replay(frames(both), PLANT, "kf").summary["notes"]
    )
    empty = of_truth(np.arange(0, 2, 0.01)).assign(x=np.nan)
    found = pcbench.replay(frames(empty), PLANT, "kf")
    assert any("a truth without any value" in each for each in found.summary["notes"])
    assert found.metrics.empty


def test_a_toml_without_a_channel_says_so(tmp_path):
    table(tmp_path, RISING)
    (tmp_path / "log.toml").write_text('log = "log.csv"\n')
    with pytest.raises(UserError, match=r"got no channel, expected one at least; write \[channels.y1\]"):
        readers.open_log(tmp_path / "log.toml")


def test_another_unit_of_time_than_the_heads_is_refused(tmp_path):
    pd.DataFrame({"t [ms]": RISING, "y": RISING}).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(UserError, match=r"got the time_unit s, expected ms as in the head"):
        pcbench.info(toml(tmp_path, time_unit="s"))


@pytest.mark.filterwarnings("error")
def test_infinite_values_give_no_warning(tmp_path):
    """Logs of flights have them where nothing was estimated yet."""
    log = table(tmp_path, RISING, w=[np.inf] * len(RISING))
    (found,) = contents.contents(log)
    assert found.problem == ""
