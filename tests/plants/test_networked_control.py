"""The plants of networked control: eigenvalues, the largest constant period, and runs of their loops against the reference."""

import numpy as np
import pytest
from reference import linear, loop
from scipy.optimize import brentq

import pcbench
from pcbench.plants import ncs_reactor, ncs_two_state
from pcbench.scenarios import SCENARIOS
from pcbench.study import controller_table

TWO_STATE, REACTOR = SCENARIOS["ncs-two-state/held"], SCENARIOS["ncs-reactor/round-robin"]
A2, B2, K2 = np.array([[0.0, 1.0], [0.0, -0.1]]), np.array([[0.0], [0.1]]), np.array([[3.75, 11.5]])
A4 = np.array(
    [[1.38, -0.2077, 6.715, -5.676], [-0.5814, -4.29, 0, 0.675], [1.067, 4.273, -6.654, 5.893], [0.048, 4.273, 1.343, -2.104]]
)  # fmt: skip
B4 = np.array([[0, 0], [5.679, 0], [1.136, -3.146], [1.136, 0]])
C4 = np.array([[1.0, 0, 1, -1], [0, 1, 0, 0]])
KP, KI = np.array([[0.0, -2.0], [5.0, 0.0]]), np.array([[0.0, -2.0], [8.0, 0.0]])  # of the output, u = KP y + KI int y


def radius_over(period):
    """The spectral radius of x(t_k+1) = (Phi - Gamma K) x(t_k)."""
    Phi, Gamma = linear.discretise(A2, B2, period)
    return np.abs(np.linalg.eigvals(Phi - Gamma @ K2)).max()


def test_two_state_plant_has_its_closed_loop_and_its_largest_constant_period():
    model = ncs_two_state.nominal(ncs_two_state.Numbers())
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(model.A - model.B @ K2)), [-0.75, -0.5], atol=1e-12)
    assert brentq(lambda T: radius_over(T) - 1, 1.0, 3.0) == pytest.approx(1.72941, abs=1e-5)


@pytest.mark.parametrize("period", [0.5, 1.5, 1.72, 1.73, 2.0])
def test_pcbench_has_the_eigenvalue_of_the_two_state_loop_and_warns_above_the_limit(period):
    s = TWO_STATE.with_fields(sampling_period=(period, period), control={**TWO_STATE.loop.control, "period": period})
    assert abs(controller_table.slowest_mode(s, "loop").mode) == pytest.approx(radius_over(period), rel=1e-10)
    assert bool(controller_table.warning(s, "loop")) == (period > 1.72941)


def test_batch_reactor_has_the_eigenvalues_of_its_source_and_of_its_loop():
    model = ncs_reactor.nominal(ncs_reactor.Numbers())
    assert [model.A.tolist(), model.B.tolist(), model.C.tolist()] == [A4.tolist(), B4.tolist(), C4.tolist()]
    found = np.sort(np.linalg.eigvals(model.A).real)
    np.testing.assert_allclose(found, [-8.66589, -5.05657, 0.06351, 1.99096], atol=5e-6)
    whole = np.block([[A4 + B4 @ KP @ C4, B4 @ KI], [C4, np.zeros((2, 2))]])
    found = np.sort_complex(np.linalg.eigvals(whole))
    want = [-17.659, -15.036, -2.2086 - 1.7306j, -2.2086 + 1.7306j, -0.8221 - 0.3812j, -0.8221 + 0.3812j]
    np.testing.assert_allclose(found, want, atol=5e-4)


def test_run_of_the_two_state_loop_is_the_references():
    """Period of 0.3 s over 3 s, with the run's own noise."""
    ticks, every = 300, 30
    control = {"K": K2.tolist(), "period": 0.3}
    s = {"base": TWO_STATE.name, "duration": 3.0, "steady_start": 1.0, "sampling_period": 0.3, "control": control}
    frame = pcbench.simulate({"name": "loop", "scenario": s}, "kf", seed=5)
    Phi, Gamma = linear.discretise(A2, B2, 0.01)
    plant = loop.Plant(
        Phi, Gamma, np.eye(2), np.full(2, 0.01), np.zeros(2), np.array([1.0, 0.5]), np.zeros(2), np.eye(2)
    )
    law = loop.Feedback(K2, np.zeros((ticks + 1, 2)), np.zeros((ticks + 1, 1)))
    want = loop.simulate(plant, loop.Network(every, 0), loop.Network(every, 0), law, ticks, 0, 5)
    for columns, theirs in ((["position", "velocity"], want.x), (["kf.position", "kf.velocity"], want.xhat)):
        np.testing.assert_allclose(frame[columns].to_numpy(), theirs, rtol=0, atol=1e-10)
    assert np.abs(want.x - want.xhat).max() > 1e-3, "noise has an effect"


def test_run_of_the_batch_reactors_loop_is_the_references():
    """From a perfect start without noise the estimate is the state: the PI law by backward differences, by hand."""
    quiet = {"process_std": 0.0, "noise_std": 0.0, "xhat0": list(REACTOR.truth.x0), "assumed_process_std": 0.01}
    base = {"base": REACTOR.name, "duration": 2.0, "steady_start": 1.0, "assumed_noise_std": 0.01}
    frame = pcbench.simulate({"name": "loop", "scenario": base | quiet}, "kf")
    Phi, Gamma = linear.discretise(A4, B4, 0.01)
    x, total, want = np.array(REACTOR.truth.x0), np.zeros(2), []
    for _ in range(201):
        want.append(x)
        total = total + 0.01 * KI @ C4 @ x
        x = Phi @ x + Gamma @ (KP @ C4 @ x + total)
    for prefix in ("", "kf."):
        got = frame[[f"{prefix}{name}" for name, _ in ncs_reactor.SIGNALS]].to_numpy()
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-10)
