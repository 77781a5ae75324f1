"""Draws are addressed by run and by nothing else: their own values, whatever jax is told."""

import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from reference import threefry

from pcbench.simulation import rng

FIRST = [-1.7061004185596214, 0.18934652660389156, 0.6437741189481501]  # of root seed 0, seed 0, channel 0
ADDRESSES = [(0, 0, 0), (7, 5, 2), (2**32 - 1, 3_999_999_999, 1)]


def test_the_generator_is_threefry_by_the_papers_own_answer():
    """Random123's known answers: key and counter 0, and all ones."""
    assert threefry.threefry((0, 0), (0, 0)) == (0x6B200159, 0x99BA4EFE)
    assert threefry.threefry((threefry.MASK,) * 2, (threefry.MASK,) * 2) == (0x1CB996FC, 0xBB002BE7)


def test_the_first_draws_are_these():
    np.testing.assert_allclose(rng.measurement_noise(0, 0, 3)[0], FIRST, rtol=1e-15)


@pytest.mark.ci
@pytest.mark.parametrize(("root", "seed", "channel"), ADDRESSES)
@pytest.mark.parametrize("stream", ["measurement", "initial", "process"])
def test_normal_draws_equal_the_reference(stream, root, seed, channel):
    keys = rng.run_keys(jnp.asarray(root), jnp.asarray([1, seed]), stream, channel + 1)
    for sample in (0, 1, 70_000):
        got = rng.normals(keys, jnp.full(channel + 1, sample))[channel, 1]
        np.testing.assert_allclose(got, threefry.normal(root, seed, stream, channel, sample), rtol=1e-13)


@pytest.mark.ci
@pytest.mark.parametrize(("root", "seed", "channel"), ADDRESSES)
@pytest.mark.parametrize(("stream", "many"), [("jitter", 3), ("loss", 1), ("drift", 2), ("initial", 4)])
def test_uniform_draws_equal_the_reference_to_the_bit(stream, many, root, seed, channel):
    got = rng.uniforms(jnp.asarray(root), jnp.asarray([1, seed]), stream, jnp.asarray(channel), 3, many)
    for sample in range(3):
        want = threefry.uniform(root, seed, stream, channel, sample, many)
        np.testing.assert_array_equal(got[sample, :, 1], want)


SETTINGS = ["JAX_DEFAULT_PRNG_IMPL=rbg", "JAX_THREEFRY_PARTITIONABLE=0", "JAX_RANDOM_SEED_OFFSET=5"]


@pytest.mark.ci
@pytest.mark.parametrize("setting", SETTINGS)
def test_no_setting_of_jax_changes_a_draw(setting):
    """In a process of its own, compiled: the flag is read when a program is lowered."""
    name, _, value = setting.partition("=")
    code = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from pcbench.simulation import rng
noise = jax.jit(lambda: rng.measurement_noise(0, 0, 3)[0])()
other = jax.jit(lambda: rng.uniforms(np.asarray(7), np.array([5]), "jitter", np.asarray(2), 1, 3)[0, :, 0])()
print([*map(float, noise), *map(float, other)])
"""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | {name: value}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    want = [*FIRST, *threefry.uniform(7, 5, "jitter", 2, 0, 3)]
    np.testing.assert_allclose([float(v) for v in done.stdout.strip()[1:-1].split(",")], want, rtol=1e-15)
