"""A study with your own nonlinear plant on Dask's workers leaves the bytes that it leaves without them."""

import os
import subprocess
import sys

import pytest
from small_study import tables

pytest.importorskip("distributed")
PLANT = """
from typing import NamedTuple
import jax.numpy as jnp
import pcbench

class Numbers(NamedTuple):
    delta: float = 0.3
    beta: float = 1.0

def field(p, now, x):
    return jnp.stack([x[1], -p.delta * x[1] + x[0] - p.beta * x[0] ** 3 + now.u[0]])

def output(p, now, x):
    return x[:1]

def plant(field, output):
    return pcbench.make_plant(field=field, output=output, states=["position [m]", "velocity [m/s]"], numbers=Numbers(),
                         operating_point=([0.0, 0.0], [0.0]))

named = plant(field, output)
nameless = plant(lambda p, now, x: field(p, now, x), lambda p, now, x: x[:1])
"""
STUDY = """
name = "duffing"
seeds = 2
observers = {observers}
[scenario]
plant = "duffing.py:{plant}"
dt = 0.05
duration = 1.0
x0 = [1.2, 0.3]
sampling_period = 0.2
delay = 0.2
noise_std = 0.02
[axes]
delay = [0.1, 0.2]
"""


@pytest.mark.nightly
@pytest.mark.parametrize(("plant", "observers"), [("named", ["ekf", "ukf"]), ("nameless", ["ekf"])])
def test_workers_leave_the_same_bytes(tmp_path, plant, observers):
    """One worker computes several cells: the second finds the program of the first."""
    (tmp_path / "duffing.py").write_text(PLANT)
    (tmp_path / "study.toml").write_text(STUDY.format(plant=plant, observers=list(observers)).replace("'", '"'))
    for out, options in (("dask", ["--dask", "local", "--workers", "1"]), ("here", [])):
        done = subprocess.run(
            [sys.executable, "-m", "pcbench", "run", "study.toml", "-o", out, *options],
            cwd=tmp_path,
            env=os.environ | {"PCBENCH_CACHE": str(tmp_path / f"cache-{out}")},
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
        )
        assert done.returncode == 0, done.stderr
    assert tables(tmp_path / "dask") == tables(tmp_path / "here") != {}
