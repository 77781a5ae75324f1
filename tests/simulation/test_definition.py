"""The engine computes what the definition says: vmap of lax.scan over runs, for each kind of plant, schedule and loop."""

from functools import cache, partial

import hurried
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench import planning
from pcbench.planning import all_observers, padding, run_local
from pcbench.runtime import config
from pcbench.simulation import simulate_runs
from pcbench.study import parse

SEEDS = np.arange(3)
WITHIN = 1e-11  # of the largest error
RANDOM = {"options": {"scenario": {"random_initial_state": True}}}
LTI = {
    "A": [[0.0, 1.0], [-2.0, -0.6]],
    "B": [[0.0], [1.5]],
    "C": [[1.0, 0.0], [0.0, 1.0]],
    "sampling_period": [0.1, 0.2],
    "delay": [0.02, 0.05],
    "noise_std": [0.3, 0.4],
    "process_std": [0.02, 0.05],
    "tick": 0.01,
    "duration": 2.0,
}
SHARED = LTI | {"sampling_period": [0.1, 0.1], "delay": [0.03, 0.03]}
LQR = {"use": "lqr", "Q1": [1.0, 1.0], "Q2": [1.0]}
MANY = ["kf", "model-only", "kf-ignore-delay", "kf-cloning", "ekf", "ukf"]
FAULTS = {
    "outlier_probability": [0.1],
    "quantization_step": [0.05],
    "student_t_dof": [4],
    "timestamp_offset": [0.01],
}
CASES = {  # the longest first
    "clones": {
        "lti": LTI | {"delay": [0.3, 0.3], "sampling_period": [0.1, 0.1], "duration": 1.0},
        "observers": ["kf-cloning", "kf-larsen"],
        "axes": {"loss": [0.2], "delay_jitter": [0.05]},
        "options": {"scenario": {"random_initial_state": True, "consistency": True}},
    },
    "shared": {"scenarios": ["cart/white"], "observers": ["kf", "pccebo", "kfbo", "pco", "pi-pco"]},
    "drift": {"scenarios": ["cart/variable-gain"]},
    "csth": {"scenarios": ["csth/10s-noise"]},
    "arm": {"scenarios": ["arm/sampled"]},
    "continuous": {"scenarios": ["arm/sine"]},
    "reactor": {"scenarios": ["reactor/batch"]},
    "helicopter": {"scenarios": ["helicopter/constant"]},
    "process noise": {"lti": LTI, "observers": MANY, **RANDOM},
    "consistency": {
        "lti": LTI,
        "observers": ["kf"],
        "options": {"scenario": {"random_initial_state": True, "consistency": True}},
    },
    "bounds": {"lti": SHARED, "observers": ["interval", "kf"], **RANDOM},
    "bounds, random": {
        "lti": SHARED,
        "observers": ["interval"],
        "axes": {"loss": [0.2], "delay_jitter": [0.05]},
        **RANDOM,
    },
    "faults": {
        "lti": LTI,
        "observers": ["kf"],
        "axes": FAULTS,
        "options": RANDOM["options"] | {"kf": {"gate": 0.999}},
    },
    "random": {  # and channels that differ
        "lti": LTI,
        "observers": ["kf", "model-only", "kf-ignore-delay", "ekf"],
        "axes": {"loss": [[0.2, 0.4]], "delay_jitter": [0.05], "sampling_jitter": [0.02]},
        **RANDOM,
    },
    "stamps": {"lti": LTI, "observers": ["kf"], "axes": {"timestamp_jitter": [0.02], "loss": [0.1]}},
    "loop": {"lti": LTI, "observers": ["kf"], "controller": LQR, **RANDOM},
    "random loop": {"lti": LTI, "observers": ["kf-ignore-delay"], "controller": LQR, "axes": {"loss": [0.3]}},
    "network": {
        "lti": LTI,
        "observers": ["kf"],
        "controller": LQR,
        "axes": {"command_loss": [0.2], "command_std": [0.1]},
    },
}


def results(case, engine):
    """By cell and observer, what each metric is for some seeds, as the engine computes it: in one program or several."""
    study = parse.grid_of({"name": "definition", "seeds": len(SEEDS), "engine": engine} | CASES[case], {}, []).study
    cells = {}
    with config.float64():
        for found in run_local.execute(study, planning.plan(study), SEEDS):
            cells.setdefault(found.plan.cell.key, {}).update(found.results)
    return cells


@cache
def defined_results(case):
    """The same as the definition computes it, compiled in a hurry: it is what the engine is held against."""
    with hurried.programs():
        return results(case, "definition")


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_engine_equals_the_definition(case):
    """The engine as a user has it."""
    cells, by_definition = results(case, "steps"), defined_results(case)
    assert cells.keys() == by_definition.keys()
    for key, defined in by_definition.items():
        made = cells[key]
        assert made.keys() == defined.keys()
        for label, slow in defined.items():
            quick = made[label]
            assert quick.keys() == slow.keys()
            size = np.max(slow["max_abs_error"], initial=0.0, where=np.isfinite(slow["max_abs_error"]))
            for name, value in slow.items():
                scale = size**2 if "mse" in name and "rmse" not in name else max(size, 1.0)
                np.testing.assert_allclose(quick[name], value, atol=WITHIN * scale, err_msg=f"{label} {name}")


@pytest.mark.ci
def test_grid_points_of_one_shape_are_one_call_over_periods_delays_and_drifts():
    axes = {"sampling_period": [0.1, 0.2], "delay": [0.1, 0.3], "parameter_drift": [0.0, 0.2]}
    short = {"base": "cart/white", "name": "short", "duration": 1.0, "steady_start": 0.5}
    study = {"name": "stacked", "scenario": short, "observers": ["kf", "kfbo"], "seeds": 3, "axes": axes}
    with config.float64():
        plans = padding.fit(list(planning.drafts(all_observers.grid_of(study, {}, []).cells)))
        (layout,) = {p.layout for p in plans}
        problems = [p.problem for p in plans]
        simulate = jax.jit(
            partial(simulate_runs.simulate_runs, layout, root_seed=jnp.asarray(0), seeds=jnp.asarray(SEEDS))
        )
        together = jax.vmap(simulate)(jax.tree.map(lambda *a: jnp.stack(a), *problems))
        for i, problem in enumerate(problems):
            alone = simulate(problem)
            for one, of_all in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
                np.testing.assert_allclose(of_all[i], one, rtol=1e-11, atol=1e-11)
        final = np.asarray(together.final["kf"])
    assert len(final) == len({x.tobytes() for x in final}) == 8  # each has an influence
