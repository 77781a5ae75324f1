"""Metrics that can be differentiated: those of the tables, with gradients that finite differences confirm."""

import jax
import numpy as np
import pytest

from pcbench import bench, differentiable, metrics, planning, simulation

SEEDS = np.arange(3, 7)
CASES = {
    "cart/gaussian": (["pccebo", "kfbo", "dkf"], {}),
    "csth/10s-noise": (["chain", "no-delay", "equal-delay"], {"delay": [[20.0, 50.0, 70.0]]}),
    "arm/sampled": (["smo", "pio"], {"sampling_period": [0.02], "delay": [0.02]}),
}

METRICS = jax.jit(differentiable.metrics, static_argnums=(0, 2, 3))
SIMULATE = jax.jit(simulation.simulate, static_argnums=0)


def planned(scenario, observers, axes):
    study = bench.study_of(scenario, {"observers": observers, "axes": axes or None}, [])
    (p,) = planning.plan(study)
    return study, p


def cut(p, ticks, tail):
    """The same cell with a short horizon: its schedule and inputs hold for any end."""
    edges = np.array([[0, tail], [tail, ticks - 1], [ticks - 1, ticks]])
    return p._replace(problem=p.problem._replace(windows=edges), layout=p.layout._replace(width=len(SEEDS)))


@pytest.mark.parametrize("scenario", CASES)
def test_they_are_the_metrics_of_the_tables(scenario):
    study, p = planned(scenario, *CASES[scenario])
    n, tail = 700, 450
    p = cut(p, n, tail)
    got = METRICS(p.layout, p.problem, n, tail, study.root_seed, SEEDS)
    out = jax.tree.map(np.asarray, SIMULATE(p.layout, p.problem, study.root_seed, SEEDS))
    for label in p.labels:
        want = metrics.read(out.streams[label], out.watches[label], out.final[label], n, tail, 1.0)
        for name, values in got[label].items():
            np.testing.assert_allclose(values, want[name], rtol=1e-12, atol=1e-14, err_msg=f"{label} {name}")
