"""The flexible joint: its eigenvalues, its observability, and a run against the reference."""

import numpy as np
import pytest
from reference import ekf, threefry

import pcbench
from pcbench.plants import flexible_joint

SIGNALS = [name for name, _ in flexible_joint.SIGNALS]


def motion(x, u):
    return np.array(
        [
            x[1],
            -48.6 * x[0] - 1.25 * x[1] + 48.6 * x[2] + 21.6 * u,
            x[3],
            19.5 * x[0] - 19.5 * x[2] - 3.33 * np.sin(x[2]),
        ]
    )


@pytest.mark.parametrize(
    ("gravity", "want"),
    [
        (3.33, [-0.4322 - 8.2798j, -0.4322 + 8.2798j, -0.1928 - 1.5222j, -0.1928 + 1.5222j]),
        (0.0, [-0.4452 - 8.2208j, -0.4452 + 8.2208j, -0.3596, 0.0]),
        (-3.33, [-1.7322, -0.4574 - 8.1654j, -0.4574 + 8.1654j, 1.3969]),  # the link upright
    ],
)
def test_eigenvalues_are_those_of_the_linear_model(gravity, want):
    model = flexible_joint.nominal(flexible_joint.Numbers(gravity=gravity))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(model.A)), want, atol=6e-5)
    seen = np.vstack([model.C @ np.linalg.matrix_power(model.A, i) for i in range(4)])
    assert np.linalg.matrix_rank(seen) == 4


@pytest.mark.ci
def test_run_is_the_references():
    """One Runge-Kutta step a tick, with the draws of the run."""
    seed, ticks = 6, 400
    study = {"base": "flexible-joint/sampled", "duration": ticks * 0.005, "steady_start": 1.0}
    frame = pcbench.simulate({"name": "joint", "scenario": study}, ["ekf"], seed=seed)
    x, want = np.array([1.0, 0.0, 1.0, 0.0]), []
    for k in range(ticks + 1):
        want.append(x)
        w = [0.0 if c % 2 == 0 else 0.005 * threefry.normal(0, seed, "process", c, k) for c in range(4)]
        x = ekf.rk4(motion, x, np.sin(4 * 0.005 * k), 0.005) + w
    np.testing.assert_allclose(frame[SIGNALS].to_numpy(), want, rtol=0, atol=1e-10)
