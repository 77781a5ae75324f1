"""Process noise of a scenario whose states' noises are correlated: a root [n, n] of the covariance of a tick."""

import numpy as np
import pytest

import pcbench

SHORT = {"base": "quadruple-tank/delayed", "duration": 100.0, "steady_start": 50.0}
ROOT = [[0.1, 0, 0, 0], [0.05, 0.1, 0, 0], [0, 0, 0.1, 0], [0, 0, -0.02, 0.1]]


def study(**given):
    return {"name": "pushed", "scenario": SHORT | given, "observers": ["kf"]}


def test_a_diagonal_root_is_a_number_for_each_state():
    each = [0.1, 0.2, 0.0, 0.05]
    one, other = (pcbench.simulate(study(process_std=std), "kf", seed=3) for std in (each, np.diag(each).tolist()))
    np.testing.assert_allclose(one.to_numpy(float), other.to_numpy(float), rtol=0, atol=1e-12)


@pytest.mark.ci
def test_noises_have_the_covariance_and_the_filter_knows_it():
    """In one tick from rest the plant moves by the noise alone: its covariance is the root's square."""
    frames = [pcbench.simulate(study(process_std=ROOT, input="zero", x0=[0.0] * 4), "kf", seed=s) for s in range(400)]
    moved = np.array([frame[[f"level_{i}" for i in (1, 2, 3, 4)]].iloc[1] for frame in frames])
    want = np.array(ROOT) @ np.array(ROOT).T
    np.testing.assert_allclose(moved.T @ moved / len(moved), want, atol=0.0025)


@pytest.mark.parametrize(
    ("std", "sentence"),
    [
        ([[0.1, 0, 0, 0]] * 3, r"process_std: got 3 numbers, expected 4, one for each state of quadruple-tank"),
        ([[0.1, 0, 0]] * 4, r"process_std\[0\]: got 3 numbers, expected 4, one for each state"),
        ([0.1, [0.1, 0, 0, 0], 0.1, 0.1], r"process_std\[1\]: got \[0.1, 0, 0, 0\], expected a valid number"),
        ([["a", 0, 0, 0]] * 4, r"process_std\[0\]\[0\]: got 'a', expected a valid number"),
    ],
)
@pytest.mark.parametrize("key", ["process_std", "assumed_process_std"])
def test_what_is_no_root_is_one_sentence(key, std, sentence):
    with pytest.raises(pcbench.UserError, match=sentence):
        pcbench.run(study(**{key: std}))
