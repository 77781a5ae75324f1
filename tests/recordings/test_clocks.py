"""Times of two clocks in one log are refused in one sentence by every command that reads it, and nothing is written."""

import subprocess
import sys

import numpy as np
import pytest
import tomli_w
from logged import MOTOR, plain, rows
from scipy.io import savemat

import pcbench
from pcbench.errors import UserError
from pcbench.playback.setup import open_playback
from pcbench.recordings import readers, times
from pcbench.recordings.running_stats import RunningStats, add
from pcbench.recordings.survey import survey

PCBENCH = [sys.executable, "-m", "pcbench"]
UNIX = 1.7e9  # [s] of the time of day, 53.9 years after 0


def change(column, row, value):
    out = plain()
    out[column] = np.array(out[column], float)
    out[column][row - 1] = value
    return out


def two_channels():
    first, second = plain(), plain()
    second = second | {"channel": ["y2"] * 40, "sampled": second["sampled"] + UNIX, "arrived": second["arrived"] + UNIX}
    return {name: [*first[name], *second[name]] for name in first}


INPUTS = {"t": np.arange(3) * 0.5, "u1": np.ones(3)}
LOGS = {
    "arrivals": (
        plain() | {"arrived": plain()["arrived"] + UNIX},
        None,
        "the stamps of channel y1 end at 1.95 s and the arrivals of channel y1 begin at 1700000000 s, 53.9 years apart, so "
        "they are of two clocks or units; convert the arrivals to the clock of the stamps, or leave them out and give a delay.",
    ),
    "stamps": (
        plain() | {"sampled": plain()["sampled"] + UNIX},
        None,
        "row 1 of channel y1: the stamp 1700000000 s is 53.9 years after the arrival 0.1 s",
    ),
    "one stamp": (
        {k: np.array(v, float) + UNIX if k in ("sampled", "arrived") else v for k, v in plain().items()}
        | {"sampled": np.append(0.0, plain()["sampled"][1:] + UNIX)},
        None,
        "row 1 has 0 s among the stamps of channel y1, 53.9 years before the other times of the log, so it is of another "
        "clock; remove that row or convert its time.",
    ),
    "one late arrival": (
        change("arrived", 7, UNIX),
        None,
        "row 7 has 1700000000 s among the arrivals of channel y1, 53.9 years after",
    ),
    "inputs": (
        plain(),
        INPUTS | {"t": INPUTS["t"] + UNIX},
        "the stamps of channel y1 and others end at 2.05 s and the times of the inputs begin at 1700000000 s, 53.9 years "
        "apart, so they are of two clocks or units; convert the times of the inputs to the clock of the stamps.",
    ),
    "one input": (plain(), {"t": [0.0, UNIX], "u1": [1.0, 1.0]}, "row 2 has 1700000000 s among the times of the inputs"),
    "channels": (two_channels(), None, "convert its stamps to the clock of the other channels"),
    "milliseconds": (plain(), INPUTS | {"t": 1e7 + 1e3 * INPUTS["t"]}, "begin at 10000000 s, 116 days apart"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("name", LOGS)
def test_times_of_two_clocks_are_refused_by_all_that_read_a_log(tmp_path, name, kind):
    measured, inputs, sentence = LOGS[name]
    folder = rows(tmp_path / "log", measured, inputs, kind)
    study = {"name": "own", "scenarios": {"own": {"base": "cart/white", "delay": f"from:{folder}"}}}
    for read in (
        lambda: pcbench.info(folder),
        lambda: open_playback(folder, MOTOR, ["kf"]),
        lambda: pcbench.run(study, observers=["kf"]),
    ):
        with pytest.raises(UserError) as caught:
            read()
        assert sentence in str(caught.value)
        assert str(caught.value).count(". ") == 0


def test_truth_of_another_unit_is_refused(tmp_path):
    """Milliseconds read as seconds: 10 s become 10,000."""
    folder = rows(tmp_path / "log", plain())
    (folder / "truth.csv").write_text("t,angle,rate\n" + "".join(f"{10_000 + 50 * k},0,0\n" for k in range(9)))
    with pytest.raises(UserError, match=r"times of the truth begin at 10000 s, 2\.78 hours apart"):
        pcbench.info(folder)


def test_readers_that_need_a_toml_are_checked_too(tmp_path):
    t = np.arange(30) * 0.1
    savemat(tmp_path / "run.mat", {"t": t, "y": np.sin(t), "late": t + UNIX})
    (tmp_path / "run.csv").write_text("t,y,late\n" + "".join(f"{a},{np.sin(a)},{a + UNIX}\n" for a in t))
    for kind in ("mat", "csv"):
        column = {"field": "y", "unit": "m", "arrived": "late"}
        (tmp_path / "log.toml").write_text(tomli_w.dumps({"log": f"run.{kind}", "channels": {"y1": column}}))
        with pytest.raises(UserError, match=r"log\.toml: the stamps of channel y1 end at 2\.9 s"):
            pcbench.info(tmp_path / "log.toml")


def test_a_start_of_another_clock_is_refused(tmp_path):
    folder = rows(tmp_path / "log", plain() | {k: plain()[k] + UNIX for k in ("sampled", "arrived")})
    with pytest.raises(
        UserError,
        match=r"40 rows cover 169,999,999,705 ticks of 0\.01 s, from 5 s to 1700000002 s, more than 10 durations",
    ):
        open_playback(folder, MOTOR, ["kf"], start=5.0)


def test_gaps_and_delays_of_one_clock_are_no_second_clock(tmp_path):
    """A pause of an hour, one stamp of 0 in a minute since boot, a delay as long as the log, days between few rows."""
    t = plain()["sampled"]
    for changes in (
        {"sampled": np.where(t < 1, t, t + 3599), "arrived": np.where(t < 1, t, t + 3599)},
        {"sampled": np.append(0.0, t[1:] + 60), "arrived": t + 60},
        {"arrived": t + 3},
        {"sampled": 4e6 * t, "arrived": 4e6 * t},
        {"sampled": t + UNIX, "arrived": t + UNIX + 0.1},
    ):
        found = survey(readers.open_log(rows(tmp_path / "log", plain() | changes)))
        assert found.rows == 40


@pytest.mark.parametrize("seed", range(3))
def test_a_gap_is_found_wherever_it_is(seed):
    """Against a sort of all times: one group of a log is moved away by more than all its rows cover."""
    random = np.random.default_rng(seed)
    columns = [np.sort(random.uniform(0, 100, 50)) for _ in range(4)]
    far = random.integers(4)

    def moved(shift):
        every = [c + shift * (i == far) for i, c in enumerate(columns)]
        return [
            times.TimeColumn(str(i), "fix", add(RunningStats(), np.arange(1.0, 51.0), c)) for i, c in enumerate(every)
        ]

    times.require_one_clock("log", moved(0.0))
    times.require_one_clock("log", moved(times.HOUR * 0.99))
    with pytest.raises(UserError, match="1.0[0-9] hours apart" if far else "apart"):
        times.require_one_clock("log", moved(times.HOUR * 1.06))


@pytest.mark.ci
def test_a_replay_of_two_clocks_ends_within_seconds_and_writes_nothing(tmp_path):
    measured, inputs, _ = LOGS["inputs"]
    rows(tmp_path / "log", measured, inputs)
    (tmp_path / "motor.toml").write_text(tomli_w.dumps(MOTOR))
    words = ["replay", "log", "--plant", "motor.toml", "--observers", "kf", "--out", "out"]
    done = subprocess.run([*PCBENCH, *words], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "53.9 years apart" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
