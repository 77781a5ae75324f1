"""The tutorial on two sensors of a leg: every block is run in its order, and the numbers that the page shows are compared."""

import json
import shlex
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from documents import PAGES, code_blocks, is_printed, lines, tables
from reference import leg
from scipy.signal import welch

from pcbench.cli import new

PAGE = "synchronous_sensors.md"
HALF_ROW = 0.5 / leg.RATE


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The folder after all blocks, and the JSON of each `tune` and `replay` by the name of its result."""
    folder, out = tmp_path_factory.mktemp("leg"), {}
    for block in code_blocks(PAGE):
        if block.title:
            (folder / block.title).write_text(block.text)
        for line in lines(block.text) if block.language == "sh" else ():
            words = shlex.split(line)[1:]
            as_json = ["--json"] if "--out" in words else []
            command = [sys.executable, "-m", "pcbench", *words, *as_json]
            done = subprocess.run(command, cwd=folder, text=True, capture_output=True, check=False)
            assert done.returncode == 0, done.stderr
            if as_json:
                out[words[-1]] = json.loads(done.stdout)
    return folder, out


@pytest.fixture(scope="module")
def columns():
    """Times, angular velocities and fields of the recording."""
    frame = pd.read_csv(new.TEMPLATES / "recordings" / "leg" / "leg.csv")
    values = [frame[[f"{name}_{axis}" for axis in "xyz"]].to_numpy() for name in ("gyro", "mag")]
    return frame.t.to_numpy(), *values


@pytest.mark.nightly
def test_delays_are_those_of_the_page(printed):
    _, out = printed
    found = [out[name]["delay"]["y1"] for name in ("found", "again")]
    for delay, (_, estimate, interval) in zip(found, tables(PAGES[PAGE], "channel"), strict=True):
        for name, text in zip(("estimate", "low", "high"), (estimate, *interval.split(" to ")), strict=True):
            assert is_printed(delay[name], text)
    moved = found[1]["estimate"] - found[0]["estimate"]
    assert moved == pytest.approx(0.06, abs=2e-4)  # a twentieth of a tick
    assert is_printed(1e3 * moved, "59.9")
    assert "differ by 59.9 ms" in PAGES[PAGE]
    (text,) = [cells[1] for cells in tables(PAGES[PAGE], "method") if "find-delay" in cells[0]]
    assert is_printed(1e3 * (found[0]["estimate"] + HALF_ROW), text)


@pytest.mark.nightly
def test_model_with_the_hum_of_50_hz_is_more_likely(printed):
    folder, out = printed
    for name, (_, *texts) in zip(("plain", "hum"), tables(PAGES[PAGE], "model"), strict=True):
        (row,) = out[name]["innovations"]
        for key, text in zip(("log_likelihood", "log_likelihood_held_out", "nis"), texts, strict=True):
            assert is_printed(row[key], text)
        assert row["ljung_box_p"] < 1e-100
    assert out["found"]["kept_start"]
    assert out["found"]["held_out"]["tuned"]["ljung_box_p"] < 1e-100
    innovations = pd.read_parquet(folder / "plain" / "innovations.parquet")["kf.innovation"].dropna().to_numpy()
    frequency, power = welch(innovations[600:], leg.RATE, nperseg=480)
    fast = frequency > 5.0  # above the rates of a walk
    assert frequency[fast][power[fast].argmax()] == 50.0
    assert power[frequency == 50.0] > 50 * power[(frequency > 40.0) & (frequency < 48.0)].mean()


@pytest.mark.ci
def test_lags_by_least_squares_are_those_of_the_page(columns):
    t, w, m = columns
    texts = {name: text for name, text in tables(PAGES[PAGE], "method") if "find-delay" not in name}
    for name, text in texts.items():
        number = int("".join(c for c in name if c.isdigit()))
        if "angle" in name:
            lag = leg.lag_in_plane(t, leg.rate(w, m), leg.angle(m), number)
        else:
            lag, rest = leg.lag_in_space(t, w, m, number)
            assert rest < 0.011  # the field is constant: it turns as the gyroscope measures
        assert is_printed(1e3 * lag, text), name
        assert abs(lag) < 1.6e-3
    assert len(texts) == 5


@pytest.mark.ci
@pytest.mark.parametrize("later", [-2, 1, 3])
def test_least_squares_find_a_lag_of_whole_rows(columns, later):
    """To a tenth of the step between the lags that are tried."""
    t, w, m = columns
    there, back = slice(max(later, 0), len(t) + min(later, 0)), slice(max(-later, 0), len(t) - max(later, 0))
    u, y = leg.rate(w, m), leg.angle(m)
    lags = (leg.lag_in_plane(t[there], u[there], y[back], 3), leg.lag_in_space(t[there], w[there], m[back], 8)[0])
    before = (leg.lag_in_plane(t, u, y, 3), leg.lag_in_space(t, w, m, 8)[0])
    assert np.subtract(lags, before) == pytest.approx(later / leg.RATE, abs=2e-4)


def test_page_shows_every_kind_of_block():
    assert [block.title for block in code_blocks(PAGE) if block.title] == ["leg.toml", "late.toml", "hum.toml"]
