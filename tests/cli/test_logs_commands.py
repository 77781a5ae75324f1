"""The commands for recorded data: what they print, what they leave, and that a mistake is one sentence with exit code 2."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import tomli_w
from commands import call
from logged import MOTOR, plain, rows

import pcbench
from pcbench import plots
from pcbench.cli import export
from pcbench.dataset import storage
from pcbench.export import files
from pcbench.playback import replay_metrics
from pcbench.plots.time_series import BINS, edges_of

PCBENCH = [sys.executable, "-m", "pcbench"]


@pytest.fixture
def here(tmp_path):
    """A log with one sample twice and a gap, and a plant."""
    columns = {name: list(values) for name, values in plain().items()}
    columns["sampled"][20:] = [t + 1.0 for t in columns["sampled"][20:]]
    columns["arrived"][20:] = [t + 1.0 for t in columns["arrived"][20:]]
    rows(tmp_path / "flight", columns, {"t": [0.0, 1.0], "u1": [0.5, -0.5]})
    (tmp_path / "motor.toml").write_text(tomli_w.dumps(MOTOR))
    return tmp_path


@pytest.mark.ci
def test_log_says_what_is_in_a_log_and_draws_it(here):
    done = call("info", "flight", "--out", "late.svg", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "y1: 1 gap of more than five intervals, the longest 1.05 s before row 21." in done.stdout
    assert (here / "late.svg").read_text().count("<svg") == 1
    (row,) = json.loads(call("info", "flight", "--json", cwd=here).stdout)["channels"]
    assert (row["samples"], row["gaps"], row["drift_ppm"]) == (40, 1, pytest.approx(0, abs=1e-3))


def test_a_drift_stands_with_its_interval(tmp_path):
    """Delays of 100 or 120 ms for two seconds tell a clock's drift to hundredths, not to millionths."""
    columns = plain()
    late = 0.1 + 0.02 * np.random.default_rng(4).random(40).round(0)
    rows(tmp_path / "flight", columns | {"arrived": columns["sampled"] + late})
    done = call("info", "flight", cwd=tmp_path)
    (row,) = json.loads(call("info", "flight", "--json", cwd=tmp_path).stdout)["channels"]
    value, half = re.search(r"y1: clock skew (-?\d+) ± (\d+) ppm", done.stdout).groups()
    assert float(value) == pytest.approx(row["drift_ppm"], abs=0.1 * float(half))
    assert float(half) == pytest.approx(1.96 * row["drift_ppm_se"], rel=0.05)


@pytest.mark.ci
def test_replay_leaves_a_folder_and_a_mistake_is_one_sentence(here):
    words = ["replay", "flight", "--plant", "motor.toml", "--observers", "kf", "--out", "out"]
    done = call(*words, "--json", cwd=here)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["ticks"], said["rows"], said["innovations"][0]["samples"]) == (305, 40, 40)
    tables = {f"{name}.parquet" for name in ("estimates", "innovations", "smoothed")}
    assert {p.name for p in (here / "out").iterdir()} == {*tables, "replay.json"}
    wrong = call(*words[:1], "none", *words[2:], cwd=here)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "no such file or folder" in wrong.stderr


@pytest.mark.ci
@pytest.mark.parametrize(
    "words",
    [
        ["info", "flight", "--out", "flight/measurements.csv/late.svg"],
        ["replay", "flight", "--plant", "motor.toml", "--observers", "kf", "--out", "motor.toml"],
        ["simulate", "motor.toml", "--observer", "kf", "--out", "run.csv", "--log", "motor.toml"],
        ["export", "motor.toml", "kf", "--out", "motor.toml"],
    ],
    ids=" ".join,
)
def test_what_cannot_be_written_is_one_sentence(here, words):
    before = sorted(here.rglob("*"))
    wrong = call(*words, cwd=here)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1), wrong.stderr
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize("place", ["motor.toml", "motor.toml/c", "shut/c"])
def test_an_export_without_a_place_is_refused_before_it_is_made(here, place, monkeypatch):
    monkeypatch.chdir(here)
    monkeypatch.setattr(files, "export_observer", lambda *words: pytest.fail("it is made first"))
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "shut")  # root may write everywhere
    (here / "shut").mkdir()
    with pytest.raises(pcbench.UserError, match=r"^--out .*: got .*, expected a folder .*; give another\.$"):
        export.export("motor.toml", "kf", place)
    assert not list((here / "shut").iterdir())


def raise_interrupt(*_):
    raise KeyboardInterrupt


def standing(where):
    """What stands in a folder, by name."""
    return {str(p.relative_to(where)): p.read_text() for p in where.rglob("*") if p.is_file()}


