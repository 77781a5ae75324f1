"""What filters assume of noise, by channel, by state and in full: against NumPy, in tuning, and what does not fit."""

import numpy as np
import pytest
from reference import irregular, linear
from scipy.linalg import solve_continuous_are

import pcbench
from pcbench.errors import UserError
from pcbench.gains import parameters
from pcbench.observers import entry_of

TICK, TICKS, TE, LATE = 0.01, 80, 4, 6
PLANT = {  # three states, two inputs, two outputs with feedthrough, no symmetry
    "A": [[-1.0, 2.0, 0.3], [-4.0, -0.5, 1.0], [0.2, -0.7, 0.1]],
    "B": [[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]],
    "C": [[1.0, 0.2, 0.0], [0.0, -0.4, 1.5]],
    "D": [[0.7, -0.3], [0.0, 1.1]],
    "input": "sine, square",
    "sampling_period": TE * TICK,
    "delay": LATE * TICK,
    "noise_std": [0.1, 0.3],
    "process_std": [0.02, 0.0, 0.1],
    "tick": TICK,
    "duration": TICK * TICKS,
    "x0": [1.0, -2.0, 0.5],
}
MODEL = linear.Model(*(np.array(PLANT[k]) for k in "ABC"), TICK)
P0 = np.diag([1.0, 4.0, 0.25])
R = [[0.04, -0.03], [-0.03, 0.09]]
Q = [[2e-3, 5e-4, 0.0], [5e-4, 1e-3, -2e-4], [0.0, -2e-4, 4e-3]]


def study(observer, options, **changes):
    return {"name": "own", "lti": PLANT | changes, "observers": [observer], "options": {observer: options}}


def simulate(observer, options, **changes):
    d = pcbench.simulate(study(observer, options, **changes), [observer], seed=1)
    return d[["u1", "u2"]].to_numpy(), d[["y1", "y2"]].to_numpy(), d[[f"{observer}.x{i}" for i in (1, 2, 3)]].to_numpy()


def joint_filter(u, y, Q, R):
    """A Kalman filter of whole measurement vectors that come LATE ticks late, tick by tick: xhat [N+1, 3]."""
    Phi, Gamma = linear.discretise(MODEL.A, MODEL.B, TICK)
    x, P, at, out = np.zeros(3), P0, 0, []
    for k in range(len(u)):
        taken = k - LATE
        if taken >= 0 and taken % TE == 0:
            for i in range(at, taken):
                x, P = Phi @ x + Gamma @ u[i], Phi @ P @ Phi.T + Q
            K = P @ MODEL.C.T @ np.linalg.inv(MODEL.C @ P @ MODEL.C.T + R)
            x, P, at = x + K @ (y[k] - np.array(PLANT["D"]) @ u[taken] - MODEL.C @ x), P - K @ MODEL.C @ P, taken
        now = x
        for i in range(at, k):
            now = Phi @ now + Gamma @ u[i]
        out.append(now)
    return np.array(out)


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["kf", "ekf"])
@pytest.mark.parametrize(
    ("assumed", "Q", "R"),
    [
        ({"R": R, "Q": Q}, np.array(Q), np.array(R)),
        ({"R": 0.5, "Q": [1e-3, 0.0, 2e-3]}, np.diag([1e-3, 0.0, 2e-3]), 0.5 * np.eye(2)),
        ({"R": [0.5, 0.02]}, np.diag([4e-4, 0.0, 1e-2]), np.diag([0.5, 0.02])),
    ],
    ids=["in full", "by state", "by channel"],
)
def test_filters_equal_one_of_whole_vectors_that_assumes_the_same(observer, assumed, Q, R):
    u, y, got = simulate(observer, assumed)
    want = joint_filter(u, y, Q, R)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.ci
def test_noise_through_each_input_and_of_each_channel_with_clocks_of_their_own():
    q, R = [0.3, 0.02], [0.5, 0.02]
    u, y, got = simulate("kf", {"q": q, "R": R, "Q": [0.0] * 3}, sampling_period=[0.04, 0.03], delay=[0.06, 0.01])
    samples = []
    for j, (te, late) in enumerate(((4, 6), (3, 1))):
        for i, taken in enumerate(range(0, len(u) - late, te)):
            samples.append(linear.Sample(taken + late, taken, j, i, y[taken + late, j]))
    W = MODEL.B @ np.diag(q) @ MODEL.B.T
    want = irregular.kf(MODEL, u, samples, np.zeros(3), P0, np.array(R), W, D=np.array(PLANT["D"]))
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.parametrize(
    ("given", "Q", "R"),
    [
        ({"R": R, "Q": Q}, np.array(Q), np.array(R)),
        ({"R": [0.1, 0.4], "Q": [1.0, 2.0, 3.0]}, np.diag([1.0, 2.0, 3.0]), np.diag([0.1, 0.4])),
        ({"R": 0.1, "Q": 0.7}, 0.7 * MODEL.B @ MODEL.B.T, 0.1 * np.eye(2)),
    ],
)
def test_kfbo_solves_its_riccati_equation_for_what_it_assumes(given, Q, R):
    K = pcbench.design(study("kfbo", given), "kfbo").certificate.numbers["K"]
    P = solve_continuous_are(MODEL.A.T, MODEL.C.T, Q, R)
    np.testing.assert_allclose(K, P @ MODEL.C.T @ np.linalg.inv(R), rtol=1e-9)


