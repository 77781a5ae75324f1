"""A plant's tick is looked at before a program is made: what is bent is found, and left alone where no noise reaches it."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.moments.affinity import ROUNDING, plant_curvature
from pcbench.protocols import Plant


def plan(step, random=True):
    layout = SimpleNamespace(plant=Plant(step, None), controller=None, random_initial_state=random, drifting=False)
    problem = SimpleNamespace(
        x0=np.array([1.0, -0.5]), inputs=np.zeros((4, 1)), dt=0.1, spread0=np.eye(2), band=np.ones(2),
        process_std=np.zeros(0), params=np.array([[0.9, 0.2], [-0.1, 0.8]]),
    )  # fmt: skip
    return SimpleNamespace(layout=layout, problem=problem)


def test_an_affine_tick_is_straight_to_rounding():
    assert plant_curvature(plan(lambda p, now, x: p @ x + 3.0)) < ROUNDING


@pytest.mark.parametrize("f", [jnp.sin, jnp.abs, lambda x: 0.01 * x * x])
def test_a_bent_one_is_found(f):
    assert plant_curvature(plan(lambda p, now, x: p @ x + f(x))) > 1e-4


def test_what_no_noise_reaches_may_be_bent():
    assert plant_curvature(plan(lambda p, now, x: jnp.sin(x), random=False)) == 0


def test_numbers_of_a_plant_may_be_looked_up_by_time():
    """As NumPy arrays they could not: a tick is traced."""
    table = np.array([0.5, 0.5, 0.5])

    def step(p, now, x):
        return 0.5 * x + jax.jit(lambda tick: p[tick])(now.tick)

    looked = plan(step)
    looked.problem.params = table
    assert plant_curvature(looked) < ROUNDING
