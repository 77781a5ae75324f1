"""pcbench inside a host program: its float64 is its own, and the host's jax stays as it was."""

import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import pcbench

CODE = """
import sys, jax, jax.numpy as jnp, pcbench
before = (jnp.zeros(1).dtype, len(jax.devices()), jax.config.jax_enable_x64)
pcbench.run("cart/drift", observers="kfbo", seeds=3, axes={"noise_std": [0.3]}, out=sys.argv[1])
pcbench.simulate("cart/white", "kfbo"), pcbench.design("cart/white", "pccebo")
assert (jnp.zeros(1).dtype, len(jax.devices()), jax.config.jax_enable_x64) == before, "the host's jax was changed"
assert before[0] == jnp.float32
"""


@pytest.mark.nightly
def test_a_float32_host_gets_float64_numbers_and_keeps_its_settings(tmp_path):
    """One device and float32 in the host, two and float64 here: the same bits."""
    env = {k: v for k, v in os.environ.items() if k != "JAX_NUM_CPU_DEVICES"}
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(tmp_path / "out")], capture_output=True, text=True, env=env, check=False
    )
    assert done.returncode == 0, done.stderr
    here = pcbench.run("cart/drift", observers="kfbo", seeds=3, axes={"noise_std": [0.3]}).runs
    there = pd.read_parquet(tmp_path / "out" / "runs")
    keys = ["observer", "seed", "signal"]
    there["observer"] = there["observer"].astype(str)
    a, b = (frame.sort_values(keys)["mae"].to_numpy() for frame in (here, there))
    np.testing.assert_array_equal(a, b)
