"""The page of a replay: its numbers are those of the replay, thinning keeps extremes, and it is drawn without complaints."""

import json
import re

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from browser import CHROMIUM, inspect_page
from commands import call
from logged import MOTOR
from reference import logs as reference

import pcbench
from pcbench.errors import UserError
from pcbench.playback import setup
from pcbench.plots import replay_frames, replays
from pcbench.plots.layout import PAPER
from pcbench.report import page, replay_page
from pcbench.report.captions import number as short

TWO = MOTOR | {
    "lti": MOTOR["lti"]
    | {
        "C": [[1.0, 0.0], [0.3, 2.0]],
        "sampling_period": [0.05, 0.02],
        "delay": [0.1, 0.0],
        "delay_jitter": [0.1, 0.0],
        "noise_std": [0.1, 0.2],
    }
}
OBSERVERS = ["kf", "ekf", "model-only"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Replays of two sensors: with the truth, and without it and without a filter."""
    out = tmp_path_factory.mktemp("replays")
    pcbench.simulate(TWO, "kf", seed=5, log=out / "log")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setup, "LENGTH", 64)  # ticks of a part
        pcbench.replay(out / "log", TWO, OBSERVERS, out=out / "full")
    (out / "log" / "truth.parquet").unlink()
    pcbench.replay(out / "log", TWO, "model-only", out=out / "bare")
    return out


@pytest.fixture(scope="module")
def full(folders):
    assert pq.ParquetFile(folders / "full" / "estimates.parquet").num_row_groups > 3
    return replay_frames.open_replay(folders / "full")


def rows(folder, observer, channel):
    found = pd.read_parquet(folder / "innovations.parquet")
    found = found[found.channel == channel]
    return found.arrived, found[f"{observer}.innovation"], found[f"{observer}.innovation.sigma"]


@pytest.mark.ci
def test_page_is_one_file_with_the_numbers_of_the_replay(folders, full):
    text = replay_page.page(full)
    assert len(text) < 1.2e6
    assert not re.search(r'(src|href)="(?!#|data:)', text)
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'<li><a href="#([^"]+)"', text)) == set(re.findall(r'<section id="([^"]+)"', text))
    assert len(text.rpartition("<script>")[2]) < 1000, "the script of the interactive figure is not in it"
    about = json.loads((folders / "full" / "replay.json").read_text())
    for row in about["innovations"]:
        assert short(row["nis"]) in text
    for row in about["distances"]:
        assert short(row["rms"]) in text
    assert {f"state-{s}" for s in ("angle", "rate")} | {f"innovations-{c}" for c in ("y1", "y2")} <= set(ids)
    assert re.search("unit.of.the.channel", text), "no state is the second output"
    assert all(sentence in text for sentence in about["notes"])


@pytest.mark.ci
@pytest.mark.parametrize("channel", ["y1", "y2"])
def test_innovations_of_a_channel_are_those_of_the_file(folders, full, channel):
    _, nu, sigma = rows(folders / "full", "kf", channel)
    found = replay_frames.innovations(full, "kf", channel)
    z = (nu / sigma).to_numpy()
    assert found.many == len(z)
    assert found.outside == np.mean(np.abs(z) > 1.959963984540054)
    r_h = [sum(z[i] * z[i - h] for i in range(h, len(z))) / sum(z**2) for h in range(1, 21)]
    lags = min(20, len(z) // 5)
    np.testing.assert_allclose(found.autocorrelation, r_h[:lags], rtol=0, atol=1e-12)
    Q, _ = reference.ljung_box(z, lags)
    weights = len(z) * (len(z) + 2) / (len(z) - np.arange(1, lags + 1))
    assert found.autocorrelation**2 @ weights == pytest.approx(Q, rel=1e-10)
    assert {found.samples.innovation.max(), found.samples.innovation.min()} == {nu.max(), nu.min()}


@pytest.mark.ci
def test_likelihood_over_time_has_the_mean_of_the_whole(folders, full, monkeypatch):
    monkeypatch.setattr(replay_frames, "PERIODS", 7)
    found = replay_frames.log_likelihood(full, "kf")
    every = pd.concat(
        [pd.DataFrame(dict(zip("tns", rows(folders / "full", "kf", c), strict=True))) for c in ("y1", "y2")]
    )
    each = -0.5 * (np.log(2 * np.pi * every.s**2) + (every.n / every.s) ** 2)
    part = np.minimum((every.t / full.end * 7).astype(int), 6)
    np.testing.assert_allclose(found.value, each.groupby(part).mean(), rtol=1e-12)
    assert each.mean() == pytest.approx(full.summary["innovations"][0]["log_likelihood"], rel=1e-12)


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [(27.96, 32.11, "28.0 s to 32.1 s"), (499.98, 500.02, "499.980 s to 500.020 s"), (30.0, 900.0, "30 s to 900 s")],
)
def test_short_time_has_the_digits_that_it_needs(low, high, words):
    assert replays.span(low, high) == words


def test_extremes_are_the_least_and_largest_of_each_bin():
    rng = np.random.default_rng(3)
    bins, values = np.sort(rng.integers(0, 9, 200)), rng.normal(size=200)
    values[rng.integers(0, 200, 30)] = np.nan
    values[bins == 4] = np.nan
    want = set()
    for each in {*bins} - {4}:
        here = np.flatnonzero(bins == each)
        want |= {here[np.nanargmin(values[here])], here[np.nanargmax(values[here])]}
    assert set(replay_frames.extremes(bins, values)) == want
    assert not len(replay_frames.extremes(bins[:0], values[:0]))
    assert not len(replay_frames.extremes(bins, np.full(200, np.nan)))


@pytest.mark.ci
def test_states_and_errors_are_those_of_the_file_in_parts_too(folders, full, monkeypatch):
    estimates = pd.read_parquet(folders / "full" / "estimates.parquet")
    monkeypatch.setattr(replay_frames, "BINS", 10**6)  # nothing is thinned
    found = replay_frames.states(full, "kf", "rate")
    np.testing.assert_array_equal(found.error, estimates["rate"] - estimates["kf.rate"])
    np.testing.assert_array_equal(found.sigma, estimates["kf.rate.sigma"])
    bare = full._replace(truth=[])
    smoothed = pd.read_parquet(folders / "full" / "smoothed.parquet")
    np.testing.assert_array_equal(replay_frames.states(bare, "kf", "rate").error, smoothed.rate - estimates["kf.rate"])
    low, high = replays.excerpt_of(full)
    part = replay_frames.excerpt(full, "kf", "angle", low, high)
    here = estimates.t.between(low, high)
    np.testing.assert_array_equal(part.estimate, estimates["kf.angle"][here])
    np.testing.assert_array_equal(part.truth, estimates.angle[here])
    np.testing.assert_array_equal(part.smoothed, smoothed.angle[here])


@pytest.mark.ci
def test_command_writes_a_page_or_figures_and_refuses_options_of_studies(folders, tmp_path):
    where = str(folders / "full")
    done = call("report", where, "--out", str(tmp_path / "page.html"), "--signal", "rate")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "page.html").read_text()
    assert "state-rate" in text
    assert "state-angle" not in text
    done = call("report", where, "--figures", str(tmp_path / "figures"), "--formats", "svg")
    assert done.returncode == 0, done.stderr
    names = [
        "likelihood",
        "state-angle",
        "state-rate",
        *(f"{k}-{c}" for c in ("y1", "y2") for k in ("innovations", "autocorrelation")),
    ]
    assert sorted(p.stem for p in (tmp_path / "figures").iterdir()) == sorted(names)
    for words, sentence in (
        (["--metric", "mae"], "--metric has no effect with a replay"),
        (["--seed", "3"], "--seed has no effect with a replay"),
        (["--signal", "rat"], "did you mean 'rate'"),
    ):
        done = call("report", where, *words)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert sentence in done.stderr


def test_replay_without_all_its_files_is_one_sentence(folders, tmp_path):
    (tmp_path / "replay.json").write_text((folders / "full" / "replay.json").read_text())
    with pytest.raises(UserError, match=r"got a replay that cannot be read .*; write it again with pcbench replay\."):
        replay_frames.open_replay(tmp_path)
    assert not replay_frames.is_replay(folders / "log")


@pytest.mark.ci
def test_page_of_an_observer_without_innovations_has_its_states(folders):
    text = replay_page.page(replay_frames.open_replay(folders / "bare"))
    assert "state-rate" in text
    assert "Innovation tests" not in text
    assert "smoothed minus estimated rate" in text


@pytest.mark.ci
def test_names_of_channels_are_escaped(folders, full):
    outputs = [row | {"channel": "<b>/y"} if row["channel"] == "y1" else row for row in full.summary["outputs"]]
    odd = full._replace(summary=full.summary | {"outputs": outputs, "notes": ["<script>"], "log": "<i>"})
    text = replay_page.page(odd)
    assert "<script>" not in text.partition('<script>"use strict"')[0]
    assert "<i>" not in text
    assert [s.anchor for s in replay_page.sections(odd, None, PAPER)] == ["innovations", "states", "channel-y2"]


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="no browser here: the layout is not looked at")
@pytest.mark.parametrize(("width", "paper"), [(390, False), (1024, False), (1400, False), (718, True)])
@pytest.mark.parametrize("name", ["full", "bare"])
def test_page_is_drawn_without_complaints(folders, tmp_path, name, width, paper):
    page.write_page(replay_page.page(replay_frames.open_replay(folders / name)), tmp_path / "report.html")
    seen = inspect_page(tmp_path / "report.html", tmp_path, width, paper)
    assert seen["pictures"] == (7 if name == "full" else 2)
    assert not seen["complaints"]
    assert not seen["console"]
