"""The gain of lqr, and the eigenvalues of a loop with a late command, against other ways to them."""

import numpy as np
import pytest
from loops import Q1, Q2, over, plant
from reference import loop

from pcbench.controllers import CONTROLLERS, ControllerContext
from pcbench.dynamics.linear import Model
from pcbench.errors import DesignError
from pcbench.synthesis import lqr

P = plant()
TICK = P.Phi, P.Gamma
WEIGHTS = np.array(Q1), np.diag(Q2)
K = np.array([[2.0, 1.2, 0.1], [0.3, -0.4, -0.5]])


@pytest.mark.parametrize("every", [1, 5])
def test_the_gain_is_the_iterated_riccati_equations(every):
    Phi, Gamma = lqr.over_period(TICK, every)
    for got, want in zip((Phi, Gamma), over(P, every), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(lqr.gain(Phi, Gamma, *WEIGHTS, "t"), loop.lqr(Phi, Gamma, *WEIGHTS), rtol=1e-9)


def test_a_plant_that_no_input_moves_has_no_gain():
    with pytest.raises(DesignError, match="Riccati equation of lqr was not solved"):
        lqr.gain(np.diag([1.5, 0.9]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), "t")


def controller_context(late):
    model = Model(P.Phi, P.Gamma, P.C, None, True)
    return ControllerContext(model, 0.01, 100, 0, 0, late, ("angle", "rate", "current"), lambda t: 0 * t + late * 0.01)


LAWS = {
    "state-feedback": {"K": K.tolist()},
    "pid": {"Kp": [[3.0, 0.2], [0.1, -1.0]], "Ki": [2.0, -0.5], "Kd": [[0.4, 0.0], [0.0, -0.02]], "filter": 0.05},
    "lqr": {"Q1": Q1, "Q2": Q2, "knows_delay": False},
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(("every", "late"), [(1, 0), (1, 7), (4, 0), (4, 3), (4, 4), (4, 9)])
def test_a_simulated_loop_obeys_the_characteristic_polynomial_of_its_map(name, every, late):
    """Cayley and Hamilton: the reference's states at its decisions, the state known, obey the recursion of its coefficients."""
    entry, known = CONTROLLERS[name], controller_context(late)
    options = entry.options.model_validate(LAWS[name] | {"period": every * 0.01})
    map_ = lqr.monodromy_matrix(TICK, entry.linear(options, known), every, late)
    coefficients = np.poly(map_)
    if name == "pid":
        gains = np.array(LAWS[name]["Kp"]), np.diag(LAWS[name]["Ki"]), np.array(LAWS[name]["Kd"])
        law = loop.Pid(*gains, every * 0.01, 0.05, np.zeros((10_000, 3)))
    else:
        gain = K if name == "state-feedback" else loop.lqr(*over(P, every), *WEIGHTS)
        law = loop.Feedback(gain, np.zeros((10_000, 3)), np.zeros((10_000, 2)))
    x, sent, kept, states = np.array([1.0, 0.3, -0.7]), [], None, []
    for k in range(60 * every):
        if k % every == 0:
            command, kept = law(P, k, x, sent, kept)
            states.append(x)
        sent.append(command)
        held = sent[(k - late) // every * every] if k >= late else 0 * command
        x = P.Phi @ x + P.Gamma @ held
    order = len(coefficients)
    for j in range(60 - order):
        left = coefficients[::-1] @ np.array(states[j : j + order])
        np.testing.assert_allclose(left, 0, atol=1e-11 * np.abs(states[j : j + order]).max())
