"""Noise that is correlated between channels: drawn as the reference says, assumed by filters, followed by the bound."""

import numpy as np
import pytest
from reference import threefry
from scipy.linalg import expm

import pcbench
from pcbench.errors import UserError
from pcbench.planning import build, design_context
from pcbench.study import parse

RHO = [[1.0, 0.8, 0.1], [0.8, 1.0, -0.3], [0.1, -0.3, 1.0]]
STD = [0.1, 0.3, 0.2]
STUDY = {
    "name": "correlated",
    "observers": ["kf"],
    "seeds": 2,
    "lti": {"A": [[0.0, 1.0], [-1.0, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0], [1.0, 0.3], [0.0, 1.0]], "tick": 0.1,
            "sampling_period": 0.5, "delay": 0.3, "noise_std": STD, "duration": 6.0, "process_std": [0.01, 0.05],
            "states": ["a", "b"]},
}  # fmt: skip


def having(observers=("kf",), rho=RHO, **given):
    lti = STUDY["lti"] | ({"noise_correlation": rho} if rho else {}) | given
    return STUDY | {"lti": lti, "observers": list(observers)}


@pytest.mark.ci
@pytest.mark.parametrize("network", [{}, {"loss": 0.4}, {"delay_jitter": 0.4}], ids=["shared", "loss", "jitter"])
def test_noise_is_the_root_of_the_correlation_times_independent_draws(network):
    odd = pcbench.simulate(having(**network), "model-only", seed=4)
    clean = pcbench.simulate(having(rho=None, **network) | {"options": {}}, "model-only", seed=4)
    w = np.array([[threefry.normal(0, 4, "measurement", j, i) for j in range(3)] for i in range(13)])
    expected = w @ np.linalg.cholesky(np.array(RHO)).T * STD
    came = odd[["y1", "y2", "y3"]].dropna().to_numpy() - clean[["y1", "y2", "y3"]].dropna().to_numpy()
    steps = np.unique(np.round(came, 12), axis=0)
    wanted = np.round(expected - w * STD, 12)
    assert len(steps) > 3
    assert all((np.abs(wanted - row).max(1) < 1e-10).any() for row in steps if np.abs(row).max() > 0)


@pytest.mark.ci
def test_a_filter_is_designed_for_the_covariance_and_beats_one_that_takes_channels_for_independent():
    R = np.outer(STD, STD) * np.array(RHO)
    diagonal = {"kf-independent": {"R": np.square(STD).tolist()}, "kf-full": {"R": R.tolist()}}
    study = having(["kf", "kf-full", "kf-independent"]) | {"options": diagonal, "seeds": 256}
    runs = pcbench.run(study).runs
    rmse = {name: runs[runs.observer == name].sort_values("seed").steady_rmse.to_numpy() for name in study["observers"]}
    np.testing.assert_allclose(rmse["kf"], rmse["kf-full"], rtol=1e-12)
    better = rmse["kf-independent"] - rmse["kf"]
    assert better.mean() > 4 * better.std() / np.sqrt(len(better))


def test_the_bound_is_what_the_filter_of_the_covariance_reaches():
    (cell,) = parse.grid_of(having(), {}, []).cells
    bound = build.bound(cell, design_context.context_of(cell))
    ticks, A = 60, expm(np.array(STUDY["lti"]["A"]) * 0.1)
    C, R, Q = np.array(STUDY["lti"]["C"]), np.outer(STD, STD) * np.array(RHO), np.diag(np.square([0.01, 0.05]))
    P, filtered, variance = np.eye(2), {}, []
    for k in range(ticks):  # P_k|k of the samples that are taken, carried on from the newest that has arrived
        if k % 5 == 0:
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
            P = P - K @ C @ P
            filtered[k] = P
        newest = max((i for i in filtered if i + 3 <= k), default=None)
        M, start = (filtered[newest], newest) if newest is not None else (np.eye(2), 0)
        for _ in range(start, k):
            M = A @ M @ A.T + Q
        variance.append(np.diag(M))
        P = A @ P @ A.T + Q
    tail = np.array(variance)[cell.times.tail :]
    np.testing.assert_allclose(np.square(bound), tail if np.shape(bound) == tail.shape else tail.mean(0), rtol=1e-9)


@pytest.mark.ci
def test_exact_moments_refuse_it():
    exact = pcbench.exact_moments(having() | {"seeds": 64}).stats
    assert set(exact.method) == {"none"}
    assert all("correlated between channels" in reason for reason in exact.reason)


@pytest.mark.ci
@pytest.mark.parametrize("engine", ["steps", "definition"])
def test_engines_agree(engine):
    runs = pcbench.run(having(["kf", "ekf"], loss=0.2) | {"engine": engine, "seeds": 4}).runs.rmse
    again = pcbench.run(having(["kf", "ekf"], loss=0.2) | {"seeds": 4}).runs.rmse
    np.testing.assert_allclose(runs, again, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"rho": [[1.0, 0.5], [0.5, 1.0]]}, "expected 3 rows of 3 numbers"),
        ({"rho": [[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "symmetric, with ones on the diagonal"),
        ({"rho": [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "expected every eigenvalue above 0"),
        ({"delay": [0.1, 0.1, 0.3]}, "whose channels are not sampled together"),
        ({"noise_std": [0.1, 0.0, 0.1]}, "expected noise in every channel"),
    ],
)
def test_an_impossible_correlation_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        parse.grid_of(having(**given), {}, [])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("apart", [{"sampling_phase": [0.0, 0.1, 0.1]}, {"loss": [0.0, 0.2, 0.2]}])
def test_a_filter_of_channels_that_may_arrive_apart_takes_no_correlation(apart):
    R = {"R": (np.outer(STD, STD) * np.array(RHO)).tolist()}
    with pytest.raises(UserError, match="expected outputs with one period, delay and network"):
        pcbench.run(having(rho=None, **apart) | {"options": {"kf": R}})
