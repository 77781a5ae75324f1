"""The helicopter for tests: one run traced tick by tick at one compiled shape, beside the independent reference."""

from typing import Any

import jax
import numpy as np
from reference import helicopter as reference
from reference import helicopter_ekf, high_gain

from pcbench import planning
from pcbench.planning import loop_setup, padding
from pcbench.planning.padding import Plan
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import rng, trajectory
from pcbench.simulation.schedule import common_times
from pcbench.study import Choices, Study, options_of
from pcbench.study.grid import cell_of

REACH = loop_setup.Reach(1024, 256)  # room for every test's delays and periods
EARLY, SLOTS = 64, 2
TRUTH = (0.8, 0.318)
OBSERVERS = {
    "high-gain": high_gain.high_gain(),
    "high-gain-robust": high_gain.high_gain(high_gain.Tuning(robust=True)),
    "ekf": helicopter_ekf.ekf(),
}


def plan_run(observer: str, seconds: float, *, name="constant", choices=None, parameters=None, **changes: Any) -> Plan:
    """Return a scenario with its fields changed, cut to so many seconds."""
    s = SCENARIOS["helicopter/" + name].with_fields(duration=seconds, steady_start=seconds / 2)
    s = s.with_fields(
        **{k: (v,) * 2 if k in ("delay", "sampling_period", "noise_std") else v for k, v in changes.items()}
    )
    study = Study(name="t", scenarios=[s.name], seeds=1)
    cell = cell_of(s, 0, {}, parameters or {}, Choices(**(choices or {})))
    (p,) = padding.fit([planning.draft(cell, {observer: options_of(study, s, observer)})])
    law, line = loop_setup.close(cell, REACH, cell.times.ticks)
    plan = common_times.pad_early(common_times.pad_slots(p.problem.schedule, SLOTS), EARLY)
    layout = p.layout._replace(ring=EARLY, commands=REACH.back)
    return p._replace(problem=p.problem._replace(control=law, line=line, schedule=plan), layout=layout)


def record(p: Plan, seed: int = 0) -> trajectory.Recording:
    """Run one seed; arrays [N+1, ...]."""
    return jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, p.problem, np.asarray(0), np.asarray(seed)))


def estimate(got: trajectory.Recording) -> np.ndarray:
    """Return what the loop's one observer estimated, [N+1, 6]."""
    return next(iter(got.estimates.values()))


def reference_run(p: Plan, observer: Any = None, seed: int = 0) -> reference.Trace:
    """Return the reference's run of the same case, [N+1, 4], [N+1, 6], [N+1, 2]."""
    s, choices, N = p.cell.scenario, p.cell.choices, p.cell.times.ticks
    delay, (swing, pace), a = s.sampling.delay[0], s.sampling.delay_sine, s.truth.parameter_drift
    period = round(s.sampling.sampling_period[0] / s.dt)
    case = reference.Scenario(
        lambda t: np.full(np.shape(t), delay) + swing * np.sin(pace * np.asarray(t)),
        period,
        reference.circle,
        bool(choices.feedforward),
        bool(choices.predictor),
        lambda t: np.full(2, 1 + a * np.sin(2 * np.pi * t / 20)),
    )
    (label,) = p.labels
    samples = N // period + 1
    noise = s.sampling.noise_std[0] * np.asarray(rng.measurement_noise(0, seed, samples, 2)).T[:, None]
    z0 = np.concatenate([s.belief.xhat0, s.belief.unknown0 or (0.0, 0.0)])[None]
    run = reference.simulate(observer or of(label, s), N, case, np.array(s.truth.x0)[None], z0, noise)
    return reference.Trace(*(a[:, 0] for a in run))


def of(label: str, s: Any) -> Any:
    """Return the reference's observer, knowing the noise."""
    if label == "ekf":
        return helicopter_ekf.ekf(helicopter_ekf.Noise(R=s.sampling.noise_std[0] ** 2 or 1e-8))
    return OBSERVERS[label]


def gap(p: Plan, observer: Any = None) -> float:
    """Return the largest difference between a run and the reference: states, estimates, and inputs."""
    got, want = record(p), reference_run(p, observer)
    pairs = ((got.x[:, :4], want.x), (estimate(got), want.z), (got.u, want.u))
    return max(float(np.abs(a - b).max()) for a, b in pairs)
