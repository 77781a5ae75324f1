"""Every observer that reports innovations can be tuned on a recording: derivatives are exact, and equal filters agree."""

import numpy as np
import pytest
from logged import MOTOR

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.gains import tune
from pcbench.observers import OBSERVERS
from pcbench.playback import likelihood, setup, tuning
from pcbench.runtime import config

JUDGED = [name for name, entry in OBSERVERS.items() if entry.observer.innovation and not entry.observer.init_random]
FAST = ("ekf", "ukf")  # the others are nightly
OUT_OF_SEQUENCE = {**MOTOR, "lti": {**MOTOR["lti"], "delay_jitter": 0.06, "duration": 3.0}}
PENDULUM = """
from typing import NamedTuple

import jax.numpy as jnp
import pcbench


class Numbers(NamedTuple):
    friction: float = 0.1  # 1/s


swing = pcbench.make_plant(
    field=lambda p, now, x: jnp.stack([x[1], -9.81 * jnp.sin(x[0]) - p.friction * x[1] + now.u[0]]),
    output=lambda p, now, x: x[:1],
    states=["angle [rad]", "rate [rad/s]"],
    numbers=Numbers(),
    operating_point=([0.0, 0.0], [0.0]),
)
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording with delayed and out-of-sequence measurements."""
    folder = tmp_path_factory.mktemp("late")
    pcbench.simulate(OUT_OF_SEQUENCE, "kf", seed=3, log=folder)
    return folder


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.ci if n in FAST else pytest.mark.nightly) for n in JUDGED]
)
def test_score_is_the_derivative_of_the_likelihood(recording, name):
    with config.float64():
        plant = (
            OUT_OF_SEQUENCE | {"options": {name: {"max_age": 1.0}}} if name == "kf-drop-delayed" else OUT_OF_SEQUENCE
        )
        a = setup.open_playback(recording, plant, [name])
        p, part = likelihood.load_recording(a)
        design = planning.run_design(name, a.cell.entry(name), p.context, a.cell.options[name])
        free, start = tune.free_parameters(name, a.cell, p.context, design, ["R", "Q"], "here")
        look, h = likelihood.evaluator(p, part, tune.gains_at(name, a.cell, p.context, free)), 1e-4
        at = start + np.linspace(0.1, 0.3, len(start))
        found = look(at)
        assert len(found.tick) > 30
        for slope, step in zip(found.score.sum(0), h * np.eye(len(at)), strict=True):
            # the error of a central difference: its third derivative times h^2 / 6
            assert slope == pytest.approx(
                (look(at + step).log_likelihood.sum() - look(at - step).log_likelihood.sum()) / (2 * h), rel=1e-6
            )


@pytest.mark.nightly
def test_ekf_and_ukf_find_on_a_linear_plant_what_kf_finds(tmp_path):
    pcbench.simulate(MOTOR, "kf", seed=5, log=tmp_path / "log")
    wrong = {**MOTOR, "lti": {**MOTOR["lti"], "noise_std": 0.3}}
    found = {o: pcbench.tune(wrong, o, log=tmp_path / "log", only=["R"]).intensities[0] for o in ("kf", "ekf", "ukf")}
    for o in ("ekf", "ukf"):
        assert found[o][1:] == pytest.approx(found["kf"][1:], rel=1e-4)  # both descents end where the slope is 1e-6


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["ekf", "ekf-iterated", "ukf"])
def test_interval_holds_the_noise_of_a_pendulum(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "swing.py").write_text(PENDULUM)
    study = """
    name = "swing"
    observers = ["ekf"]
    [scenario]
    plant = "swing.py:swing"
    dt = 0.01
    sampling_period = 0.05
    delay = 0.05
    noise_std = 0.05
    process_std = [0.0, 0.02]
    x0 = [1.2, 0.0]
    xhat0 = [1.2, 0.0]
    prior_std = [0.1, 0.1]
    duration = 40.0
    """
    (tmp_path / "swing.toml").write_text(study)
    pcbench.simulate("swing.toml", "ekf", seed=2, log=tmp_path / "log")
    (tmp_path / "wrong.toml").write_text(study.replace("noise_std = 0.05", "noise_std = 0.2"))
    found = pcbench.tune("wrong.toml", name, log=tmp_path / "log")
    R = found.intensities[0]
    assert R.name == "R"
    assert R.low < 0.05**2 < R.high
    assert R.high < 0.2**2


def test_observer_that_draws_random_numbers_is_refused_in_one_sentence(recording):
    with pytest.raises(UserError, match=r"draws random numbers, expected .*; tune ekf or ukf\.$"):
        tuning.tune_log(recording, OUT_OF_SEQUENCE, "particle")
