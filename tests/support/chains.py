"""What the tests of the chain share: plants, delay vectors as cells of one study, the reference's links with given gains."""

from functools import cache

import jax
import numpy as np
from reference import chain as ref

from pcbench import planning
from pcbench.runtime import config
from pcbench.simulation import trajectory
from pcbench.study import parse

DELAYS = [[2, 5, 7], [7, 2, 5], [3, 3, 6], [4, 4, 4], [0, 2, 5], [1, 9, 1]]
SLOW = [[7, 2, 5], [4, 4, 4], [1, 9, 1]]  # by default an order, a tie and a zero are enough
OUTPUTS = {"chain": "updated", "chain-b": "deadbeat"}
OPTIONS = {
    "tank": {"chain": {"pole": 0.3}, "chain-b": {"gain": "riccati", "q": 1.0, "output": "deadbeat"}},
    "odd": {
        "chain": {"pole_per_tick": 0.6},
        "chain-b": {"gain": "riccati", "q": 0.5, "output": "deadbeat"},
    },
}


def random_plant():
    """Four states, two inputs, three outputs, D != 0, nothing symmetric; it barely decays."""
    rng = np.random.default_rng(11)
    A = rng.standard_normal((4, 4))
    A *= 0.97 / ref.radius(A)
    return ref.Plant(A, *(rng.standard_normal(shape) for shape in [(4, 2), (3, 4), (3, 2)]))


PLANTS = {"tank": ref.csth("10s"), "odd": random_plant()}
START = {"tank": np.array([0.5, 2e4, 5.0]), "odd": np.array([1.0, -2.0, 0.5, 3.0])}


def study(plant, xhat0=None):
    """A study of the plant with every delay vector as a cell; noise in every channel unless it starts perfectly."""
    p, x0 = PLANTS[plant], START[plant]
    dt, start = p.Ts, np.zeros_like(x0) if xhat0 is None else xhat0
    lti = {name: np.asarray(M).tolist() for name, M in zip("ABCD", p, strict=False)}
    lti |= {"dt": dt, "sampling_period": dt, "delay": 0.0, "noise_std": 0.0 if xhat0 is not None else [0.3, 0.1, 0.2]}
    lti |= {"input": "sine, square", "duration": 40 * dt, "x0": x0.tolist(), "xhat0": list(start)}
    lti |= {"prior_std": np.abs(x0).tolist()}
    axes = {"delay": [[float(d * dt) for d in delays] for delays in DELAYS]}
    raw = {"name": plant, "lti": lti, "observers": list(OUTPUTS), "options": OPTIONS[plant], "axes": axes}
    return parse.parse(raw, plant)


@cache
def record_cells(plant, perfect=False):
    """Every cell, planned and recorded; one program serves them all."""
    with config.float64():
        cells = planning.plan(study(plant, START[plant] if perfect else None))
        before = trajectory.jit_record()._cache_size()
        runs = [trajectory.jit_record()(p.layout, p.problem, np.asarray(0), np.asarray(3)) for p in cells]
        assert trajectory.jit_record()._cache_size() - before <= 1
    return cells, jax.tree.map(np.asarray, runs)


def links_of(plant, p, label, delays):
    """The reference's links with the gains under test (gains have a test of their own)."""
    steps, masks = ref.shape(delays)[1:]
    gains = p.problem.gains[label].links
    K = [np.asarray(K) for K, d in zip(gains.K, gains.source - gains.stamp, strict=True) if d > 0][::-1]
    return [ref.link(PLANTS[plant], d, m, k, OUTPUTS[label]) for d, m, k in zip(steps, masks, K, strict=True)]


SLOW = ["chain", "chain-riccati", "equal-delay", "no-delay-plain"]


def slow(**lti):
    """Ten ticks to a sample, two sensors, D != 0."""
    A, B, C, D = [[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.0], [0.3, 1.0]], [[0.4], [-0.2]]
    given = {
        "A": A,
        "B": B,
        "C": C,
        "D": D,
        "tick": 0.01,
        "sampling_period": 0.1,
        "delay": [0.2, 0.5],
        "noise_std": 0.0,
    }
    given |= {"input": "square", "duration": 4.0, "x0": [1.0, -2.0]}
    options = {
        "chain": {"pole": 0.4},
        "chain-riccati": {"gain": "riccati", "q": 2.0},
        "no-delay-plain": {"variant": "plain"},
    }
    study = {"name": "slow", "lti": given | lti, "options": options | {"no-delay": {"pole": 0.4}}, "observers": SLOW}
    matrices = [np.array(M) for M in (A, B, C, D)]
    fine = ref.discretise(matrices[0], matrices[1], 0.01)
    model = ref.Plant(*ref.discretise(matrices[0], matrices[1], 0.1), *matrices[2:], 0.1)
    return study, fine, model
