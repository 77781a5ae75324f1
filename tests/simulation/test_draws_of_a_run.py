"""What a run draws for itself: its start, its prior, process noise, and the noise of samples from before tick 0.

Every draw is made by hand with jax.random, at the address that `rng` promises: root seed, seed, stream, channel, index.
"""

import jax
import numpy as np
import pytest
from harness import ODD, SLOTS, Case, problem, recorder
from scipy.linalg import expm

from pcbench.runtime import config
from pcbench.simulation.schedule import common_times
from pcbench.simulation.schedule.sampling import Clock

INITIAL, MEASUREMENT, PROCESS = 0, 1, 5  # numbers of streams
SEED, LATE, EVERY = 5, 37, 20
CASE = Case(ODD, EVERY, LATE, ticks=80, h=0.01, noise_std=0.2, seed=SEED, xhat0=[0.5, -1.0, 2.0])
STD, SCATTER = np.array([0.3, 0.05, 0.7]), np.array([0.5, 1.0, 2.0])
ROOT = np.array([[0.7, 0.2, -0.1], [0.4, 0.5, 0.0], [-0.3, 0.6, 0.9]])  # of the start's covariance: no symmetry


def draw_numbers(draw, stream, channel, index, *shape):
    key = jax.random.fold_in(jax.random.key(0), SEED)
    for part in (stream, channel, index):
        key = jax.random.fold_in(key, part)
    return np.asarray(draw(key, shape, dtype=float))


@pytest.fixture(scope="module")
def run():
    """One run with all of it, and its inputs; measuring began before tick 0."""
    layout, p = problem(CASE, {"model-only": {}})
    found = common_times.samples_of([Clock((0, 1), EVERY, LATE, early=True)], CASE.ticks)
    plan = common_times.pad_slots(common_times.schedule(found, CASE.ticks, 2), SLOTS)
    p = p._replace(schedule=plan, process_std=STD, spread0=ROOT, scatter=SCATTER)
    layout = layout._replace(random_initial_state=True, scattered=True)
    with config.float64():
        return jax.tree.map(np.asarray, recorder()(layout, p, np.asarray(0), np.asarray(SEED))), p


@pytest.mark.ci
def test_the_start_is_its_mean_and_a_root_of_its_covariance_times_the_draws(run):
    got, p = run
    v = [draw_numbers(jax.random.normal, INITIAL, j, 0) for j in range(3)]
    np.testing.assert_allclose(got.x[0], p.x0 + ROOT @ v, rtol=1e-14)


@pytest.mark.ci
def test_what_is_believed_of_the_start_lies_in_a_box_about_it(run):
    got, p = run
    u = draw_numbers(jax.random.uniform, INITIAL, 0, 0, 3)
    np.testing.assert_allclose(got.estimates["model-only"][0], p.xhat0 + SCATTER * (2 * u - 1), rtol=1e-14)


@pytest.mark.ci
def test_every_tick_adds_its_own_process_noise(run):
    got, p = run
    joint = expm(np.block([[ODD.A, ODD.B], [np.zeros((2, 5))]]) * CASE.h)
    for k in range(CASE.ticks):
        w = np.array([draw_numbers(jax.random.normal, PROCESS, j, k) for j in range(3)])
        want = joint[:3, :3] @ got.x[k] + joint[:3, 3:] @ p.inputs[k] + STD * w
        np.testing.assert_allclose(got.x[k + 1], want, rtol=1e-12, atol=1e-12)


def test_samples_from_before_tick_0_have_measured_the_start_with_noise_of_their_own(run):
    got, _ = run
    for number, arrives in enumerate(range(0, CASE.ticks + 1, EVERY)):
        v = np.array([draw_numbers(jax.random.normal, MEASUREMENT, j, number) for j in range(2)])
        want = ODD.C @ got.x[max(arrives - LATE, 0)] + CASE.noise_std * v
        np.testing.assert_allclose(got.newest[arrives], want, rtol=1e-12, atol=1e-13)
