"""A measured angle that wraps: with the plant's residual filters turn with it, and without one they lose it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import pcbench
from pcbench.errors import UserError

FILTERS = ["ekf", "ekf-iterated", "ukf", "particle", "mhe"]


class Numbers(NamedTuple):
    friction: float = 0.2  # 1/s


def wrap(angle):
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


def field(p, now, x):
    return jnp.stack([x[1], -p.friction * x[1] + now.u[0]])


def make(residual, start=(0.0, 0.0)):
    return pcbench.make_plant(
        field=field,
        output=lambda p, now, x: jnp.stack([wrap(x[0]), 0.1 * x[1]]),
        output_residual=residual,
        states=["angle [rad]", "rate [rad/s]"],
        numbers=Numbers(),
        operating_point=(list(start), [0.0]),
    )


def turning(y, yhat):
    return jnp.stack([wrap(y[0] - yhat[0]), y[1] - yhat[1]])


with_residual = make(turning)
without = make(None)
upside_down = make(turning, (3.0, 0.0))  # deviations from an angle near where it wraps


def study(plant, observers, **given):
    scenario = {"plant": f"{__file__}:{plant}", "x0": [0.0, 3.0], "xhat0": [0.1, 2.8], "prior_std": [0.2, 0.4], "dt": 0.02,
                "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.05, "duration": 3.0, "input": "zero",
                "process_std": 0.002, "assumed_process_std": 0.002}  # fmt: skip
    return {"name": "turns", "scenario": scenario | given, "observers": observers, "seeds": 2}


@pytest.mark.ci
@pytest.mark.parametrize("plant", ["with_residual", pytest.param("upside_down", marks=pytest.mark.nightly)])
def test_filters_turn_with_an_angle_that_wraps(plant):
    runs = pcbench.run(study(plant, FILTERS)).runs
    angle = runs[runs.signal == "angle"] if "signal" in runs else runs
    assert angle.groupby("observer").rmse.max().max() < 0.1
    assert set(runs.observer) == set(FILTERS)


def test_without_a_residual_the_angle_is_lost():
    runs = pcbench.run(study("without", ["ekf"])).runs
    assert runs[runs.signal == "angle"].rmse.max() > 2


@pytest.mark.ci
def test_a_residual_that_is_the_difference_changes_nothing():
    still = {"x0": [0.0, 0.5], "xhat0": [0.1, 0.4]}
    a, b = (pcbench.run(study(plant, FILTERS, **still)).runs for plant in ("with_residual", "without"))
    np.testing.assert_allclose(a.rmse, b.rmse, rtol=0, atol=1e-12)


@pytest.mark.nightly
def test_it_is_judged_where_the_noise_of_outputs_is_assumed_to_be_correlated():
    full = {"R": [[0.0025, 0.001], [0.001, 0.0025]]}
    runs = pcbench.run(study("with_residual", FILTERS) | {"options": dict.fromkeys(FILTERS, full)}).runs
    assert runs.groupby("observer").rmse.max().max() < 0.1


@pytest.mark.parametrize(
    ("residual", "sentence"),
    [
        (lambda y, yhat: y, "of an output less itself, expected 2 zeros"),
        (lambda y, yhat: y[0] - yhat[0], "of an output less itself, expected 2 zeros"),
        (lambda y: y, "output_residual cannot be computed at the operating point"),
    ],
)
def test_a_residual_that_cannot_be_is_one_sentence(residual, sentence):
    with pytest.raises(UserError, match=sentence):
        make(residual, (1.0, 0.5))
