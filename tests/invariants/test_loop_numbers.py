"""Numbers of loops that are known without us: by separation, and as JitterTime computes them; within four standard errors.

The plants are put into coordinates in which the process noise of a tick is white, x = T z.
"""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import BaseModel
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

import pcbench
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.protocols import Observer
from pcbench.scenarios import SCENARIOS
from pcbench.study.lti import Lti
from pcbench.synthesis.certificate import Certificate, Design

pytestmark = pytest.mark.usefixtures("in_a_hurry")


def noise_of_a_tick(A, R1, h):
    """The covariance that an intensity R1 adds over h seconds, by Van Loan."""
    n = len(A)
    whole = expm(h * np.block([[-A, R1], [np.zeros((n, n)), A.T]]))
    return whole[n:, n:].T @ whole[:n, n:]


def white_noise_scenario(A, B, C, h, **keys):
    """A continuous plant with noise through its input, as a scenario; and T."""
    T = np.linalg.cholesky(noise_of_a_tick(A, B @ B.T, h))
    back = np.linalg.inv(T)
    table = {"A": (back @ A @ T).tolist(), "B": (back @ B).tolist(), "C": (C @ T).tolist(), "tick": h} | keys
    s = Lti.model_validate(table | {"x0": [0.0, 0.0], "prior_std": [1.0, 1.0]}).scenario("loop", "test")
    return s.with_fields(process_std=(1.0, 1.0)), T


# a motor under LQG control whose measurement is late. Source: JitterTime, examples/lqg_dcmotor.m, and separation

MOTOR = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
Q1, Q2, R2 = np.diag([1.1, 0.3]), np.array([[0.7]]), 0.01
LATE = {0.0: 1.038186, 0.05: 1.079369, 0.1: 1.121180, 0.2: 1.206581, 0.5: 1.475295}


def continuous(tau):
    """J = tr(S R1) + Q2 tr(L P_tau L'), P_tau the error covariance of the state predicted over tau."""
    A, B, C = MOTOR
    S, P = solve_continuous_are(A, B, Q1, Q2), solve_continuous_are(A.T, C.T, B @ B.T, [[R2]])
    L, E = B.T @ S / Q2[0, 0], expm(A * tau)
    late = E @ P @ E.T + (noise_of_a_tick(A, B @ B.T, tau) if tau else 0)
    return np.trace(S @ B @ B.T) + Q2[0, 0] * np.trace(L @ late @ L.T)


def sampled_cost(tau, h):
    """The same with a measurement and a decision every h: the mean of x'Q1 x + u'Q2 u at these times."""
    A, B, C = MOTOR
    whole = expm(h * np.block([[A, B], [np.zeros((1, 3))]]))
    F, G, Q = whole[:2, :2], whole[:2, 2:], noise_of_a_tick(A, B @ B.T, h)
    S, P = solve_discrete_are(F, G, Q1, Q2), solve_discrete_are(F.T, C.T, Q, [[R2 / h]])
    P = P - P @ C.T @ C @ P / (C @ P @ C.T + R2 / h)
    for _ in range(round(tau / h)):
        P = F @ P @ F.T + Q
    L = np.linalg.solve(Q2 + G.T @ S @ G, G.T @ S @ F)
    return np.trace(S @ Q) + np.trace((Q2 + G.T @ S @ G) @ L @ P @ L.T)


@pytest.mark.parametrize("tau", LATE)
def test_the_cost_of_a_late_measurement_is_the_printed_one_as_sampling_grows_fast(tau):
    assert continuous(tau) == pytest.approx(LATE[tau], abs=1e-6)
    assert 2 * sampled_cost(tau, 0.0025) - sampled_cost(tau, 0.005) == pytest.approx(LATE[tau], abs=2e-4)


def study(monkeypatch, h, delays, seeds, duration, steady_start=8.0):
    s, T = white_noise_scenario(
        *MOTOR,
        h,
        sampling_period=h,
        delay=0.0,
        noise_std=0.1 / np.sqrt(h),
        duration=duration,
        steady_start=steady_start,
    )
    monkeypatch.setitem(SCENARIOS, "loop", s)
    controller = {"use": "lqr", "Q1": (T.T @ Q1 @ T).tolist(), "Q2": Q2.tolist()}
    raw = {"name": "lqg", "scenarios": ["loop"], "observers": ["kf"], "seeds": seeds, "controller": controller}
    return raw | {"axes": {"delay": delays}}


def costs(*given):
    stats = pcbench.run(study(*given)).stats
    return stats[stats.metric == "steady_lq_cost"].set_index("delay")[["mean", "se"]]


@pytest.mark.ci
def test_the_cost_of_lqg_with_a_late_measurement(monkeypatch):
    row = costs(monkeypatch, 0.05, [0.1], 256, 24.0).iloc[0]
    assert row["se"] < 0.03
    assert row["mean"] == pytest.approx(sampled_cost(0.1, 0.05), abs=4 * row["se"])


