"""The guide's way from a bag to a filter in C, as it stands: every block, in its order, and the numbers that it tells.

In processes of their own, which have what the page says is installed and none of the other extras of pcbench.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys

import pandas as pd
import pytest
from documents import PAGES, blocks, code_blocks, commands

from pcbench.errors import EXTRAS

PAGE = "recording_to_c.md"


def as_installed(folder):
    """What a process's surroundings are where the extras that the page does not name are not installed."""
    named = re.search(r"pip install 'pcbench\[(.*)\]'", PAGES[PAGE])[1].split(",")
    for package in {package.replace("-", "_") for package, extra in EXTRAS.items() if extra not in named}:
        (folder / f"{package}.py").write_text(f"raise ModuleNotFoundError('it is not installed', name='{package}')")
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


@pytest.fixture(scope="module")
def sitting(tmp_path_factory):
    """The folder behind the last step but the compiler's, and what every command has printed, by its name and number."""
    folder, said = tmp_path_factory.mktemp("sitting"), {}
    there = {"cwd": folder, "env": as_installed(tmp_path_factory.mktemp("missing")), "text": True}
    for block in code_blocks(PAGE):
        if block.title:
            (folder / block.title).write_text(block.text)
    bag, picture = blocks("python", PAGE)
    for line in commands(PAGE):
        words = shlex.split(line)[1:]
        words += ["--json"] if words[0] in ("info", "replay", "tune") else []
        done = subprocess.run([sys.executable, "-m", "pcbench", *words], capture_output=True, check=False, **there)
        assert done.returncode == 0, done.stderr
        said[words[0] if words[0] not in said else f"{words[0]} again"] = done.stdout
        if words[0] == "simulate":
            subprocess.run([sys.executable, "-c", bag], check=True, **there)
    subprocess.run([sys.executable, "-c", picture], check=True, **there)
    return folder, said


@pytest.mark.nightly
def test_its_numbers_come_out(sitting):
    folder, said = sitting
    (camera,) = json.loads(said["info"])["channels"]
    assert (camera["samples"], camera["out_of_order"], camera["lost"]) == (1130, 34, 0)
    late = [camera[f"delay_{name}"] for name in ("median", "p05", "p95", "most")]
    assert [round(camera["rate"], 1), *late] == pytest.approx([18.8, 0.075, 0.060, 0.115, 0.195])
    first, second = (json.loads(said[name])["innovations"][0] for name in ("replay", "replay again"))
    assert [first[name] for name in ("nis", "nis_low", "nis_high")] == pytest.approx([0.39, 0.92, 1.08], abs=0.006)
    assert (first["verdict"], second["verdict"]) == ("pessimistic", "consistent")
    assert first["ljung_box_p"] < 1e-3
    tuned = json.loads(said["tune"])
    found = {row["name"]: row for row in tuned["intensities"]}
    for name, printed, true in (("R", (0.00088, 0.00080, 0.00096), 0.03), ("Q[1]", (0.0025, 0.0020, 0.0031), 0.05)):
        assert [found[name][key] for key in ("value", "low", "high")] == pytest.approx(printed, rel=0.03)
        assert found[name]["low"] < true**2 < found[name]["high"]
    rest = tuned["held_out"]["tuned"]
    assert [rest["nis"], rest["ljung_box_p"], tuned["gain"], tuned["gain_se"]] == pytest.approx(
        [1.03, 0.25, 0.69, 0.035], abs=0.006
    )
    assert tuned["notes"] == [
        "Q[0]: the recording does not determine it, so no interval is given; tune the others with --only."
    ]
    truth = pd.read_parquet(folder / "recorded" / "truth.parquet")
    errors = [
        truth.angle - pd.read_parquet(folder / run / "estimates.parquet")["kf.angle"] for run in ("first", "second")
    ]
    assert [(e[truth.t >= 10] ** 2).mean() ** 0.5 for e in errors] == pytest.approx([0.068, 0.034], abs=6e-4)
    assert {p.name for p in folder.glob("*.svg")} == {"delays.svg", "angle.svg"}


@pytest.mark.nightly
@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler on this machine")
def test_filter_in_c_equals_replay_of_bag(sitting):
    folder, said = sitting
    assert "oldest admissible age" in " ".join(said["export"].split())
    ticks = int(re.search(r"define TICKS (\d+)", (folder / "kf-in-c" / "vector.h").read_text())[1])
    assert ticks == len(pd.read_parquet(folder / "second" / "estimates.parquet")), "the C is tested on the bag"
    *_, lines = blocks("sh", PAGE)
    done = subprocess.run(["sh", "-ec", lines], cwd=folder, capture_output=True, text=True, check=True)
    off = [float(line.split(" at most")[0].split(", ")[1]) for line in done.stdout.splitlines() if "at most" in line]
    assert len(off) == 2
    assert max(off) < 1e-12
    assert len(list((folder / "kf-in-c").iterdir())) == 7
