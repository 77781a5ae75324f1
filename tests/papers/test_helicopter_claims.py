"""`pcbench reproduce helicopter`, and what the README says of the helicopter."""

import re

import numpy as np
import pytest
from helicopters import plan_run, record

from pcbench.papers import PAPERS
from pcbench.synthesis import sampled_high_gain


@pytest.fixture(scope="module")
def claims():
    return {row.claim: row for row in PAPERS["helicopter"][1]()}


def numbers(text):
    return [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


@pytest.mark.nightly
def test_claims_hold_but_for_the_pitch(claims):
    failed = {name for name, row in claims.items() if row.verdict == "does not hold"}
    pitch = {f"{which} delay: pitch follows its path" for which in ("constant", "varying")}
    assert failed == {*pitch, "varying delay: the control is more challenging"}
    for which, times in (("constant", (2.43, 2.02)), ("varying", (1.38, 4.25))):
        assert numbers(claims[f"{which} delay: the viscosities are estimated"].reproduced)[:2] == pytest.approx(
            (0.8, 0.318), abs=1e-6
        )
        inside = numbers(claims[f"{which} delay: viscosities within 5 %"].reproduced)
        assert inside == pytest.approx(times, abs=0.011)
        assert numbers(claims[f"{which} delay: pitch follows its path"].reproduced)[0] == pytest.approx(0.348, abs=1e-3)


@pytest.mark.nightly
def test_misprints_taken_literally_fail(claims):
    wrong = [name for name, row in claims.items() if row.verdict == "misprint"]
    assert len(wrong) == 4, wrong
    assert numbers(claims["innovation with + alpha(t_k - tau)"].reproduced)[0] == pytest.approx(1.37, abs=0.011)
    assert numbers(claims["alpha_1 with the yaw rate, as printed"].reproduced)[0] < 0
    assert numbers(claims["f_1 with + m l^2 sin cos psi'^2"].reproduced)[0] == pytest.approx(0.802, abs=1e-3)


@pytest.mark.nightly
def test_findings_of_the_readme(claims):
    off = numbers(claims["why the pitch is off its path"].reproduced)
    assert off[0] < 1e-5
    assert off[1] == pytest.approx(0.349, abs=1e-3)
    starts = [
        claims[f"random initial states, Ts = {te:g} s: runs that diverge"].reproduced for te in (0.05, 0.2, 0.8, 1.5)
    ]
    assert starts[0].startswith("printed 0 of 256")
    assert starts[1].startswith("printed 39 of 256 (11.3 .. 20.1 %)")
    assert "robust 0 of 256" in starts[1]
    assert "robust 0 of 256 (0.0 .. 1.5 %), 199 others" in starts[2]
    assert "robust 176 of 256" in starts[3]
    late = numbers(claims["samples delayed by 0.15 s, commands by 0.025 s"].reproduced)
    turned = numbers(claims["samples delayed by 0.025 s, commands by 0.15 s"].reproduced)
    assert late[0] == pytest.approx(0.027, abs=1e-3)
    assert turned[0] > 0.4
    noise = claims["noise 0.02 rad: steady rms, robust / ekf"].reproduced
    assert "ekf better in 6 of 6" in noise
    robust, ekf = numbers(noise.split("yaw_rate ")[1])[:2]
    assert 16 < robust / ekf < 18.5
    heavy = numbers(claims["10 % more mass than the model: rms error of the viscosities"].reproduced)
    assert heavy[0] == pytest.approx(0.24, abs=0.01)
    assert heavy[2] == pytest.approx(0.31, abs=0.01)


def test_the_linear_limit_of_the_sampling_period():
    """Theta Ts < 2.90; with Theta = 4 that is 0.72 s."""
    assert sampled_high_gain.limit("predictor", 3) == pytest.approx(2.8963, abs=1e-4)
    assert sampled_high_gain.radius("predictor", 3, 2.8) < 1 < sampled_high_gain.radius("predictor", 3, 3.0)
    found = sampled_high_gain.certificate(4.0, 0.2).numbers
    assert found["theta_Ts"] == pytest.approx(0.8)
    assert found["radius"] < 1


@pytest.mark.nightly
def test_half_a_tick_more_of_the_commands_delay_moves_the_yaw_rate():
    """Up to 0.4 rad/s for commands held from a tick's start; half a tick more of delay gives half of that."""
    runs = [record(plan_run("high-gain", 20.0, name="varying", actuator_delay=d)) for d in (0.03, 0.0305)]
    apart = np.abs(runs[0].x[:, 3] - runs[1].x[:, 3]).max()
    assert apart == pytest.approx(0.196, abs=0.02)
