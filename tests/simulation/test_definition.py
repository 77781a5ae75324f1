"""The engine computes what the definition says: vmap of lax.scan over runs, for each kind of plant, schedule and loop."""

import jax
import numpy as np
import pytest

from pcbench import planning
from pcbench.engine import runner
from pcbench.machine import process
from pcbench.planning import padding
from pcbench.simulation import metrics
from pcbench.simulation.schedule import shared
from pcbench.simulation.simulate_runs import simulate_runs
from pcbench.study import read

SEEDS = np.arange(3)
WITHIN = 1e-11  # of the largest error
RANDOM = {"options": {"scenario": {"random_start": True}}}
LTI = {
    "A": [[0.0, 1.0], [-2.0, -0.6]],
    "B": [[0.0], [1.5]],
    "C": [[1.0, 0.0], [0.0, 1.0]],
    "sampling_period": [0.1, 0.2],
    "delay": [0.02, 0.05],
    "noise_std": [0.3, 0.4],
    "process_std": [0.02, 0.05],
    "tick": 0.01,
    "horizon": 2.0,
}
LQR = {"use": "lqr", "Q1": [1.0, 1.0], "Q2": [1.0]}
MANY = ["dkf", "open-loop", "kf-now", "kf-cloning", "ekf", "ukf"]
FAULTS = {
    "outlier_probability": [0.1],
    "resolution": [0.05],
    "noise_tail": [4],
    "stamp_offset": [0.01],
}
CASES = {
    "shared": {"scenarios": ["cart/white"], "observers": ["dkf", "pccebo", "kfbo", "pco", "pi-pco"]},
    "drift": {"scenarios": ["cart/variable-gain"]},
    "csth": {"scenarios": ["csth/10s-noise"]},
    "arm": {"scenarios": ["arm/sampled"]},
    "continuous": {"scenarios": ["arm/sine"]},
    "reactor": {"scenarios": ["reactor/batch"]},
    "helicopter": {"scenarios": ["helicopter/constant"]},
    "process noise": {"lti": LTI, "observers": MANY, **RANDOM},
    "consistency": {
        "lti": LTI,
        "observers": ["dkf"],
        "options": {"scenario": {"random_start": True, "consistency": True}},
    },
    "faults": {
        "lti": LTI,
        "observers": ["dkf"],
        "axes": FAULTS,
        "options": RANDOM["options"] | {"dkf": {"gate": 0.999}},
    },
    "random": {
        "lti": LTI,
        "observers": MANY,
        "axes": {"loss": [0.2], "delay_jitter": [0.05], "jitter": [0.02]},
        **RANDOM,
    },
    "clones": {
        "lti": LTI | {"delay": [0.5, 0.5], "sampling_period": [0.1, 0.1]},
        "observers": ["kf-cloning", "kf-larsen"],
        "axes": {"loss": [0.2], "delay_jitter": [0.05]},
        "options": {"scenario": {"random_start": True, "consistency": True}},
    },
    "stamps": {"lti": LTI, "observers": ["dkf"], "axes": {"stamp_jitter": [0.02], "loss": [0.1]}},
    "loop": {"lti": LTI, "observers": ["dkf"], "controller": LQR, **RANDOM},
    "random loop": {"lti": LTI, "observers": ["kf-now"], "controller": LQR, "axes": {"loss": [0.3]}},
    "network": {
        "lti": LTI,
        "observers": ["dkf"],
        "controller": LQR,
        "axes": {"command_loss": [0.2], "command_std": [0.1]},
    },
}


def plans(case):
    study = read.study_of({"name": "definition", "seeds": len(SEEDS)} | CASES[case], {}, [])
    return planning.plan(study)


def by_the_definition(p):
    """What the runs of a plan leave, each on a schedule of its own where sampling is random."""
    schedules = None
    if p.cell.times.random:
        each = padding.fit([planning.alone(p, 0, int(seed)) for seed in SEEDS])
        p = each[0]._replace(layout=each[0].layout._replace(ring=max(one.layout.ring for one in each)))
        schedules = jax.tree.map(lambda *a: np.stack(a), *(one.problem.schedule for one in each))
        assert isinstance(p.problem.schedule, shared.Schedule)
    runs = jax.jit(simulate_runs, static_argnums=0)
    return runs(p.layout, jax.tree.map(np.asarray, p.problem), np.asarray(0), SEEDS, schedules)


def table(p, out, label):
    effort = out.effort if isinstance(out.effort, metrics.Effort) else None
    tracking = out.tracking if isinstance(out.tracking, metrics.Stream) else None
    squares = out.consistency.get(label) if out.consistency else None
    n, dt = p.cell.times.ticks, p.cell.scenario.dt
    known = metrics.read(
        out.streams[label],
        out.watches[label],
        out.final[label],
        n,
        p.cell.times.tail,
        dt,
        True,
        tracking,
        effort,
        True,
        squares,
    )
    return {name: np.asarray(values) for name, values in known.items()}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_engine_equals_the_definition(case):
    for p in plans(case):
        with process.float64():
            job = runner.Job(p.problem, 0, SEEDS)
            made = next(runner.serial(runner.program(p.layout, job), [job]))[1]
            defined = by_the_definition(p)
        assert p.layout.observers
        for label, _ in p.layout.observers:
            quick, slow = table(p, made, label), table(p, defined, label)
            assert quick.keys() == slow.keys()
            size = np.max(slow["peak"], initial=0.0, where=np.isfinite(slow["peak"]))
            for name, value in slow.items():
                scale = size**2 if "mse" in name and "rmse" not in name else max(size, 1.0)
                np.testing.assert_allclose(quick[name], value, atol=WITHIN * scale, err_msg=f"{label} {name}")
