"""The tutorial on the recording of a car: every block is run in its order, and the numbers that the page shows are compared."""

import json
import shlex
import shutil
import subprocess
import sys

import pytest
from documents import PAGES, blocks, code_blocks, commands, is_printed, tables

PAGE = "a_real_recording.md"


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The folder after all blocks, and what every command printed, in their order."""
    folder, out, said = tmp_path_factory.mktemp("car"), {}, []
    there = {"cwd": folder, "text": True, "capture_output": True, "check": False}
    for block in code_blocks(PAGE):
        if block.title:
            (folder / block.title).write_text(block.text)
        for line in block.text.splitlines() if block.language == "sh" else ():
            words = shlex.split(line)
            if words[0] == "pcbench":
                as_json = ["--json"] if words[1] in ("info", "replay", "tune") else []
                done = subprocess.run([sys.executable, "-m", "pcbench", *words[1:], *as_json], **there)
                said.append(words[1])
            elif shutil.which("cc"):
                done = subprocess.run(words, **there)
            assert done.returncode == 0, done.stderr
            out[f"{words[1]} {said.count(words[1])}" if words[0] == "pcbench" else words[0]] = done.stdout
    assert len(said) == len(commands(PAGE))
    return folder, out


@pytest.mark.nightly
def test_noise_and_tests_are_those_of_the_page(printed):
    _, out = printed
    first, again = (json.loads(out[f"tune {i}"]) for i in (1, 2))
    found = {row["name"]: row for row in first["intensities"]}
    for name, start, value, interval, _ in tables(PAGES[PAGE], "intensity"):
        row = found[name]
        assert row["start"] == pytest.approx(float(start))
        assert [row["value"], row["low"], row["high"]] == pytest.approx(
            [float(text) for text in (value, *interval.split(" to "))], rel=0.05
        )
    rows = {name: cells for name, *cells in tables(PAGES[PAGE], "result")}
    for i, tuned in enumerate((first, again)):
        held_out = tuned["held_out"]["tuned"]
        assert is_printed(tuned["best"]["R"] ** 0.5, rows["standard deviation of the receiver's noise [m/s]"][i])
        assert float(rows["ljung_box_p of the held-out part"][i]) == pytest.approx(held_out["ljung_box_p"], rel=0.05)
        nis, verdict = rows["NIS of the held-out part"][i].split(", ")
        assert is_printed(held_out["nis"], nis)
        assert held_out["verdict"] == verdict
        assert is_printed(held_out["log_likelihood"], rows["log-likelihood of the held-out part"][i])
    for i, replay in enumerate(("replay 1", "replay 3")):
        errors = {row["metric"]: row["value"] for row in json.loads(out[replay])["metrics"]}
        assert is_printed(errors["steady_rmse"], rows["RMS error of the speed [m/s]"][i])
    (row,) = json.loads(out["replay 1"])["innovations"]
    assert (row["verdict"], round(row["nis"], 3)) == ("consistent", 0.998)
    assert row["ljung_box_p"] == pytest.approx(0.0002, rel=0.2)
    assert json.loads(out["replay 3"])["innovations"][0]["ljung_box_p"] == pytest.approx(0.0025, rel=0.1)


@pytest.mark.nightly
def test_delay_and_its_likelihoods_are_those_of_the_page(printed):
    folder, out = printed
    ((_, delay, interval),) = tables(PAGES[PAGE], "channel")
    found = json.loads(out["tune 2"])["delay"]["y1"]
    for name, text in zip(("estimate", "low", "high"), (delay, *interval.split(" to ")), strict=True):
        assert found[name] == pytest.approx(float(text), abs=5e-4)
    profile = {float(delay): numbers for delay, *numbers in tables(PAGES[PAGE], "assumed delay [s]")}
    compared = json.loads((folder / "compared" / "replay.json").read_text())["innovations"]
    assert [row["assumed_delay_error"] for row in compared] == list(profile)
    for row in compared:
        texts = profile[row["assumed_delay_error"]]
        assert is_printed(row["log_likelihood"], texts[0])
        assert is_printed(row["log_likelihood_held_out"], texts[1])
    errors = [
        {m["metric"]: m["value"] for m in json.loads(out[f"replay {i}"])["metrics"]}["steady_rmse"] for i in (1, 3)
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.nightly
@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler on this machine")
def test_filter_in_c_equals_the_replay(printed):
    folder, out = printed
    lines = [line for line in out["./filter"].splitlines() if "at most" in line]
    assert [line.partition(":")[0] for line in lines] == ["speed", "bias"]
    for line in lines:
        assert float(line.split(" at most")[0].split(", ")[1]) < 1e-12
    assert is_printed(float(lines[0].rpartition("error ")[2].split()[0]), "0.044")
    assert (folder / "second" / "report.html").stat().st_size < 1.2e6


def test_page_shows_every_kind_of_block():
    assert len(blocks("sh", PAGE)) == 6
    assert [block.title for block in code_blocks(PAGE) if block.title] == ["car.toml"]
