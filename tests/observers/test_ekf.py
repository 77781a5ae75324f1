"""The extended Kalman filter on the arm against an independent one; on linear plants see test_reference_agreement."""

import jax
import numpy as np
import pytest
from reference import ekf as reference

import pcbench
from pcbench import planning
from pcbench.observers import ekf
from pcbench.planning import padding
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import rng, trajectory
from pcbench.study import Study, options_of
from pcbench.study.grid import cell_of

SECONDS = 0.4


def arm(z, u):
    """The arm's field with the unknown input d as fifth entry, at rest. Source: Peng 2017, (53)."""
    J, k, M, g, l, Fl, Fm = 4.0, 15.0, 0.15, 9.8, 0.3, 0.006, 0.005
    spring = k * (z[2] - z[0])
    link = (spring - Fl * z[1] - M * g * l * np.sin(z[0])) / J + z[4]
    return np.array([z[1], link, z[3], (u[0] - spring - Fm * z[3]) / J, 0 * z[4]])


@pytest.mark.parametrize(
    ("period", "delay"), [pytest.param(*times, marks=pytest.mark.nightly) for times in ((30, 75), (40, 40), (50, 0))]
)
def test_on_the_arm_it_equals_the_reference(period, delay):
    base = SCENARIOS["arm/sampled"]
    s = base.with_fields(duration=SECONDS, steady_start=SECONDS / 2, input="sine", noise_std=(1e-3, 2e-3),
                      sampling_period=(period * base.dt,) * 2, delay=(delay * base.dt,) * 2)  # fmt: skip
    options = options_of(Study(name="t", scenarios=[s.name]), s, "ekf")
    (p,) = padding.fit([planning.draft(cell_of(s), {"ekf": options})])
    got = jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, p.problem, np.asarray(0), np.asarray(0)))
    N = p.cell.times.ticks
    noise = np.asarray(rng.measurement_noise(0, 0, N // period + 1, 2)).T * s.sampling.noise_std
    arrivals = {
        i * period + delay: [(i * period, got.x[i * period, 1:3] + noise[i])] for i in range((N - delay) // period + 1)
    }
    Q = np.diag([0, 0, 0, 0, s.dt])  # d walks by its size a second: 1 rad/s^2
    C = np.eye(2, 5, 1)
    want = reference.ekf(arm, s.dt, [*s.belief.xhat0, 0.0], np.eye(5), Q, np.diag([1e-6, 4e-6]), C, got.u, arrivals)
    np.testing.assert_allclose(got.estimates["ekf"], want, rtol=0, atol=1e-10)


def test_its_design_says_how_far_a_tick_lets_states_and_unknowns_walk():
    """The noise of a tick: what is added to the states, and of what is unknown its size squared, walk a second."""
    s = SCENARIOS["arm/sampled"].with_fields(
        duration=0.1, steady_start=0.05, unknown_std=(3.0,), process_std=(1e-3, 2e-3, 0.0, 4e-3)
    )
    gains = ekf.design(planning.context_of(cell_of(s)), ekf.Options(walk=0.5)).gains
    np.testing.assert_allclose(gains.Q, np.diag([1e-6, 4e-6, 0.0, 16e-6, 0.5 * 9.0 * s.dt]), rtol=1e-12)
    np.testing.assert_allclose(gains.P0, np.diag([1.0, 1.0, 1.0, 1.0, 9.0]), rtol=1e-12)


@pytest.mark.nightly
def test_on_the_arm_it_is_no_worse_than_the_linear_filter():
    """The arm's gravity is nearly linear there: tail errors of both filters within 5 %."""
    stats = pcbench.run("arm/sampled", observers=["ekf", "kf"], seeds=64).stats
    rows = stats[(stats.metric == "steady_pooled_rmse") & (stats.signal == "link_velocity")].set_index("observer")[
        "mean"
    ]
    assert rows["ekf"] < 1.05 * rows["kf"]
