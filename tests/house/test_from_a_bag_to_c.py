"""The guide's way from a bag to a filter in C, as it stands: every block, in its order, and the numbers that it tells."""

import json
import shlex
import shutil
import subprocess
import sys

import pytest
from commands import call
from documents import blocks, commands

PAGE = "from_a_bag_to_c.md"


@pytest.fixture(scope="module")
def sitting(tmp_path_factory):
    """The folder behind the last step but the compiler's, and what every command has printed, by its name and number."""
    folder, said = tmp_path_factory.mktemp("sitting"), {}
    for name, text in zip(("joint", "simulated"), blocks("toml", PAGE), strict=True):
        (folder / f"{name}.toml").write_text(text)
    (log,) = (b for b in blocks("text", PAGE) if b.startswith("log ="))
    (folder / "bench.toml").write_text(log)
    bag, picture = blocks("python", PAGE)
    for line in commands(PAGE):
        words = shlex.split(line)[1:]
        done = call(*words, *(["--json"] if words[0] in ("log", "replay", "tune") else []), cwd=folder)
        assert done.returncode == 0, done.stderr
        said[words[0] if words[0] not in said else f"{words[0]} again"] = done.stdout
        if words[0] == "trace":
            subprocess.run([sys.executable, "-c", bag], cwd=folder, check=True)
    subprocess.run([sys.executable, "-c", picture], cwd=folder, check=True)
    return folder, said


@pytest.mark.slow
def test_its_numbers_come_out(sitting):
    folder, said = sitting
    (camera,) = json.loads(said["log"])["channels"]
    assert camera["samples"] == 1130
    first, second = (json.loads(said[name])["innovations"][0] for name in ("replay", "replay again"))
    assert first["nis"] == pytest.approx(0.40, abs=0.005)
    assert first["p_white"] < 1e-3
    assert second["nis"] == pytest.approx(1.0, abs=0.09)
    assert second["p_white"] > 0.05
    found = {row["name"]: row for row in json.loads(said["tune"])["intensities"]}
    for name, told, true in (("R", 0.00088, 0.03**2), ("Q[1]", 0.0023, 0.05**2)):
        assert found[name]["found"] == pytest.approx(told, rel=0.02)
        assert found[name]["low"] < true < found[name]["high"]
    assert {p.name for p in folder.glob("*.svg")} == {"delays.svg", "angle.svg"}


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler on this machine")
def test_the_filter_is_compiled_and_does_what_was_simulated(sitting):
    folder, _ = sitting
    (lines,) = blocks("sh", PAGE)
    done = subprocess.run(["sh", "-ec", lines], cwd=folder, capture_output=True, text=True, check=True)
    off = [float(line.split(" at most")[0].split(", ")[1]) for line in done.stdout.splitlines() if "at most" in line]
    assert len(off) == 2
    assert max(off) < 1e-12
