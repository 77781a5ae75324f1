"""A filter with a learned gain: its recursion against NumPy, what training finds on a linear plant, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.gain_network import Reference

from pcbench.errors import UserError
from pcbench.external import export_draws, gain_network, score
from pcbench.external.gain_network import LearnedFilter, Network, System, Training, draw, estimates, train
from pcbench.study.parse import grid_of

PHI, C = np.array([[1.0, 0.3], [-0.2, 0.9]]), np.array([[1.0, 0.5]])
FEW = Training(units=4, steps=150, runs=16)
STUDY = {
    "name": "learn",
    "seeds": 32,
    "observers": ["kf", "model-only"],
    "lti": {
        "A": [[0.0, 1.0], [-0.3, -0.2]],
        "B": [[0.0], [1.0]],
        "C": [[1.0, 0.0]],
        "x0": [1.0, 0.0],
        "input": [{"signal": "sine", "amplitude": 0.5, "frequency": 0.7}],
        "process_std": [0.05, 0.2],
        "noise_std": 0.3,
        "prior_std": 0.5,
        "tick": 0.2,
        "duration": 16.0,
        "sampling_period": 0.6,
        "delay": 0.4,
    },
    "options": {"scenario": {"random_initial_state": True}},
}


def system(period=1, delay=0, noise=0.2, process=0.1, spread=0.0):
    return System(
        truth=lambda x: PHI @ x,
        model=lambda x: PHI @ x,
        output=lambda x: C @ x,
        x0=np.array([1.0, -0.5]),
        spread=spread * np.eye(2),
        process=process * np.eye(2),
        noise=lambda key, ticks: noise * jax.random.normal(key, (ticks, 1)),
        scale=np.array([0.5, 0.3, 0.4]),
        ticks=40,
        period=period,
        delay=delay,
    )


def network(units=5, seed=0):
    generator = np.random.default_rng(seed)
    shapes = (3 * units, 3), (3 * units, units), (3 * units,), (2, units), (2,)
    return Network(*(0.2 * generator.standard_normal(shape) for shape in shapes))._replace(o=np.array([0.3, -0.1]))


@pytest.mark.parametrize(("period", "delay"), [(1, 0), (3, 0), (1, 2), (3, 2), (2, 5)])
def test_recursion_equals_numpy(period, delay):
    mine, weights = system(period, delay), network()
    _, y = draw(mine, jax.random.key(3))
    reference = Reference(lambda x: PHI @ x, lambda x: C @ x, mine.x0, weights, mine.scale, delay)
    np.testing.assert_allclose(
        estimates(mine, weights, y), reference.estimates(np.asarray(y), period), rtol=0, atol=1e-10
    )


def test_perfect_start_is_zero():
    """Without noise the innovation is 0, whatever the gain."""
    mine = system(noise=0.0, process=0.0, period=2, delay=1)
    x, y = draw(mine, jax.random.key(0))
    np.testing.assert_allclose(estimates(mine, network(), y), x, rtol=0, atol=1e-14)


@pytest.mark.ci
def test_training_comes_near_the_kalman_filter_and_not_below():
    mine = system(spread=0.3)
    found = train(mine, FEW)
    x, y = jax.vmap(lambda key: draw(mine, key))(jax.random.split(jax.random.key(9), 300))
    learned = np.asarray(jnp.mean((jax.vmap(lambda y: estimates(mine, found, y))(y) - x) ** 2, (1, 2)))
    kalman = np.mean((np.array([kf(mine, np.asarray(each)) for each in y]) - np.asarray(x)) ** 2, (1, 2))
    d = learned - kalman
    assert d.mean() > -1.96 * d.std() / np.sqrt(300)
    assert learned.mean() < 1.05 * kalman.mean()


def kf(mine, y):
    x, P, R, Q, out = mine.x0, 0.09 * np.eye(2), 0.04, 0.01 * np.eye(2), []
    for each in y:
        K = P @ C.T / (C @ P @ C.T + R)
        x, P = x + K @ (each - C @ x), P - K @ C @ P
        out.append(x)
        x, P = PHI @ x, PHI @ P @ PHI.T + Q
    return np.array(out)


@pytest.mark.slow
def test_external_row_on_late_samples_is_not_below_kf(tmp_path):
    export_draws.write(grid_of(STUDY, {}, []), tmp_path / "draws")
    result = score.run(tmp_path / "draws", "pcbench.external.gain_network:LearnedFilter", "learned")
    runs = result.runs[result.runs.signal == "x1"].set_index("seed")
    kf, learned = (runs[runs.observer == name].steady_mse for name in ("kf", "learned"))
    d = learned - kf
    assert d.mean() > -1.96 * d.sem()
    assert learned.mean() < 1.1 * kf.mean()


def cell(**changes):
    given = {
        "scenario": "s",
        "cell": 0,
        "period": [2],
        "intervals": [2],
        "delay": [1],
        "latest": 1,
        "unknown_std": [],
        "ticks": 9,
    }
    model = {"E": None, "Phi": PHI.tolist(), "C": C.tolist(), "Gamma": [[0.0], [1.0]]}
    return given | {"model": model, "R": [[0.1]], "Q": np.eye(2).tolist(), "P0": np.eye(2).tolist()} | changes


def test_filter_of_a_run_takes_inputs_and_late_samples(monkeypatch):
    """Tick by tick as an external program, against the recursion from the same start with the input added."""
    monkeypatch.setattr(gain_network, "train", lambda system: network())
    start, y, u = np.array([0.4, -0.1]), np.random.default_rng(1).standard_normal((9, 1)), np.linspace(0, 1, 9)[:, None]
    mine = LearnedFilter(cell(), start)
    scale, inputs = mine.system.scale, iter(u[:-1])
    reference = Reference(
        lambda x: PHI @ x + np.array([[0.0], [1.0]]) @ next(inputs), lambda x: C @ x, start, network(), scale, 1
    )
    want = reference.estimates(y, 2)
    for k in range(9):
        late = [Arrived(y[k - 1])] if k >= 1 and (k - 1) % 2 == 0 else []
        np.testing.assert_allclose(mine.step(0.1 * k, u[k - 1], late), want[k], rtol=0, atol=1e-10)


class Arrived:
    def __init__(self, value):
        self.value, self.mask = value, ~np.isnan(value)


def test_a_sample_of_some_outputs_is_refused(monkeypatch):
    monkeypatch.setattr(gain_network, "train", lambda system: network())
    mine = LearnedFilter(cell(), np.zeros(2))
    with pytest.raises(
        UserError, match=r"t = 0.2 s: got a sample of some outputs only, expected all at a time; use kf\."
    ):
        mine.step(0.2, np.zeros(1), [Arrived(np.array([np.nan]))])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"period": [2, 4]}, "several clocks"),
        ({"intervals": [2, 3]}, "varying samples"),
        ({"latest": 3}, "varying samples"),
        ({"period": [50], "intervals": [50]}, "got 50 ticks as period or delay"),
        ({"unknown_std": [1.0]}, "unknown inputs"),
    ],
)
def test_what_it_cannot_do_is_refused(changes, words):
    with pytest.raises(UserError, match=words):
        LearnedFilter(cell(**changes), np.zeros(2))
