"""The car's recording: what its README says of it, its delay against the truth, and its likelihood, which uses no truth."""

import numpy as np
import pandas as pd
import pytest
from reference import car

import pcbench
from pcbench.cli import new

PLANT = {
    "name": "car",
    "lti": {
        "A": [[0.0, 1.0], [0.0, 0.0]],
        "B": [[1.0], [0.0]],
        "C": [[1.0, 0.0]],
        "states": ["speed [m/s]", "bias [m/s^2]"],
        "xhat0": list(car.X0),
        "prior_std": [1.0, 1.0],
        "tick": car.DT,
        "sampling_period": 0.1,
        "delay": 0.0,
        "noise_std": 0.07,
        "process_std": [0.0, 0.005],
        "duration": 60.0,
    },
}
SKIPPED = 2  # measurements that would have been taken before the first tick


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """The tables of the recording that `pcbench new recording` writes."""
    folder = tmp_path_factory.mktemp("here")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        new.new("recording", "car")
    return {name: pd.read_csv(folder / "car" / f"{name}.csv") for name in ("measurements", "inputs", "truth")}


def test_command_writes_the_recording_with_its_source_and_licence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    new.new("recording", "car")
    assert "pcbench info car" in capsys.readouterr().out
    names = {"measurements.csv", "inputs.csv", "truth.csv", "README.md", "LICENSE"}
    assert {p.name for p in (tmp_path / "car").iterdir()} == names
    assert sum(p.stat().st_size for p in (tmp_path / "car").iterdir()) < 350_000
    assert "MIT License" in (tmp_path / "car" / "LICENSE").read_text()
    assert "commaai/comma2k19" in (tmp_path / "car" / "README.md").read_text()
    with pytest.raises(pcbench.UserError, match="car exists already"):
        new.new("recording", "car")


def test_rates_are_those_of_its_readme(tables):
    for name, column, rate in (("measurements", "sampled", 10), ("inputs", "t", 104), ("truth", "t", 20)):
        assert 1 / tables[name][column].diff().median() == pytest.approx(rate, rel=5e-3)
        assert tables[name][column].iloc[-1] == pytest.approx(60.0, abs=0.2)


def test_least_squares_delay_is_0_135_s(tables):
    """And 0.158 s of successive differences, which are rapid changes of the speed: the delay is not that of all frequencies."""
    m, true = tables["measurements"], tables["truth"]
    both = [m.sampled.to_numpy(), m.value.to_numpy(), true.t.to_numpy(), true.speed.to_numpy()]
    delay, rest = car.least_squares_delay(*both)
    assert delay == pytest.approx(0.1357, abs=1e-4)
    assert rest == pytest.approx(0.0614, abs=1e-4)
    assert car.least_squares_delay(*both, order=1)[0] == pytest.approx(0.1578, abs=1e-4)


@pytest.mark.ci
@pytest.mark.parametrize("delay", [0, 33, 70, 80])
def test_replay_has_the_likelihood_of_the_reference(tables, delay):
    r = car.record(tables["measurements"], tables["inputs"], 0.0, 60.0, SKIPPED)
    times = {"sampled": (r.stamped - delay) * car.DT, "arrived": r.stamped * car.DT}
    log = {"measurements": pd.DataFrame({"channel": "y1", **times, "value": r.value}), "inputs": tables["inputs"]}
    found = pcbench.replay(log, PLANT, "kf", start=0.0)
    each = car.log_likelihoods(0.07**2, 0.005**2, r, delay)
    (row,) = found.innovations.to_dict("records")
    assert row["log_likelihood"] == pytest.approx(each.mean(), rel=1e-10)
    late = r.stamped >= int(car.HELD_OUT * found.summary["ticks"])
    assert row["log_likelihood_held_out"] == pytest.approx(each[late].mean(), rel=1e-10)


@pytest.mark.ci
def test_likelihood_is_largest_near_the_delay(tables):
    """Of the held-out part at 0.14 s, of all measurements at 0.16 s, with a 95 % interval from 0.144 to 0.164 s."""
    r = car.record(tables["measurements"], tables["inputs"], 0.0, 60.0, SKIPPED)
    delays = np.array([0, *range(50, 101, 2)])
    peaks = [car.peak(r, delay) for delay in delays]
    total, held_out = (np.array([getattr(p, name) for p in peaks]) for name in ("total", "held_out"))
    assert delays[held_out.argmax()] * car.DT == pytest.approx(0.14)
    assert delays[total.argmax()] * car.DT == pytest.approx(0.16)
    inside = delays[2 * (total.max() - total) < 3.841] * car.DT
    assert [inside.min(), inside.max()] == pytest.approx([0.144, 0.164])  # of those that are tried
    assert total.max() - total[0] > 80
