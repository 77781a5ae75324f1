"""Set points over time, and the state and input at which a plant rests on them."""

import numpy as np
import pytest
from loops import TICK, plant, resting
from scipy.linalg import expm

from pcbench.controllers.parts.set_points import SetPoint, equilibrium_map, reference

T = TICK * np.arange(100)
P = plant()


@pytest.mark.parametrize(
    ("given", "want"),
    [
        ({"step": 2.0}, lambda t: 2.0),
        ({"step": 2.0, "at": 0.3}, lambda t: 2.0 * (t >= 0.3 - 1e-9)),
        ({"sine": 0.5, "frequency": 2.0, "offset": -1.0}, lambda t: -1 + 0.5 * np.sin(4 * np.pi * t)),
        ({"table": [[0.1, 3.0], [0.25, -1.0]]}, lambda t: 0.0 if t < 0.1 - 1e-9 else 3.0 if t < 0.25 - 1e-9 else -1.0),
    ],
)
def test_steps_sines_and_tables(given, want):
    got = SetPoint.model_validate(given).at_times(T)
    np.testing.assert_allclose(got, [want(t) for t in T], atol=1e-15)


def test_the_plant_rests_on_a_set_point_where_it_can():
    """Two inputs can hold two states: then the next tick is the same."""
    both = equilibrium_map(P.Phi, P.Gamma, [0, 2]) @ np.array([0.7, -0.2])
    x, u = both[:3], both[3:]
    assert (x[0], x[2]) == (0.7, -0.2)
    np.testing.assert_allclose(P.Phi @ x + P.Gamma @ u, x, atol=1e-12)


def test_where_it_cannot_the_rest_is_that_of_least_squares():
    points = {"rate": SetPoint(step=0.4), "angle": SetPoint(sine=0.3), "current": SetPoint(step=0.1)}
    got = reference(points, ("angle", "rate", "current"), (P.Phi, P.Gamma), TICK, 100)
    r = np.stack([0.4 + 0 * T, 0.3 * np.sin(2 * np.pi * T), 0.1 + 0 * T], 1)
    x, u = resting(P, r, [1, 0, 2])
    np.testing.assert_allclose(got.x, x, atol=1e-12)
    np.testing.assert_allclose(got.u, u, atol=1e-10)


@pytest.mark.parametrize("tick", [0.05, 0.01, 1e-3, 1e-5])
def test_what_cannot_rest_is_not_led_far_away(tick):
    """A position cannot rest at a velocity of 0.5, whatever the tick: only the velocity's equation is solved."""
    A, B = np.array([[0.0, 1.0], [-2.0, 0.3]]), np.array([[0.0], [1.5]])
    whole = expm(tick * np.block([[A, B], [np.zeros((1, 3))]]))
    position, velocity, u = (equilibrium_map(whole[:2, :2], whole[:2, 2:], [1]) @ np.array([0.5])).tolist()
    least = -0.15 / (2.0**2 + 1.5**2) * np.array([-2.0, 1.5])  # -2 position + 0.3 * 0.5 + 1.5 u = 0
    assert velocity == 0.5
    np.testing.assert_allclose([position, u], least, atol=2 * tick)
