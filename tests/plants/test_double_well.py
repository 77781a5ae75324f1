"""The double well: its equilibria, how long it stays in a well, and a run against the reference."""

import numpy as np
import pytest
from reference import ekf, threefry
from scipy.integrate import quad

import pcbench
from pcbench.plants import double_well


def test_the_wells_are_stable_and_the_wall_is_not():
    model = double_well.nominal(double_well.Numbers())
    np.testing.assert_array_equal(model.A, [[4.0]])
    slope = [4.0 - 12.0 * x**2 for x in (-1.0, 0.0, 1.0)]
    assert slope == [-8.0, 4.0, -8.0]


@pytest.mark.ci
def test_run_is_the_references():
    """One Runge-Kutta step a tick, with the draws of the run."""
    seed, ticks, dt = 6, 200, 0.025
    study = {"base": "double-well/sampled", "duration": ticks * dt, "steady_start": 1.0, "input": "sine", "x0": 0.3}
    frame = pcbench.simulate({"name": "well", "scenario": study}, ["ekf"], seed=seed)
    x, want = np.array([0.3]), []
    for k in range(ticks + 1):
        want.append(x)
        u = np.sin(4 * dt * k)
        x = ekf.rk4(lambda x, u: 4 * x * (1 - x**2) + u, x, u, dt)
        x = x + 0.8 * dt**0.5 * threefry.normal(0, seed, "process", 0, k)
    np.testing.assert_allclose(frame[["position"]].to_numpy(), want, rtol=0, atol=1e-10)


@pytest.mark.ci
def test_position_has_the_variance_of_its_stationary_density():
    """p(x) is proportional to exp(-2 V(x) / 0.8^2) with V = x^4 - 2 x^2, whose slope is -4 x (1 - x^2)."""

    def part(power):
        return quad(lambda x: x**power * np.exp(-2 * (x**4 - 2 * x**2) / 0.64), -3, 3)[0]

    study = {"name": "well", "scenarios": ["double-well/sampled"], "observers": ["model-only"], "seeds": 400}
    stats = pcbench.run(study | {"options": {"scenario": {"random_initial_state": True}}}).stats
    row = stats[stats.metric == "steady_pooled_rmse"].iloc[0]
    half = row.ci_high - row["mean"]
    # model-only stays on the wall, 0, so its error is the position; a tick of 25 ms changes the variance by a few per cent
    assert abs(row["mean"] - np.sqrt(part(2) / part(0))) < 0.03 + 2 * half
