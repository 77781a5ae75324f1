"""Systems of scipy.signal and python-control in and out again, and the same motion on both sides."""

import control
import numpy as np
import pytest
from scipy import signal

import pcbench
from pcbench.errors import UserError

A = [[0.0, 1.0, 0.0], [0.0, -0.1, 2.0], [0.0, -0.5, -20.0]]
B = [[0.0], [0.0], [10.0]]
C = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
D = [[0.0], [0.5]]
SENSED = {"sampling_period": 0.05, "delay": 0.1, "noise_std": 0.0, "duration": 0.5}
SYSTEMS = {
    "scipy continuous": lambda: signal.StateSpace(A, B, C, D),
    "scipy discrete": lambda: signal.StateSpace(A, B, C, D).to_discrete(0.01),
    "scipy dlti": lambda: signal.dlti(0.5 * np.eye(3), B, C, D, dt=0.025),
    "control continuous": lambda: control.ss(A, B, C, D, states=["angle", "speed", "current"]),
    "control discrete": lambda: control.c2d(control.ss(A, B, C, D), 0.01),
}


def parts(system):
    return [np.asarray(getattr(system, key), float) for key in "ABCD"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_comes_back_as_it_went_in(name):
    system = SYSTEMS[name]()
    study = pcbench.lti(system, **SENSED)
    for back in (pcbench.to_scipy(study), pcbench.to_control(study)):
        for got, want in zip(parts(back), parts(system), strict=True):
            np.testing.assert_array_equal(got, want)
        assert (back.dt or None) == (system.dt or None)
    again = pcbench.lti(pcbench.to_control(study), **SENSED)
    assert again.lti.model_dump(exclude={"states"}) == study.lti.model_dump(exclude={"states"})
    if name == "control continuous":
        assert study.lti.states == again.lti.states == ["angle", "speed", "current"]
        assert pcbench.to_control(study).state_labels == ["angle", "speed", "current"]


def test_a_transfer_function_becomes_a_state_space_system():
    study = pcbench.lti(signal.ZerosPolesGain([], [-1.0, -2.0], 2.0), **SENSED)
    found = pcbench.to_scipy(study)
    np.testing.assert_allclose(np.linalg.eigvals(found.A), [-2.0, -1.0])


def test_both_sides_move_alike():
    study = pcbench.lti(SYSTEMS["control discrete"](), **SENSED, x0=[1.0, -1.0, 0.5], observers=["model-only"])
    d = pcbench.simulate(study, "model-only")
    system = pcbench.to_control(study)
    answer = control.forced_response(system, d["t"], d["u1"], [1.0, -1.0, 0.5], return_x=True)
    x = d[["x1", "x2", "x3"]].to_numpy()
    np.testing.assert_allclose(x, answer.states.T, rtol=0, atol=1e-12 * np.abs(x).max())
    direct = answer.outputs[1]  # y2 = C x + D u as it arrives 10 ticks later
    sampled = np.arange(0, len(d) - 10, 5)
    np.testing.assert_allclose(d["y2"].to_numpy()[sampled + 10], direct[sampled], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: pcbench.lti(3, **SENSED), "got int, expected a state-space system"),
        (lambda: pcbench.lti(control.ss(A, B, C, D, True), **SENSED), "time base is unknown"),
        (lambda: pcbench.lti(control.ss(A, B, C, D, None), **SENSED), "or 0 for a continuous one"),
        (
            lambda: pcbench.lti(SYSTEMS["scipy discrete"](), **SENSED, tick=0.001),
            "a tick of 0.001 s, expected the same",
        ),
        (
            lambda: pcbench.lti(SYSTEMS["scipy discrete"](), **SENSED | {"delay": 0.015}),
            "whole number of ticks of 0.01 s",
        ),
        (lambda: pcbench.lti(SYSTEMS["scipy continuous"](), sampling_perod=1.0), "did you mean 'sampling_period'"),
        (lambda: pcbench.lti(SYSTEMS["scipy continuous"](), delay=0.1), "sampling_period is missing"),
        (
            lambda: pcbench.to_scipy(pcbench.run("cart/nominal", observers="model-only", seeds=1).study),
            "no plant of its own",
        ),
    ],
)
def test_what_cannot_be_taken_is_one_sentence(make, sentence):
    with pytest.raises(UserError, match=sentence) as error:
        make()
    assert "\n" not in str(error.value)


def test_what_its_library_cannot_convert_is_a_sentence():
    class Many:
        def to_ss(self):
            raise NotImplementedError("no MIMO system without Slycot")

    with pytest.raises(
        UserError, match=r"got Many, which its library cannot convert .'no MIMO system without Slycot'."
    ):
        pcbench.lti(Many(), sampling_period=0.1, delay=0.1, noise_std=0.1)
