"""Loops on any plant against the independent reference: laws, set points, networks on both sides; metrics of a run."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from loops import Q1, Q2, TICK, N, over, plant, resting, study
from reference import loop

import pcbench
from pcbench.engine import lane_array, random_schedules
from pcbench.engine.packing import PackedMemory
from pcbench.simulation.types import State

T = TICK * np.arange(2 * N)
STEP = np.where(T >= 0.3 - 1e-9, 0.7, 0.0)
SINE = 0.1 + 0.4 * np.sin(2 * np.pi * 0.9 * T)
AIMS = {"angle": {"step": 0.7, "at": 0.3}, "current": {"sine": 0.4, "frequency": 0.9, "offset": 0.1}}
BOTH = {"command_jitter": 0.05, "command_loss": 0.3, "command_std": 0.05, "actuator_delay": 0.03, "period": 0.02}
RANDOM = {"sampling_jitter": 0.02, "delay_jitter": 0.07, "loss": 0.25}
SENSOR = loop.Network(6, 4, jitter=2, spread=7, loss=0.25)
ACTUATOR = loop.Network(2, 3, jitter=5, loss=0.3, std=0.05)


def gap(frame, want, names=("angle", "rate", "current")):
    """The largest difference of states, estimates and inputs from the reference's, of one size."""
    both = [
        (frame[list(names)], want.x),
        (frame[[f"kf.{s}" for s in names]], want.xhat),
        (frame[["u1", "u2"]], want.u),
    ]
    return max(np.abs(np.asarray(a) - b).max() / np.abs(b).max() for a, b in both)


def feedback(p, every, ahead, aims=None, limit=np.inf):
    r = np.zeros((2 * N, 0)) if aims is None else np.stack(aims, 1)
    x_ref, u_ref = resting(p, r, [0, 2] if aims else [])
    Q = np.array(Q1), np.diag(Q2)
    return loop.Feedback(loop.lqr(*over(p, every), *Q), x_ref, u_ref, ahead, limit)


LQR = {"use": "lqr", "Q1": Q1, "Q2": Q2}


