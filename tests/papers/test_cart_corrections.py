"""Where a sentence about the cart is not quite right, the proof. (The rest of it is confirmed in test_cart_numbers.)"""

import numpy as np
import pytest
from harness import CART
from scipy.linalg import expm, solve_continuous_are

import pcbench


def test_kfbo_steady_rmse_is_1_0415_by_the_rule_and_1_0414_with_tick_n():
    """Metrics use ticks 0 .. N-1; the figure 1.0414 comes out only when tick N is counted as well."""
    d = pcbench.simulate("cart/nominal", "kfbo")
    e = (d["position"] - d["kfbo.position"]).to_numpy()[3000:]
    assert np.sqrt(np.mean(e[:-1] ** 2)) == pytest.approx(1.041490, abs=1e-6)
    assert np.sqrt(np.mean(e**2)) == pytest.approx(1.041421, abs=1e-6)


def test_q_of_identity_gives_a_gain_of_0_5000():
    """Q = 0.001 I gives K = [0.50002, 8.4e-6]: not the printed gain, nor 0.5002."""
    P = solve_continuous_are(CART.A.T, CART.C.T, 0.001 * np.eye(2), np.array([[0.004]]))
    np.testing.assert_allclose(P[:, 0] / 0.004, [0.50001673, 8.364e-6], rtol=1e-4)


def test_feasibility_of_the_lmi_is_not_only_a_sum():
    """0 < l1 + l2/122 < 2 is not enough at short periods: te = 0.01, L = [3, -183] has sum 1.5 and is unstable."""
    Phi, L = expm(CART.A * 0.01), np.array([[3.0], [-183.0]])
    assert 0 < L[0, 0] + L[1, 0] / 122 < 2
    assert np.abs(np.linalg.eigvals((np.eye(2) - L @ CART.C) @ Phi)).max() > 1.15


def test_the_least_spectral_norm_is_not_unique():
    """L moved along [1, 0] by less than eps(te) has the same norm: the closed form is the Frobenius argmin."""
    Phi = expm(CART.A * 0.02)
    c = (CART.C @ Phi).T
    L = Phi @ c / (c.T @ c)

    def norm(L):
        return np.linalg.norm((np.eye(2) - L @ CART.C) @ Phi, 2)

    moved = L + np.array([[0.05], [0.0]])
    assert norm(moved) == pytest.approx(norm(L), rel=1e-12)
    assert np.linalg.norm((np.eye(2) - moved @ CART.C) @ Phi) > np.linalg.norm((np.eye(2) - L @ CART.C) @ Phi)