@pytest.mark.nightly
def test_the_cost_of_lqg_without_seeds(monkeypatch):
    """Exact at every delay once nothing is left of the start; and that by Richardson's rule comes to what is printed."""
    stats = pcbench.exact_moments(study(monkeypatch, 0.05, list(LATE), 2, 24.0, 23.0)).stats
    found = stats[stats.metric == "steady_lq_cost"].set_index("delay")
    assert (found.method == "exact").all()
    for tau, known in LATE.items():
        assert found.loc[tau, "mean"] == pytest.approx(sampled_cost(tau, 0.05), rel=1e-9)
        each = [sampled_cost(tau, 0.05 / 2**i) for i in range(6)]
        for order in (1, 2, 3, 4, 5):
            each = [(2**order * b - a) / (2**order - 1) for a, b in pairwise(each)]
        assert each[0] == pytest.approx(known, abs=1e-6)


@pytest.mark.nightly
def test_the_cost_of_lqg_with_a_late_measurement_at_every_delay(monkeypatch):
    found = costs(monkeypatch, 0.01, list(LATE), 1024, 60.0)
    for tau, row in found.iterrows():
        assert row["se"] < 0.012
        assert row["mean"] == pytest.approx(sampled_cost(tau, 0.01), abs=4 * row["se"])
        assert row["mean"] == pytest.approx(LATE[tau], abs=4 * row["se"])
    assert (np.diff(found["mean"]) > 0).all()


# the asynchronous Kalman filter of an inverted pendulum. Source: JitterTime.jl, test/example_2_test.jl (matrices, J and P)

PENDULUM = np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2)
AO1, BO1 = np.array([[0.5309, 0.079], [-0.8673, 0.8597]]), np.array([[0.0059, 0.4750], [0.1392, 1.0065]])  # of u, y1
AO2, BO2 = np.array([[1.0, -0.3906], [0.0, 0.0163]]), np.array([0.3906, 0.9837])  # of y2
FEEDBACK = np.array([[3.633, 2.7434]])
PRINTED = {"J": 12.574852494566, "P11": 0.334482211089, "P22": 0.736398452637, "Puu": 11.222643465877}


class NoOptions(BaseModel):
    pass


def two_gains(T):
    """The example's filter: y2 corrects, y1 predicts over its own period and corrects; samples of t = 0 are not in it."""
    back = np.linalg.inv(T)

    def jump(gains, memory, now, arrival):
        used = arrival.mask & (arrival.index > 0)
        second = jnp.where(used[1], AO2 @ memory + BO2 * arrival.value[1], memory)
        first = AO1 @ second + BO1[:, 0] * now.u[0] + BO1[:, 1] * arrival.value[0]
        return jnp.where(used[0], first, second)

    observer = Observer(
        init=lambda gains, xhat0: T @ xhat0,
        snapshot=lambda gains, memory, now: jnp.zeros(0),
        jump=jump,
        flow=lambda gains, memory, now: memory,
        estimate=lambda gains, memory: back @ memory,
    )
    proof = Certificate("none: a printed filter", 1.0, "none", "as printed", {})
    return ObserverSpec(
        observer, NoOptions, lambda context, options: Design((), proof), True, "two gains", "any schedule"
    )


@pytest.mark.nightly
def test_the_asynchronous_filter_costs_what_jittertime_computes(monkeypatch):
    h, seeds = 0.005, 4096
    keys = {"sampling_period": [0.15, 0.5], "delay": 0.0, "noise_std": [0.1**0.5, 0.1]}
    s, T = white_noise_scenario(*PENDULUM, h, **keys, duration=12 + h, steady_start=12.0)
    monkeypatch.setitem(SCENARIOS, "loop", s)
    monkeypatch.setitem(OBSERVERS, "two-gains", two_gains(T))
    feedback = {"use": "state-feedback", "K": (FEEDBACK @ T).tolist(), "period": 0.15}
    raw = {"name": "a", "scenarios": ["loop"], "observers": ["two-gains"], "seeds": seeds}

    def runs(Q1, Q2):
        controller = feedback | {"Q1": (T.T @ np.diag(Q1) @ T).tolist(), "Q2": Q2}
        found = pcbench.run(raw | {"controller": controller}).runs
        return found[found.signal == "x1"]

    found, position, rate = runs([1.0, 0.1], 0.1), runs([1.0, 0.0], 0.0), runs([0.0, 1.0], 0.0)
    N = round(12 / h) + 1
    for name, values in (
        ("J", h * (N * found.lq_cost - found.steady_lq_cost)),
        ("P11", position.steady_lq_cost),
        ("P22", rate.steady_lq_cost),
        ("Puu", found.steady_input_rms**2),
    ):
        se = values.std() / np.sqrt(seeds)
        assert values.mean() == pytest.approx(PRINTED[name], abs=4 * se), name
        assert se < 0.04 * PRINTED[name], "or four of them would prove little"
