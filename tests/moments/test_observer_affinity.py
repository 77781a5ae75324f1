"""An observer that is hardly affine goes through one drawn realisation, and through the others if it is affine there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pcbench
from pcbench import planning
from pcbench.moments import solve
from pcbench.moments.affinity import is_curved
from pcbench.moments.dependence import argument_dependence
from pcbench.moments.realisations import draw_realisation
from pcbench.simulation import rng
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

MINE = """
import jax.numpy as jnp
from pcbench import Certificate, Design, Observer, ObserverSpec
from pydantic import BaseModel

class Options(BaseModel): pass
def start(gains, xhat0): return xhat0
def note(gains, memory, now): return jnp.zeros(0)
def jump(gains, memory, now, arrival):
    off = jnp.where(arrival.mask[0], arrival.value[0] - memory, 0.0)
    return memory + 0.3 * {jump}
def flow(gains, memory, now): return {flow} * 0.95 + 0.05 * now.u
def estimate(gains, memory): return memory
def design(context, options): return Design((), Certificate("none", 1.0, "none", "as it is", {{}}))
OWN = ObserverSpec(Observer(start, note, jump, flow, estimate), Options, design, False, "as assumed", "any schedule")
"""
SCHEDULES = 5
STUDY = {
    "name": "curved", "observers": ["own"],
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "duration": 3.0,
        "steady_start": 1.0,
        "noise_std": 0.3, "sampling_period": 0.4, "sampling_jitter": 0.1, "delay": 0.1, "states": ["a"], "input": "sine",
    },
}  # fmt: skip
ARM = {"base": "arm/sampled", "duration": 0.0605, "steady_start": 0.02}
CART = {"base": "cart/gaussian", "duration": 2.0, "steady_start": 1.0}
STRAIGHT = {"jump": "off", "flow": "memory"}


def test_reach_looks_into_loops_and_branches():
    def f(a, b, c):
        looped = jax.lax.scan(lambda s, r: ((s[1], s[0] + r), s[1]), (a, b), jnp.ones(3))
        chosen = jax.lax.cond(c > 0, lambda a, b: (a + 1, b), lambda a, b: (a, a * a), a, b)
        return looped[0][0], looped[1], chosen, c, jax.jit(lambda x, y: x)(a, b)

    sets = [
        set(leaf)
        for leaf in jax.tree.leaves(argument_dependence(f, 1.0, 2.0, 3.0), is_leaf=lambda x: isinstance(x, frozenset))
    ]
    assert sets == [{0, 1}, {0, 1}, {0, 2}, {0, 1, 2}, {2}, {0}]


def study(folder, **lines):
    (folder / "mine.py").write_text(MINE.format_map(STRAIGHT | lines))
    return STUDY | {"custom_observers": {"own": f"{folder}/mine.py:OWN"}}


@pytest.fixture
def gone(monkeypatch):
    """How many realisations each call had."""
    calls, compute = [], solve.compute

    def noted(ones, *how):
        calls.append(len(ones))
        return compute(ones, *how)

    monkeypatch.setattr(solve, "compute", noted)
    return calls


@pytest.mark.ci
def test_an_affine_observer_goes_through_all_realisations_at_once(tmp_path, gone):
    stats = pcbench.exact_moments(study(tmp_path), schedules=SCHEDULES).stats.query("metric == 'mse'")
    assert gone == [SCHEDULES]
    assert stats[["method", "n"]].to_numpy().tolist() == [["exact", SCHEDULES]]


@pytest.mark.ci
@pytest.mark.parametrize("lines", [{"flow": "jnp.sin(memory)"}, {"jump": "jnp.tanh(off)"}], ids=["flow", "jump"])
def test_one_that_is_not_goes_through_the_first_alone(lines, tmp_path, gone):
    stats = pcbench.exact_moments(study(tmp_path, **lines), schedules=SCHEDULES).stats.query("metric == 'mse'")
    assert gone == [1]
    assert stats["method"].tolist() == ["none"]
    assert "not affine in the noise" in stats["reason"].iloc[0]


@pytest.mark.ci
def test_one_whose_limit_is_never_met_has_the_numbers_of_one_without(tmp_path, gone):
    straight = pcbench.exact_moments(study(tmp_path), schedules=SCHEDULES).stats
    limited = pcbench.exact_moments(study(tmp_path, flow="jnp.clip(memory, -1e3, 1e3)"), schedules=SCHEDULES).stats
    assert gone == [SCHEDULES, 1, SCHEDULES]
    for column in ("method", "n"):
        assert limited[column].tolist() == straight[column].tolist()
    np.testing.assert_allclose(limited[["mean", "se"]], straight[["mean", "se"]], rtol=1e-12, atol=1e-14)


def plan(observer, scenario):
    given = {"kf-gate": {"gate": 3.0}, "kf-huber": {"huber": 1.5}}
    raw = {"name": "short", "scenarios": {"mine": scenario}, "observers": [observer]}
    (p,) = planning.plan(parse.parse(raw | {"options": {k: v for k, v in given.items() if k == observer}}, "short"))
    return p


def test_plants_that_each_run_draws_are_those_of_its_seed():
    """Kept from cell to cell, as all of them draw the same numbers."""
    p = plan("model-only", ARM | {"parameter_drift": 0.05})
    each = [draw_realisation(p, root, seed).problem.params for root in (0, 7) for seed in (0, 1)]
    assert len({(float(params.pace), float(params.phase)) for params in each}) == 4
    for seed in (0, 1):
        uniform = rng.uniforms(jnp.asarray(7), jnp.asarray([seed]), "drift", jnp.asarray(0), 1, 2)[0, :, 0]
        jax.tree.map(np.testing.assert_array_equal, each[2 + seed], p.layout.plant.of_run(p.problem.params, uniform))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("scenario", "observer", "doubted"),
    [
        *((ARM, name, True) for name in ("smo", "pio", "kf")),
        (ARM, "model-only", False),
        *((CART, name, False) for name in ("pccebo", "kfbo", "kf", "kf-larsen", "model-only")),
        *((CART, name, True) for name in ("kf-gate", "kf-huber")),
    ],
)
def test_doubted_is_who_goes_by_a_slope_that_noise_moves(scenario, observer, doubted):
    p = plan(observer, scenario)
    one = draw_realisation(p, 0, 0)
    assert is_curved(one.layout, one.problem) is doubted


@pytest.mark.parametrize(
    ("observer", "changes", "reason"),
    [
        ("kf", {"outlier_probability": 0.1}, "has samples of which 10 % are outliers"),
        ("kf", {"quantization_step": 0.1}, "has samples that are rounded"),
        ("kf", {"student_t_dof": 5.0}, "has samples whose noise is Student's t with 5 degrees"),
        ("kf", {"send_threshold": 0.1}, "has samples that are sent or not"),
        (
            "cascade-predictor",
            {"delay": 0.8},
            "keeps 4,103 numbers, where exact moments follow the covariance of at most",
        ),
    ],
)
def test_moments_that_are_refused_are_not_computed(monkeypatch, observer, changes, reason):
    monkeypatch.setattr(solve, "compute", lambda *given: pytest.fail("moments were computed"))
    study = {"name": "refused", "scenario": {"base": "cart/gaussian", **changes}, "observers": [observer]}
    (refused,) = pcbench.exact_moments(study).stats.reason.dropna().unique()
    assert refused.startswith(f"refused, cell 0: {observer} {reason}")