@pytest.mark.parametrize(
    "value", [[0.5, 0.02], [[0.04, -0.03, 0.0], [-0.03, 0.09, 0.01], [0.0, 0.01, 0.02]]], ids=["by channel", "in full"]
)
def test_a_list_and_a_covariance_are_numbers_without_bounds_in_tuning(value):
    """By entry, and positive whatever the numbers are; a covariance stays one."""
    options = entry_of("kf").options(R=value)
    found, at = parameters.start("kf", entry_of("kf"), options, {}, ["R"], "test")
    assert len(at) == (2 if np.ndim(value) == 1 else 6)
    np.testing.assert_allclose(parameters.with_values(options, found, at).R, value, rtol=1e-9, atol=1e-12)
    there = at + np.random.default_rng(3).normal(size=len(at))
    moved = np.array(parameters.with_values(options, found, there).R)
    assert (np.linalg.eigvalsh(moved) > 0).all() if moved.ndim == 2 else (moved > 0).all()
    _, back = parameters.start("kf", entry_of("kf"), entry_of("kf").options(R=moved.tolist()), {}, ["R"], "test")
    np.testing.assert_allclose(back, there, rtol=1e-6, atol=1e-8)


def test_tuning_starts_from_what_designers_are_told_of_each_channel_and_state():
    numbers = pcbench.design(study("kf", {}), "kf").certificate.numbers
    found, at = parameters.start("kf", entry_of("kf"), entry_of("kf").options(), numbers, ["R", "Q"], "test")
    assert [(f.name, f.size) for f in found] == [("R", 2), ("Q", 3)]
    np.testing.assert_allclose(np.exp(at), [0.01, 0.09, 4e-4, 1e-12, 1e-2], rtol=1e-9)


BAD = {
    "R of three": (
        "kf",
        {"R": [1.0, 2.0, 3.0]},
        r"kf in lti: R: got \[1.0, 2.0, 3.0\], expected 2 numbers, one for each",
    ),
    "R of one row": (
        "ekf",
        {"R": [[1.0, 0.0]]},
        r"ekf in lti: R: got .*, expected 2 numbers, one for each output, or a matrix",
    ),
    "R ragged": ("kf", {"R": [[1.0, 0.0], [0.0]]}, "or a matrix of 2 x 2"),
    "R not symmetric": ("kf", {"R": [[1.0, 0.5], [0.0, 1.0]]}, "expected a covariance: symmetric"),
    "R indefinite": ("kf", {"R": [[1.0, 2.0], [2.0, 1.0]]}, "no eigenvalue below 0"),
    "R singular": ("kf", {"R": [[1.0, 1.0], [1.0, 1.0]]}, "expected every eigenvalue above 0"),
    "R of 0": ("kf", {"R": [1.0, 0.0]}, r"options\.kf: R\[1\]: got 0\.0, expected greater than 0"),
    "R a text": ("kf", {"R": "noise"}, r"options\.kf: R: got 'noise', expected a valid number"),
    "Q of two": ("kf", {"Q": [1.0, 2.0]}, r"kf in lti: Q: got .*, expected 3 numbers, one for each state"),
    "Q below 0": (
        "ekf",
        {"Q": [1.0, -1.0, 0.0]},
        r"options\.ekf: Q\[1\]: got -1\.0, expected greater than or equal to 0",
    ),
    "q of three": (
        "kf",
        {"q": [1.0, 2.0, 3.0]},
        r"kf in lti: q: got .*, expected a number, or 2, one for each input",
    ),
    "Q of kfbo": ("kfbo", {"Q": [1.0]}, r"kfbo in lti: Q: got \[1.0\], expected 3 numbers"),
    "R of kfbo": ("kfbo", {"R": [1.0]}, r"kfbo in lti: R: got \[1.0\], expected 2 numbers"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_named_in_one_sentence_and_nothing_is_written(what, tmp_path):
    observer, options, sentence = BAD[what]
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study(observer, options), seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not list(tmp_path.glob("out/*"))


def test_correlated_noise_is_refused_where_outputs_are_not_sampled_together():
    with pytest.raises(
        UserError, match="got noise that is correlated between outputs, expected outputs with one period"
    ):
        pcbench.design(study("kf", {"R": R}, delay=[0.06, 0.01]), "kf")
