"""Metrics that can be differentiated: those of the tables, with gradients that finite differences confirm."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import ODD, Case, problem, recorder

from pcbench import planning
from pcbench.engine import event_loop
from pcbench.gains import optimizers, parameters
from pcbench.gains.objective import objective_of
from pcbench.observers import OBSERVERS, entry_of
from pcbench.planning import padding
from pcbench.runtime import config
from pcbench.simulation import metrics, reverse_mode
from pcbench.study import grid, options_of, parse

SEEDS = np.arange(3, 7)
SHORT = {
    "cart/gaussian": (1.4, 0.9),
    "csth/10s-noise": (600.0, 300.0),
    "arm/sampled": (0.3, 0.2),
    "cart/variable": (0.9, 0.5),
    "flexible-joint/sampled": (0.5, 0.25),
}
CASES = {
    "cart/gaussian": ["pccebo", "kfbo"],
    "csth/10s-noise": ["chain"],
    "arm/sampled": ["smo"],
}
METRICS = jax.jit(reverse_mode.metrics, static_argnums=(0, 2, 3))
SIMULATE = jax.jit(event_loop.simulate, static_argnums=0)


@cache
def planned(scenario, observers):
    """A cell with a short horizon, as few lanes as seeds."""
    study = parse.grid_of(scenario, {"observers": list(observers)}, []).study
    cell = grid.cells(study, scenario)[0]
    horizon, tail = SHORT[scenario]
    cell = cell.with_fields(duration=horizon, steady_start=tail)
    (p,) = padding.fit([planning.draft(cell, {o: options_of(study, cell.scenario, o) for o in observers})])
    return study, p._replace(layout=p.layout._replace(width=len(SEEDS)))


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", CASES)
def test_they_are_the_metrics_of_the_tables(scenario):
    study, p = planned(scenario, tuple(CASES[scenario]))
    n, tail = p.cell.times.ticks, p.cell.times.tail
    got = METRICS(p.layout, p.problem, n, tail, study.root_seed, SEEDS)
    out = jax.tree.map(np.asarray, SIMULATE(p.layout, p.problem, study.root_seed, SEEDS))
    for label in p.labels:
        want = metrics.finalize(out.streams[label], out.watches[label], out.final[label], n, tail, 1.0)
        for name, values in got[label].items():
            np.testing.assert_allclose(values, want[name], rtol=1e-12, atol=1e-14, err_msg=f"{label} {name}")


@pytest.mark.parametrize(("ticks", "tail"), [(60, 25), pytest.param(63, 1, marks=pytest.mark.nightly), (8, 7)])
def test_they_are_sums_over_the_ticks_of_a_recorded_run(ticks, tail):
    """Whatever is left of the last chunk; every error differs from all others."""
    case = Case(ODD, 7, 12, ticks=ticks, h=0.02, noise_std=0.3, seed=4)
    layout, p = problem(case, {"model-only": {}, "pccebo": {}})
    with config.float64():
        run = recorder()(layout, p, np.asarray(0), np.asarray(case.seed))
        found = METRICS(layout._replace(width=1), p, ticks, tail, 0, np.array([case.seed]))
    for label, got in found.items():
        e = np.asarray(run.x - run.estimates[label])[:ticks]
        for prefix, part in (("", e), ("steady_", e[tail:])):
            want = {"mae": np.abs(part).mean(0), "mse": (part**2).mean(0), "max_abs_error": np.abs(part).max(0)}
            for name, values in (want | {"rmse": np.sqrt(want["mse"])}).items():
                np.testing.assert_allclose(
                    got[prefix + name][:, 0], values, rtol=1e-11, err_msg=f"{label} {prefix}{name}"
                )


SLOPES = {
    "pccebo": ("cart/gaussian", {"L": [[0.4], [0.1]]}, "steady_rmse"),
    "kfbo": ("cart/gaussian", {"R": 0.5}, "mae"),
    "lmi-sampled": ("flexible-joint/sampled", {"L": [[8.0], [-2.0], [-0.5], [-4.0]]}, "rmse"),
    "high-gain-predictor": ("flexible-joint/sampled", {"theta": 2.0}, "mae"),
    "kf": ("cart/gaussian", {"R": 0.5, "q": 0.1}, "steady_pooled_rmse"),
    "pco": ("cart/variable", {"Kp": -30.0}, "mse"),
    "pi-pco": ("cart/variable", {"Kp": -30.0, "Ki": 5.0}, "rmse"),
    "eso": ("cart/gaussian", {"pole": 0.6}, "steady_rmse"),
    "interval": ("cart/gaussian", {"pole": 0.6}, "steady_rmse"),
    "finite-time": ("cart/gaussian", {"pole": 0.5}, "mae"),
    "kf-event": ("cart/gaussian", {"R": 0.2}, "rmse"),
    "cdob": ("cart/gaussian", {"pole": 0.6}, "rmse"),
    "chain": ("csth/10s-noise", {"gain": "riccati", "q": 0.1}, "steady_mse"),
    "no-delay": ("csth/10s-noise", {"pole": 0.3}, "max_abs_error"),
    "equal-delay": ("csth/10s-noise", {"pole": 0.3, "variant": "theorem1"}, "steady_mae"),
}
IN_A_CLOSED_LOOP = {"high-gain"}


def test_every_smooth_observer_has_its_gradient_checked():
    with_options = {name for name, entry in OBSERVERS.items() if entry.smooth and parameters.tunable(entry)}
    assert with_options - IN_A_CLOSED_LOOP == set(SLOPES)


@pytest.mark.parametrize(
    "observer", ["pccebo", *(pytest.param(o, marks=pytest.mark.nightly) for o in SLOPES if o != "pccebo")]
)
def test_gradients_are_those_of_finite_differences(observer):
    scenario, given, metric = SLOPES[observer]
    study, p = planned(scenario, (observer,))
    study = parse.grid_of(scenario, {"observers": [observer], "options": {observer: given}}, []).study
    known, options = planning.context_of(p.cell), options_of(study, p.cell.scenario, observer)
    every, at = parameters.start(
        observer,
        OBSERVERS[observer],
        options,
        {},
        list(set(given) & set(parameters.tunable(OBSERVERS[observer]))),
        "test",
    )
    aim = objective_of(metric, p.cell.scenario, None, "test")

    def design(at):
        return entry_of(observer).design(known, parameters.with_values(options, every, at)).gains

    back = optimizers.value_and_gradient(p, aim, study.root_seed, SEEDS)
    mean, slopes, lost = back(design(at))
    assert not lost
    got = optimizers.chain(slopes, design, at)
    assert np.isfinite(got).all()
    assert got.any()
    for i, step in enumerate(1e-5 * np.eye(len(at))):
        ahead, behind = (back(design(at + sign * step))[0] for sign in (1, -1))
        assert got[i] == pytest.approx((ahead - behind) / 2e-5, rel=2e-6, abs=1e-9 * mean), (observer, i)


@pytest.mark.nightly
def test_memory_of_a_gradient_grows_slower_than_the_horizon():
    """Every tick kept would be 4 times as much for 4 times the ticks."""
    _, p = planned("cart/gaussian", ("pccebo",))
    whole, used = jax.tree.map(jnp.asarray, p.problem), []
    for ticks in (400, 1600):

        def loss(problem, ticks=ticks):
            found = reverse_mode.metrics(p.layout, problem, ticks, ticks // 2, 0, SEEDS)
            return found["pccebo"]["mse"].sum()

        reals = jax.value_and_grad(
            lambda L: loss(whole._replace(gains={"pccebo": whole.gains["pccebo"]._replace(L=L)}))
        )
        compiled = jax.jit(reals).lower(whole.gains["pccebo"].L).compile()
        used.append(compiled.memory_analysis().temp_size_in_bytes)
    assert used[1] < 2.5 * used[0], used
