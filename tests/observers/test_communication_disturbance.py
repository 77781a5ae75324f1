"""The communication disturbance observer: its limit, what it cannot see, and what it refuses."""

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, trace
from reference.linear import Model, model_only
from scipy.linalg import expm

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS

NAME = "cdob"
INTEGRATORS = linear.Model(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [2.0]]), np.array([[1.0, 0.0]]))
H, D, TICKS = 0.01, 30, 600
START = [0.4, -0.3]
SWING = np.sin(1.3 * H * np.arange(TICKS + 1))[:, None] + 0.5 * np.cos(0.4 * H * np.arange(TICKS + 1))[:, None]


def design(case, **options):
    return OBSERVERS[NAME].design(context_of(case), OBSERVERS[NAME].options(**options))


def swinging(d=D, te=1, **changes):
    return Case(INTEGRATORS, te, d, ticks=TICKS, h=H, u=SWING, **({"x0": START, "xhat0": START} | changes))


def model_response(case, **options):
    """The estimates, and P u: the model alone, from the same start."""
    model = Model(case.model.A, case.model.B, case.model.C, case.h)
    return trace(case, {NAME: options}).estimates[NAME], model_only(model, inputs(case), np.asarray(case.xhat0))


def test_estimate_tends_to_the_smith_predictor_as_the_bandwidth_grows():
    """P u has no delay in it. After the jump of the first arrival, y + P dh is nearer to it by the factor of the bandwidth."""
    for d in (10, D):
        case, settled, far = swinging(d), d + 150, {}
        for omega in (10.0, 20.0, 40.0):
            got, smith = model_response(case, omega=omega)
            far[omega] = np.abs(got - smith)[settled:, 0].max()
        assert far[10.0] > 0.01
        assert far[10.0] / far[20.0] == pytest.approx(2, rel=0.15)
        assert far[20.0] / far[40.0] == pytest.approx(2, rel=0.15)
        deadbeat, smith = model_response(case, pole=0.0)
        assert np.abs(deadbeat - smith)[settled:, 0].max() < 0.3 * far[40.0]


def test_error_of_a_perfect_start_is_what_the_delay_leaves():
    """Without a delay it is 0. With one it is (1 - Q) (1 - e^(-sT)) P u, here by adding up responses."""
    got, smith = model_response(swinging(0, 20))
    np.testing.assert_allclose(got, smith, rtol=0, atol=1e-12)
    case = swinging()
    got, smith = model_response(case, omega=8.0)
    gains = design(case, omega=8.0).gains
    F = expm(np.block([[INTEGRATORS.A, INTEGRATORS.B], [np.zeros((1, 3))]]) * H)
    L = np.vstack([gains.L, gains.l])
    late = np.concatenate([np.zeros(D), smith[: TICKS + 1 - D, 0]])
    late[:D] = smith[:D, 0]  # before the first arrival nothing is corrected
    z, want = np.zeros(3), []  # of the difference y - P u
    total = np.zeros(2)
    for k in range(TICKS + 1):
        moves = L[:, 0] * (late[k] - smith[k, 0] - z[0]) if k >= D else np.zeros(3)
        z, total = z + moves, total + moves[:2]
        want.append(total)
        z, total = F @ z, F[:2, :2] @ total
    np.testing.assert_allclose(got - smith, np.array(want), rtol=0, atol=1e-10)
    assert np.abs(got - smith).max() > 0.01


def test_a_wrong_start_of_an_integrator_is_not_removed():
    case = swinging(0, 5, xhat0=[START[0] + 0.2, START[1]])
    got = trace(case, {NAME: {"omega": 10.0}, "kf": {}})
    error = {name: (got.x - xhat)[-1, 0] for name, xhat in got.estimates.items()}
    assert error[NAME] == pytest.approx(-0.2, abs=1e-6)
    assert abs(error["kf"]) < 1e-3


def test_poles_are_at_the_bandwidth_and_omega_is_per_second():
    case = swinging(0, 5)
    for options in ({"omega": 6.0}, {"pole": float(np.exp(-6.0 * 0.05))}):
        gains = design(case, **options).gains
        F = expm(np.block([[INTEGRATORS.A, INTEGRATORS.B], [np.zeros((1, 3))]]) * 0.05)
        K = np.vstack([gains.L, gains.l]) @ np.array([[1.0, 0.0, 0.0]])
        np.testing.assert_allclose(np.poly((np.eye(3) - K) @ F), np.poly([np.exp(-0.3)] * 3), rtol=0, atol=1e-10)


def test_it_has_no_certificate_and_says_why():
    assert design(Case(CART, 20, 20)).certificate.inequality == "none: it ignores delays"


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (ODD, "got 2 outputs, expected a chain of n integrators"),
        (INTEGRATORS._replace(B=np.array([[1.0], [0.0]])), "relative degree 1 with 2 states"),
        (
            INTEGRATORS._replace(A=np.array([[0.0, 1.0], [4.0, 0.0]])),
            r"a mode that grows by 2 1/s, expected a stable plant",
        ),
    ],
)
def test_other_plants_are_refused_in_one_sentence(model, sentence):
    with pytest.raises(UserError, match=f"^cdob in case: .*{sentence}") as said:
        design(Case(model, 10, 0))
    assert str(said.value).count(". ") == 0


@pytest.mark.parametrize(("option", "value"), [("pole", 1.0), ("pole", -0.1), ("omega", 0.0)])
def test_option_out_of_range_is_refused(option, value):
    with pytest.raises(ValueError, match=option):
        OBSERVERS[NAME].options(**{option: value})
