"""A fast recording is what a slow, delayed sensor would have brought, and the rest of it is the truth."""

import numpy as np
import pandas as pd
import pytest
import tomli_w
from commands import call
from logged import MOTOR, rows

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import readers, thinning

T = np.arange(400) * 0.01
FAST = {"channel": ["y1"] * 400, "sampled": T, "arrived": T, "value": np.sin(T)}


def test_thinned_recording_keeps_every_tenth_and_the_truth_has_all(tmp_path):
    both = {name: list(values) + list(values) for name, values in FAST.items()}
    both["channel"] = ["y1"] * 400 + ["y2"] * 400
    both["value"] = [*np.sin(T), *np.cos(T)]
    inputs = {"t": [0.0, 1.0], "u1": [0.5, -0.5]}
    log = readers.open_log(rows(tmp_path / "fast", both, inputs))
    laws = {"y1": np.array([0.1, np.nan]), "y2": np.array([0.3])}
    found = {name: t.to_pandas() for name, t in thinning.thin_tables(log, 10, laws, ["p", "q"], seed=2).items()}
    for channel, wave in (("y1", np.sin), ("y2", np.cos)):
        mine = found["measurements"][found["measurements"].channel == channel]
        np.testing.assert_array_equal(mine.sampled, T[::10])
        np.testing.assert_array_equal(mine.value, wave(T[::10]))
    late = (found["measurements"].arrived - found["measurements"].sampled).to_numpy()
    first = (found["measurements"].channel == "y1").to_numpy()
    assert 8 < np.isnan(late[first]).sum() < 32, "half of them are lost"
    np.testing.assert_allclose(late[first & ~np.isnan(late)], 0.1, atol=1e-12)
    np.testing.assert_allclose(late[~first], 0.3, atol=1e-12)
    np.testing.assert_array_equal(found["truth"][["t", "p", "q"]], np.stack([T, np.sin(T), np.cos(T)], 1))
    np.testing.assert_array_equal(found["inputs"], pd.DataFrame(inputs))


def test_delays_of_another_recording_are_those_of_its_channel(tmp_path):
    slow = {"channel": ["a", "b"] * 20, "sampled": T[:40], "arrived": T[:40] + np.tile([0.1, 0.2], 20), "value": T[:40]}
    other = readers.open_log(rows(tmp_path / "slow", slow))
    np.testing.assert_allclose(thinning.delays_of(other, ["b"])["b"], np.full(20, 0.2))
    with pytest.raises(UserError, match=r"got measurements\.csv with the channels a, b, expected y1 among them"):
        thinning.delays_of(other, ["y1"])
    one = readers.open_log(rows(tmp_path / "one", {name: values[:20] for name, values in FAST.items()}))
    np.testing.assert_array_equal(thinning.delays_of(one, ["y1", "y2"])["y2"], np.zeros(20))


@pytest.mark.ci
def test_convert_leaves_a_recording_that_replays_or_nothing(tmp_path):
    rows(tmp_path / "fast", {name: values for name, values in FAST.items() if name != "arrived"})
    rows(tmp_path / "camera", FAST | {"arrived": T + 0.1})
    (tmp_path / "motor.toml").write_text(tomli_w.dumps(MOTOR))
    words = ["convert", "fast", "--thin", "10", "--delay", "from:camera", "--truth", "angle", "--out", "slow"]
    for wrong in (["from:none"], ["much"], ["-1"], ["from:camera", "--truth", "a,b"], ["from:camera", "--thin", "0"]):
        done = call("convert", "fast", "--out", "slow", "--delay", *wrong, cwd=tmp_path)
        assert (done.returncode, "Traceback" in done.stderr) == (2, False), wrong
        assert not (tmp_path / "slow").exists()
    done = call(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = pcbench.replay(tmp_path / "slow", MOTOR, "kf")
    assert found.summary["rows"] == 40
    assert set(found.metrics.signal) == {"angle"}
    again = call(*words, cwd=tmp_path)
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
