"""Dead time of an open loop's input: the plant gets it later, and observers as the plant does."""

import numpy as np
import pytest

import pcbench
from pcbench.errors import UserError

STUDY = {
    "name": "dead-time",
    "observers": ["kf"],
    "lti": {"A": [[0.0, 1.0], [-1.0, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "tick": 0.1, "sampling_period": 0.5,
            "delay": 0.3, "noise_std": 0.1, "duration": 6.0, "input": "square"},
}  # fmt: skip


def having(**given):
    return STUDY | {"lti": STUDY["lti"] | given}


def test_the_input_is_applied_later_and_is_zero_before():
    usual, late = (pcbench.simulate(having(**given), "kf")["u1"].to_numpy() for given in ({}, {"actuator_delay": 0.7}))
    assert usual[0] != 0
    np.testing.assert_array_equal(late[:7], 0)
    np.testing.assert_array_equal(late[7:], usual[:-7])


def test_an_input_later_than_the_end_never_comes():
    late = pcbench.simulate(having(actuator_delay=6.0), "kf")["u1"].to_numpy()
    np.testing.assert_array_equal(late[:60], 0)


@pytest.mark.ci
@pytest.mark.parametrize("engine", ["steps", "definition"])
def test_a_perfect_start_stays_perfect(engine):
    study = having(actuator_delay=0.7, noise_std=0.0, x0=[1.0, -0.5], xhat0=[1.0, -0.5], prior_std=1.0)
    runs = pcbench.run(study | {"engine": engine, "seeds": 2, "observers": ["kf", "pccebo", "ekf"]}).runs
    assert runs.max_abs_error.max() < 1e-12


@pytest.mark.ci
def test_an_axis_of_dead_times_changes_the_plants_motion():
    runs = pcbench.run(
        having() | {"axes": {"actuator_delay": [0.0, 0.7]}, "observers": ["model-only"], "seeds": 2}
    ).runs
    assert set(runs.actuator_delay) == {0.0, 0.7}


def test_a_loop_that_a_study_closes_has_its_own():
    loop = {"controller": {"use": "lqr", "Q1": [1.0, 1.0], "Q2": [1.0]}}
    with pytest.raises(UserError, match=r"write actuator_delay in \[controller\]"):
        pcbench.run(having(actuator_delay=0.1) | loop)
