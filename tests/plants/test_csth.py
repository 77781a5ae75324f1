"""The stirred tank heater: its plants, its inputs, process noise, and the filter on sensors of different delay."""

import numpy as np
import pytest
from reference import chain
from scipy.linalg import solve_discrete_are

import pcbench
from pcbench.dynamics import linear
from pcbench.plants import csth
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import rng

STATES = [name for name, _ in csth.SIGNALS]
KINDS = {"csth/literal": "literal", "csth/1s": "1s", "csth/10s": "10s"}


def table(d, prefix, names):
    return d[[f"{prefix}{name}" for name in names]].to_numpy()


def close(got, want, tolerance=1e-10):
    """Relative to the largest value of each state."""
    np.testing.assert_array_less(np.abs(got - want).max(0), tolerance * np.abs(want).max(0))


@pytest.mark.parametrize("scenario", KINDS)
def test_the_plant_is_the_references(scenario):
    want, s = chain.csth(KINDS[scenario]), SCENARIOS[scenario]
    numbers = csth.Numbers(**s.belief.model)
    Phi, Gamma = linear.one_tick(csth.nominal(numbers), s.dt)
    for got, matrix in ((Phi, want.A), (Gamma, want.B), (csth.nominal(numbers).C, want.C)):
        np.testing.assert_allclose(got, matrix, rtol=1e-12, atol=1e-15 * np.abs(matrix).max())


@pytest.fixture(scope="module")
def quiet():
    return pcbench.simulate("csth/10s", "model-only")


def test_the_worked_state_comes_out(quiet):
    np.testing.assert_allclose(table(quiet, "", STATES)[10], [2.5, 1.0126034033e5, 5.5226191919], rtol=1e-10)


def test_the_inputs_and_the_motion_are_the_references(quiet):
    u = table(quiet, "u", (1, 2))
    np.testing.assert_array_equal(u, chain.csth_input(len(u) - 1, 500.0))
    x, _ = chain.simulate(chain.csth("10s"), u, np.array(SCENARIOS["csth/10s"].truth.x0))
    close(table(quiet, "", STATES), x)
    assert quiet["t"].iloc[-1] == 2000.0


@pytest.fixture(scope="module")
def noisy():
    """A run of seed 3 with its own process and measurement noise."""
    d = pcbench.simulate("csth/10s-noise", "kf", seed=3)
    s, N = SCENARIOS["csth/10s-noise"], len(d) - 1
    with config.float64():
        v = np.asarray(rng.measurement_noise(0, 3, N + 1, 3)).T * s.sampling.noise_std
        keys = rng.run_keys(np.asarray(0), np.array([3]), "process", 3)
        w = np.stack([np.asarray(rng.normals(keys, [k] * 3))[:, 0] for k in range(N + 1)]) * s.truth.process_std
    return d, v, w


@pytest.mark.nightly
def test_process_noise_is_added_at_every_tick_from_its_own_stream(noisy):
    d, v, w = noisy
    x, y = chain.simulate(chain.csth("10s"), table(d, "u", (1, 2)), np.array([0.5, 2e4, 5.0]), w, v)
    close(table(d, "", STATES), x)
    held = chain.received(y, [2, 5, 7])
    np.testing.assert_allclose(table(d, "y", (1, 2, 3)), held, rtol=1e-9, atol=1e-9)
    assert not np.isclose(np.abs(w).max(), 0.0)


@pytest.mark.nightly
def test_kf_equals_the_reference_with_process_noise_and_unequal_delays(noisy):
    d, v, w = noisy
    plant = chain.csth("10s")
    u = table(d, "u", (1, 2))
    _, y = chain.simulate(plant, u, np.array([0.5, 2e4, 5.0]), w, v)
    Q, R, P0 = chain.csth_noise(10.0)
    want, _ = chain.kalman(plant, u, chain.received(y, [2, 5, 7]), [2, 5, 7], np.zeros(3), P0, Q, R)
    close(table(d, "kf.", STATES), want, 1e-9)


def test_kf_is_designed_for_the_process_noise_that_there_is():
    """After a long time its variance is that of a Riccati equation by SciPy; over five samples noise adds up as they are."""
    s = SCENARIOS["csth/10s-noise"]
    design = pcbench.design("csth/10s-noise", "kf")
    plant = chain.csth("10s")
    Q, R = (np.diag(np.square(std)) for std in (s.truth.process_std, s.sampling.noise_std))
    prior = solve_discrete_are(plant.A.T, plant.C.T, Q, R)
    K = prior @ plant.C.T @ np.linalg.inv(plant.C @ prior @ plant.C.T + R)
    want, size = prior - K @ plant.C @ prior, np.sqrt(np.diag(prior))
    found = design.certificate.numbers["P_end"]
    np.testing.assert_allclose(found / np.outer(size, size), want / np.outer(size, size), rtol=0, atol=1e-6)
    added = sum(np.linalg.matrix_power(plant.A, i) @ Q @ np.linalg.matrix_power(plant.A, i).T for i in range(5))
    np.testing.assert_allclose(
        design.gains.noise[0][5] / np.outer(size, size), added / np.outer(size, size), atol=1e-12
    )


@pytest.mark.nightly
def test_kf_has_the_worked_stationary_errors_and_attains_the_bound():
    result = pcbench.run(
        "csth/10s-noise", observers=["kf"], seeds=512, options={"scenario": {"random_initial_state": True}}
    )
    rows = result.stats.set_index(["signal", "metric"])
    for state, want in zip(STATES, (0.01020648, 731.83123, 0.05303873), strict=True):
        found = rows.loc[(state, "steady_pooled_rmse")]
        assert abs(found["mean"] - want) < 4 * found["se"], state
        efficiency = rows.loc[(state, "rms_efficiency")]
        assert abs(efficiency["mean"] - 1) < 4 * efficiency["se"], state