@pytest.mark.parametrize("at", ["estimates", "summary"])
def test_a_replay_that_is_stopped_leaves_what_was_there(tmp_path, monkeypatch, at):
    before = dict.fromkeys(("estimates.parquet", "replay.json"), "of an earlier replay")
    for name, text in before.items():
        (tmp_path / name).write_text(text)

    def replayed():
        with replay_metrics.draft(tmp_path) as draft:
            draft.write(pa.table({"t": [0.0, 1.0]}))
            if at == "estimates":
                raise_interrupt()
            draft.close()
            draft.finish({})

    monkeypatch.setattr(storage, "write_json", raise_interrupt)
    with pytest.raises(KeyboardInterrupt):
        replayed()
    assert standing(tmp_path) == before


@pytest.mark.parametrize(("at", "left"), [("write_file", "old"), ("replace", "new")])
def test_files_that_belong_together_are_written_all_or_none(tmp_path, monkeypatch, at, left):
    """Of an export, a replay and draws: stopped while they are written, or while they get their names."""
    target, names, calls = storage.target(tmp_path), ("a", "b/b", "c"), []
    storage.write_files(target, dict.fromkeys(names, b"old"))
    module = storage if at == "write_file" else os
    does = getattr(module, at)

    def stopped_at_the_second(*given):
        mine = at == "write_file" or "partial" not in str(given[0])  # `write_file` renames too
        calls.extend([given] if mine else [])
        return raise_interrupt() if mine and len(calls) == 2 else does(*given)

    monkeypatch.setattr(module, at, stopped_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        storage.write_files(target, dict.fromkeys(names, b"new"))
    assert standing(tmp_path) == dict.fromkeys(names, left)


def interrupt(words, cwd, ready, number=signal.SIGINT):
    """What a command leaves that gets Ctrl-C (or another signal) once it is ready, or None where it was done before."""
    with subprocess.Popen(
        [*PCBENCH, *words], cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        while not ready() and process.poll() is None:
            time.sleep(0.01)
        if process.poll() is not None:
            return None
        process.send_signal(number)
        _, stderr = process.communicate(timeout=300)
    assert process.returncode in (0, 128 + number), stderr  # 0: it had ended and was leaving
    if process.returncode:
        assert stderr.splitlines()[-1] == "pcbench: stopped; every file already written is complete."
        assert "Traceback" not in stderr
    return {p.name for p in (cwd / "out").rglob("*")}


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_during_replay_leaves_no_file(tmp_path, number):
    many = 400_000
    t = np.arange(many) * 0.01
    (tmp_path / "motor.toml").write_text(tomli_w.dumps(MOTOR))
    rows(
        tmp_path / "flight",
        plain() | {"channel": ["y1"] * many, "sampled": t, "arrived": t, "value": t},
        kind="parquet",
    )
    words = ["replay", "flight", "--plant", "motor.toml", "--observers", "kf,ukf", "--out", "out"]
    assert interrupt(words, tmp_path, (tmp_path / "out" / ".estimates.parquet.part").exists, number) == set()


@pytest.mark.nightly
def test_ctrl_c_in_an_export_leaves_all_of_its_files_or_none(tmp_path):
    whole = {"kf.c", "kf.h", "kf_gains.h", "gains.json", "gains.mat", "main.c", "vector.h"}
    for wait in (1.5, 2.5, 3.5, 4.5):
        until = time.monotonic() + wait
        left = interrupt(["export", "cart/white", "kf", "--out", "out"], tmp_path, lambda: time.monotonic() > until)  # noqa: B023
        assert left in (None, set(), whole)
        shutil.rmtree(tmp_path / "out", ignore_errors=True)


def test_the_picture_has_every_arrival_and_all_shares(here):
    figure = plots.delays(pcbench.info(here / "flight"))
    points, shares = figure.axes[0].collections[0].get_offsets(), figure.axes[1].patches[0].get_data().values
    assert len(points) == 40
    np.testing.assert_allclose(points[:, 1], 0.1, atol=1e-9)
    assert shares.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("many", [3, 28, 41, 200])
def test_every_bar_of_delays_in_whole_ticks_holds_as_many_ticks(many):
    edges = edges_of(np.arange(12, 12 + many) * 0.005)
    each = np.histogram(np.arange(12, 12 + many) * 0.005, edges)[0]
    assert len(each) <= BINS + 1
    assert set(each[:-1]) == {each[0]}
    assert each.sum() == many


def test_delays_of_any_size_are_all_in_a_bar():
    for late in (np.random.default_rng(0).gamma(2.0, 0.02, 500).round(9), np.array([0.05]), np.array([0.0])):
        counts, edges = np.histogram(late, edges_of(late))
        assert counts.sum() == len(late)
        assert (np.diff(edges) > 0).all()
