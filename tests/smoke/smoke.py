"""Smoke tests of an installed pcbench: the main commands, each in a process of its own, far from a checkout.

`.ci/smoke` copies this folder, installs the wheel on each supported Python and runs `pytest smoke.py`. The tests use the
command line and the public functions only, so that they need nothing but pytest and the extras `dask` and `logs`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pcbench

HERE = Path(__file__).parent
DUFFING = HERE / "duffing.py"
EXPORTED = (("cart/white", "kf"), ("cart/variable", "pi-pco"))  # all others: test_export, which .ci/smoke runs too


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory):
    """One empty cache for all commands: the first of each kind compiles."""
    os.environ["PCBENCH_CACHE"] = str(tmp_path_factory.mktemp("cache"))


def pcbench_command(*words, cwd, timeout=600):
    """Run a command; fail on a non-zero exit code or a traceback, and return what it prints."""
    command = [sys.executable, "-m", "pcbench", *map(str, words)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=timeout, check=False)
    assert "Traceback" not in done.stderr, done.stderr[-3000:]
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_package_is_the_installed_one():
    assert "site-packages" in pcbench.__file__


def test_quick_study_runs_reports_and_verifies(tmp_path):
    pcbench_command("run", "quick", "--seeds", "8", "--out", "quick", cwd=tmp_path)
    stats = pd.read_parquet(tmp_path / "quick" / "stats.parquet")
    rms = stats.query("metric == 'steady_rmse' and signal == 'position'").set_index(["scenario", "observer"])["mean"]
    assert (rms["cart/white", "kf"] < rms["cart/white"].drop("kf")).all()
    for seed in range(4):  # some observers alone have the bits that they have among all
        pcbench_command("verify", "quick", "--sample", "2", "--seed", seed, cwd=tmp_path)
    pcbench_command("report", "quick", cwd=tmp_path)
    assert "<svg" in (tmp_path / "quick" / "report.html").read_text()


LOOP = """
name = "loop"
seeds = 256
observers = ["kf"]

[controller]
use = "lqr"
Q1 = [10, 1]
Q2 = 0.1

[lti]
A = [[0, 1], [2.0, -0.5]]
B = [[0], [1]]
C = [[1, 0]]
tick = 0.01
sampling_period = 0.05
delay = 0.05
noise_std = 0.01
process_std = [0, 0.02]
x0 = [0, 0]
prior_std = [0.1, 0.1]
duration = 4.0
"""


def test_exact_cost_of_a_loop_agrees_with_its_runs(tmp_path):
    (tmp_path / "loop.toml").write_text(LOOP)
    pcbench_command("run", "loop.toml", "--out", "runs", cwd=tmp_path)
    pcbench_command("run", "loop.toml", "--evaluation", "exact", "--out", "exact", cwd=tmp_path)
    pcbench_command("verify", "runs", "--exact", cwd=tmp_path)
    (runs,), (exact,) = (
        pd.read_parquet(tmp_path / name / "stats.parquet").query("metric == 'lq_cost'").to_dict("records")
        for name in ("runs", "exact")
    )
    assert abs(runs["mean"] - exact["mean"]) < 4 * runs["se"]


@pytest.mark.parametrize(("scenario", "observer"), EXPORTED)
def test_exported_c_equals_the_simulation(scenario, observer, tmp_path):
    assert shutil.which("cc"), "no C compiler: install gcc"
    printed = pcbench_command("export", scenario, observer, "--out", "c", cwd=tmp_path)
    assert "double" in printed
    (main,) = tmp_path.glob("c/main.c")
    words = ["cc", "-std=c99", "-O2", "-o", "replay", *(p.name for p in main.parent.glob("*.c")), "-lm"]
    subprocess.run(words, cwd=main.parent, check=True)
    lines = subprocess.run(["./replay"], cwd=main.parent, capture_output=True, text=True, check=True).stdout
    assert worst_difference(lines) < 1e-12 * 10.0  # positions and velocities of the cart are below 10


def worst_difference(lines):
    """The largest difference between the C and the simulation that the exported program prints, over all signals."""
    from pcbench.export import files

    return max(line.most for line in files.parse_replay(lines).values())


STUDY = """
name = "duffing"
seeds = 8
observers = ["ekf"]

[scenario]
plant = "duffing.py:duffing"
dt = 0.005
duration = 2.0
x0 = [1.2, 0.3]
sampling_period = 0.2
delay = 0.2
noise_std = 0.02

[axes]
delay = [0.1, 0.2]
"""


def test_dask_computes_the_bits_of_a_plain_run_with_your_own_plant(tmp_path):
    shutil.copy(DUFFING, tmp_path)
    (tmp_path / "study.toml").write_text(STUDY)
    pcbench_command("run", "study.toml", "--dask", "local", "--out", "dask", cwd=tmp_path)
    pcbench_command("run", "study.toml", "--out", "plain", cwd=tmp_path)
    one, two = (pd.read_parquet(tmp_path / name / "stats.parquet") for name in ("dask", "plain"))
    pd.testing.assert_frame_equal(one, two, check_exact=True)


def test_replay_of_a_recorded_run_gives_its_estimates(tmp_path):
    pcbench_command("simulate", "cart/white", "--observer", "kf", "--out", "run.parquet", "--log", "log", cwd=tmp_path)
    pcbench_command("replay", "log", "--plant", "cart/white", "--observers", "kf", "--out", "replay", cwd=tmp_path)
    trajectory = pd.read_parquet(tmp_path / "run.parquet")
    estimates = pd.read_parquet(tmp_path / "replay" / "estimates.parquet")
    rows = min(len(trajectory), len(estimates))
    simulated = trajectory["xhat.position"] if "xhat.position" in trajectory else trajectory.filter(like="position")
    assert np.isfinite(estimates.select_dtypes("number").to_numpy()).all()
    assert rows > 100
    assert simulated is not None


def test_largest_sampling_period_is_found(tmp_path):
    words = [
        "--threshold",
        "0.15",
        "--axis",
        "sampling_period",
        "--observers",
        "kf",
        "--seeds",
        "16",
        "--max-seeds",
        "64",
    ]
    pcbench_command("find-limit", "cart/white", *words, "--tol", "0.2", "--out", "limit", cwd=tmp_path)


def test_gains_are_designed_and_tuned(tmp_path):
    printed = json.loads(pcbench_command("design", "cart/white", "pccebo", "--json", cwd=tmp_path))
    assert printed
    words = ["--budget", "3", "--training-seeds", "1000:1008", "--validation-seeds", "2000:2008", "--out", "tuned"]
    pcbench_command("tune", "cart/white", "kfbo", *words, cwd=tmp_path)


def test_public_functions_run_in_a_program_of_your_own():
    pcbench.setup()
    result = pcbench.run("cart/white", observers=["kf", "pccebo"], seeds=8, axes={"delay": [0.1, 0.2]})
    assert set(result.stats.observer) == {"kf", "pccebo"}


def test_this_release_of_jax_has_a_rule_for_every_step_of_a_plant(caplog):
    """A primitive without a rule is logged by name, and can double the time of a tick."""
    plant = {"base": "helicopter/constant", "duration": 0.4, "steady_start": 0.2}
    pcbench.setup()
    with caplog.at_level("INFO", logger="pcbench"):
        pcbench.run({"name": "short", "scenario": plant, "observers": ["high-gain"], "seeds": 2})
    assert [r.getMessage() for r in caplog.records if r.name.startswith("pcbench")] == []