@pytest.fixture(scope="module")
def lqr_over_networks():
    """A loop with jitter and loss on both sides: its study, its law, and the reference's runs."""
    p = plant()
    law = feedback(p, 2, 3 + 5 // 2, [STEP, SINE])
    raw = study(LQR | BOTH | {"set_point": AIMS}, RANDOM)
    return raw, law, [loop.simulate(p, SENSOR, ACTUATOR, law, N, 0, seed) for seed in range(3)]


@pytest.mark.ci
def test_lqr_with_jitter_and_loss_on_both_sides_is_the_references(lqr_over_networks):
    raw, _, runs = lqr_over_networks
    assert gap(pcbench.simulate(raw, "kf", seed=1), runs[1]) < 1e-10


@pytest.mark.ci
def test_costs_and_errors_of_lqr_over_networks_are_the_references_run_by_run(lqr_over_networks):
    raw, law, runs = lqr_over_networks
    table = pcbench.run(raw).runs.pivot(index="seed", columns="signal")
    for seed, run in enumerate(runs):
        for metric, first in (("", 0), ("steady_", 50)):
            x, u, off = run.x[first:N], run.u[first:N], (run.x_ref - run.x)[first:N]
            cost = np.einsum("ti,ij,tj", off, np.array(Q1), off) + ((u - law.u_ref[first:N]) ** 2 @ Q2).sum()
            got = table.loc[seed]
            assert got[metric + "lq_cost", "angle"] == pytest.approx(cost / len(x), rel=1e-10)
            assert got[metric + "input_rms", "angle"] == pytest.approx(np.sqrt((u**2).sum(1).mean()), rel=1e-10)
            for i, name in enumerate(("angle", "rate", "current")):
                want = np.sqrt((off[:, i] ** 2).mean())
                assert got[metric + "tracking_rmse", name] == pytest.approx(want, rel=1e-10)
        e = (run.x - run.xhat)[:N]
        assert got["rmse", "current"] == pytest.approx(np.sqrt((e[:, 2] ** 2).mean()), rel=1e-10)
        assert np.isnan(got["lq_cost", "rate"]), "one number a run stands with its first signal"


STAMPS = {"timestamp_offset": -0.02, "clock_skew": -3e4, "timestamp_jitter": 0.02}


@pytest.mark.nightly
def test_a_loop_whose_stamps_are_wrong_is_the_references():
    """An offset, a drift and a jitter at once, beside random networks on both sides."""
    p, law, stamp = plant(), feedback(plant(), 2, 3 + 5 // 2), (-2, -3e-2, 2)
    sensor = RANDOM | STAMPS | {"sampling_jitter": 0.0}
    want = loop.simulate(p, SENSOR._replace(jitter=0, stamp=stamp), ACTUATOR, law, N, 0, 1)
    assert gap(pcbench.simulate(study(LQR | BOTH, sensor), "kf", seed=1), want) < 1e-10
    right = loop.simulate(p, SENSOR._replace(jitter=0), ACTUATOR, law, N, 0, 1)
    assert np.abs(right.x - want.x).max() > 1e-3, "they matter to the plant"


@pytest.mark.parametrize(
    ("late", "knows"),
    [(4, True), (0, False), *(pytest.param(*case, marks=pytest.mark.nightly) for case in ((0, True), (4, False)))],
)
def test_state_feedback_over_a_constant_delay(late, knows):
    p = plant()
    K = [[2.0, 1.2, 0.1], [0.3, -0.4, -0.5]]
    controller = {"use": "state-feedback", "K": K, "knows_delay": knows, "actuator_delay": late * TICK, "limit": 0.8}
    controller |= {"set_point": {"angle": 0.5}, "period": 0.03, "offset": [0.1, -0.2]}
    x_ref, u_ref = resting(p, np.full((2 * N, 1), 0.5), [0])
    law = loop.Feedback(np.array(K), x_ref, u_ref + np.array([0.1, -0.2]), late if knows else 0, 0.8)
    want = loop.simulate(p, loop.Network(6, 4), loop.Network(3, late), law, N, 0, 0)
    assert gap(pcbench.simulate(study(controller), "kf"), want) < 1e-10


@pytest.mark.nightly
def test_pid_with_a_filter_a_limit_and_a_table_of_set_points():
    p = plant()
    table = [[0.1, 0.2], [0.6, -0.3], [1.0, 0.4]]
    controller = {"use": "pid", "Kp": [[3.0, 0.2], [0.1, -1.0]], "Ki": [2.0, -0.5], "Kd": [[0.4, 0.0], [0.0, -0.02]]}
    controller |= {"filter": 0.05, "limit": 1.1, "period": 0.04, "set_point": {"angle": {"table": table}}}
    r = np.zeros(2 * N)
    for t, value in table:
        r[t - 1e-9 <= T] = value
    x_ref, _ = resting(p, r[:, None], [0])
    gains = np.array(controller["Kp"]), np.diag(controller["Ki"]), np.array(controller["Kd"])
    law = loop.Pid(*gains, 0.04, 0.05, x_ref, 1.1)
    want = loop.simulate(p, loop.Network(6, 4), loop.Network(4, 0), law, N, 0, 0)
    assert np.abs(want.u).max() == 1.1, "the limit is met"
    assert gap(pcbench.simulate(study(controller), "kf"), want) < 1e-10


@pytest.mark.nightly
def test_perfect_start_holds_in_a_loop_whose_inputs_are_lost_and_late_and_acknowledged():
    """True model, true start, no noise: no error, whatever the networks do; a noise of commands would make one."""
    raw = study(LQR | BOTH | {"command_std": 0.0, "set_point": AIMS}, RANDOM, 2, ("kf", "pccebo", "ekf"))
    raw["lti"] |= {"xhat0": raw["lti"]["x0"], "noise_std": 0.0}
    peak = pcbench.run(raw).runs.groupby("observer").max_abs_error.max()
    assert peak[["kf", "pccebo"]].max() < 1e-12
    assert peak["ekf"] < 1e-8, "its Runge-Kutta steps, under the inputs that it asks for again at every arrival"
    raw["observers"] = ["kf", "pccebo"]
    raw["controller"]["command_std"] = 0.05
    assert pcbench.run(raw).runs.max_abs_error.min() > 1e-4


@pytest.mark.nightly
def test_observers_each_have_a_plant_of_their_own_on_the_same_draws():
    """A worse estimate is a dearer loop; the draws are those of the observer alone."""
    raw = study(LQR | BOTH, seeds=8, observers=("kf", "model-only"))
    runs = pcbench.run(raw).runs
    cost = runs[runs.signal == "angle"].pivot(index="seed", columns="observer", values="steady_lq_cost")
    assert (cost["kf"] < cost["model-only"]).mean() > 0.8
    alone = pcbench.run(raw, observers="kf").runs
    np.testing.assert_array_equal(alone.rmse, runs[runs.observer == "kf"].rmse)


def test_runs_that_are_taken_out_bring_their_own_commands():
    """Three runs, two rows of one command: the second and the first are taken out, in this order."""
    commands = lane_array.table(lane_array.split(jnp.arange(6.0).reshape(2, 1, 3)))
    state = State(
        x=(),
        plant_draws=(),
        memories=PackedMemory([], jnp.zeros((0, 3))),
        flight=(),
        streams={},
        watches={},
        commands=commands,
    )
    events = SimpleNamespace(
        layout=SimpleNamespace(controller=True), memory_packing=SimpleNamespace(unpack=lambda kept: kept)
    )
    chunk = random_schedules.Chunk(jnp.array([1, 0]), jnp.zeros(2, int), jnp.asarray(2))
    mine = random_schedules._view_of_runs(events, state, chunk).commands
    np.testing.assert_array_equal(lane_array.join(mine), [[[1.0, 0.0]], [[4.0, 3.0]]])
