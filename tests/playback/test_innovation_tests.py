"""What is said of observers without truth agrees with references that have no filter: to 1e-10.

All samples of a log are a joint normal; the smoothed state is its conditional mean.
"""

import numpy as np
import pytest
from logged import MOTOR
from reference import logs as reference
from reference.linear import Model, Sample
from scipy.linalg import expm

import pcbench
from pcbench.planning import context_of
from pcbench.playback import innovation_tests, smoother
from pcbench.playback.setup import open_playback
from pcbench.recordings import tables

DT, STEADY = 0.01, 1.2  # s; the second is 0.3 of the duration


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    pcbench.simulate(MOTOR, "kf", seed=5, log=folder)
    return folder, pcbench.replay(folder, MOTOR, ["kf", "kf-cloning", "model-only"])


def books(folder):
    """Innovations and their variances by the book's recursion at the ticks of the samples that arrived."""
    A, B = np.array(MOTOR["lti"]["A"]), np.array(MOTOR["lti"]["B"])
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    (batch,), (inputs,) = tables.open_tables(folder).measurements(), tables.open_tables(folder).inputs.read()
    y = np.full(len(inputs.t), np.nan)
    came = ~np.isnan(batch.arrived)
    y[np.rint(batch.sampled[came] / DT).astype(int)] = batch.value[came]
    Q, P0 = np.diag(np.square(MOTOR["lti"]["process_std"])), np.eye(2)
    return reference.kalman(
        whole[:2, :2], whole[:2, 2:], Q, np.array([[1.0, 0.0]]), 0.01, np.zeros(2), P0, inputs.values, y
    )


@pytest.mark.ci
def test_a_smoother_is_left_out_before_memory_runs_out(replayed, monkeypatch):
    folder, found = replayed
    assert not found.distances.empty
    monkeypatch.setattr(smoother.memory, "free", lambda: 1 << 14)
    found = pcbench.replay(folder, MOTOR, ["kf", "kf-cloning", "model-only"])
    assert found.distances.empty
    (said,) = (sentence for sentence in found.summary["notes"] if "smoother" in sentence)
    assert said.endswith("it needs a linear model without unknown inputs, and memory for all ticks.")


@pytest.mark.ci
def test_what_a_filter_expects_is_what_the_book_says(replayed):
    folder, found = replayed
    nu, s = books(folder)
    z = nu / np.sqrt(s)
    Q, p = reference.ljung_box(z, min(20, len(z) // 5))
    want = {
        "samples": len(z),
        "nis": np.mean(z**2),
        "ljung_box": Q,
        "ljung_box_p": p,
        "log_likelihood": np.mean(-0.5 * (np.log(2 * np.pi * s) + z**2)),
    }
    for row in found.innovations.to_dict("records"):
        for name, value in want.items():
            assert row[name] == pytest.approx(value, rel=1e-10), (row["observer"], name)
    assert list(found.innovations.observer) == ["kf", "kf-cloning"]


def test_parts_of_a_sequence_say_what_the_whole_says():
    rng = np.random.default_rng(4)
    numbers = np.stack([rng.uniform(0, 3, 90), rng.integers(0, 3, 90), rng.normal(size=90), rng.normal(size=90)], 1)
    late = np.arange(90) >= 60
    sums = innovation_tests.Sums()
    for first in range(0, 90, 7):
        sums = innovation_tests.add(sums, numbers[first : first + 7], late[first : first + 7])
    counts = numbers[:, 1] > 0
    z = numbers[counts, 3] / np.sqrt(numbers[counts, 1])
    said = innovation_tests.results_of(sums)
    Q, p = reference.ljung_box(z, said["lags"])
    assert said["ljung_box"] == pytest.approx(Q, rel=1e-10)
    assert said["ljung_box_p"] == pytest.approx(p, rel=1e-8)
    held_out = numbers[counts & late]
    loss = np.log(2 * np.pi) + (held_out[:, 2].sum() + held_out[:, 0].sum()) / held_out[:, 1].sum()
    assert said["log_likelihood_held_out"] == pytest.approx(-0.5 * loss, rel=1e-10)


def test_of_nothing_nothing_is_said():
    said = innovation_tests.results_of(
        innovation_tests.add(innovation_tests.Sums(), np.zeros((3, 4)), np.zeros(3, bool))
    )
    assert said["samples"] == 0
    assert said["verdict"] == "unknown"
    assert np.isnan([said[k] for k in ("nis", "ljung_box", "ljung_box_p", "log_likelihood")]).all()


def case():
    """Three states, two inputs, two outputs, process noise; samples of two channels at 40 ticks."""
    rng = np.random.default_rng(8)
    A = np.array([[-1.0, 2.0, 0.3], [-4.0, -0.5, 1.0], [0.2, -0.7, 0.1]])
    B = np.array([[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]])
    C = np.array([[1.0, 0.2, 0.0], [0.0, -0.4, 1.5]])
    ticks, h, W = 40, 0.02, 0.4 * B @ B.T
    u, y = rng.normal(size=(ticks, 2)), np.full((ticks, 2), np.nan)
    y[::3, 0], y[1::5, 1], y[6, 1] = rng.normal(size=14), rng.normal(size=8), 0.7
    samples = [Sample(k, k, j, 0, y[k, j]) for k, j in zip(*np.nonzero(~np.isnan(y)), strict=True)]
    return (
        Model(A, B, C, h),
        u,
        y,
        samples,
        np.array([0.5, -1.0, 2.0]),
        np.diag([1.0, 4.0, 9.0]),
        np.array([0.04, 0.09]),
        W,
    )


def linear_of(model, x0, P0, R, W):
    from reference.linear import discretise, process_noise

    Phi, Gamma = discretise(model.A, model.B, model.h)
    Q = process_noise(model.A, W, model.h)
    return smoother.Linear(Phi, Gamma, Q, model.C, np.zeros((2, 2)), R=R, x0=x0, P0=P0)


@pytest.mark.ci
@pytest.mark.parametrize("noise", [1.0, 0.0])
def test_the_smoother_is_the_conditional_mean_of_all_samples(noise):
    model, u, y, samples, x0, P0, R, W = case()
    got = np.asarray(smoother.smooth(linear_of(model, x0, P0, R, noise * W), u, y))
    want = reference.smoothed(model, u, samples, x0, P0, R, noise * W)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.ci
def test_distance_to_the_smoother_is_taken_after_the_transient(replayed):
    folder, found = replayed
    a = open_playback(folder, MOTOR, ["kf"])
    model = smoother.model_of(context_of(a.cell), np.zeros(2))
    (batch,), (inputs,) = a.log.measurements(), a.log.inputs.read()
    y = np.full((len(inputs.t), 1), np.nan)
    came = ~np.isnan(batch.arrived)
    y[np.rint(batch.sampled[came] / DT).astype(int), 0] = batch.value[came]
    best = np.asarray(smoother.smooth(model, inputs.values, y))
    for i, signal in enumerate(("angle", "rate")):
        e = (found.estimates[f"kf.{signal}"].to_numpy() - best[:, i])[found.estimates.t >= STEADY]
        said = found.distances.set_index(["observer", "signal"]).rms["kf", signal]
        assert said == pytest.approx(np.sqrt(np.mean(e**2)), rel=1e-10)
