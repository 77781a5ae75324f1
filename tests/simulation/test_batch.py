"""Calls of one width: every seed once, every outcome with its own job, in the order in which they were given."""

import numpy as np
import pytest
from harness import ODD, Case, problem

from pcbench import planning
from pcbench.engine import runner
from pcbench.planning import run_local
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import metrics
from pcbench.simulation.types import RunSums
from pcbench.study.grid import cell_of


@pytest.mark.parametrize("many", [1, 1023, 1024, 1025, 2500])
def test_every_seed_is_in_one_job(many):
    p = planning.draft(cell_of(SCENARIOS["cart/nominal"]), {})
    jobs = list(run_local.jobs(p, 7, np.arange(100, 100 + many)))
    np.testing.assert_array_equal(np.concatenate([job.seeds for job in jobs]), np.arange(100, 100 + many))
    assert max(len(job.seeds) for job in jobs) <= p.layout.width
    assert {job.root_seed for job in jobs} == {7}


@pytest.mark.parametrize("count", [1, 2])
def test_jobs_come_back_in_order_with_what_is_theirs(count):
    """Nine jobs of one run to three, each from a start of its own: the model alone keeps how far off it starts."""
    layout, p = problem(Case(ODD, 20, 5, ticks=40, h=0.01), {"model-only": {}})
    layout, jobs = layout._replace(width=3), []
    for i in range(9):
        seeds = np.arange(i, i + 1 + i % 3)
        jobs.append(runner.Job(p._replace(x0=p.xhat0 + np.array([i, 0.0, 0.0])), 0, seeds))
    with config.float64():
        done = list(runner.run(layout, jobs, count))
    assert [job is given for (job, _), given in zip(done, jobs, strict=True)] == [True] * 9
    first = done[1][1].final["model-only"][0, 0]
    for i, (job, out) in enumerate(done):
        assert out.final["model-only"].shape == (3, len(job.seeds))
        np.testing.assert_allclose(out.final["model-only"][0], i * first, rtol=1e-12)


def outcome(size):
    """What a job would leave in which every error is `size`, over windows of 2, 1 and 1 ticks; one lane."""
    sums = [np.array([2.0, 1.0, 1.0])[:, None, None] * each for each in (size, size**2)]
    stream = metrics.ErrorSums(*sums, np.full((3, 1, 1), size))
    watch = metrics.SettlingState(np.full((1, 1), 2.0), np.full((1, 1), 3.0), np.array([-1.0]))
    return RunSums({"o": stream}, {"o": watch}, {"o": np.full((1, 1), size)})


@pytest.mark.parametrize("falls", [[], [2], [2**30]])
def test_recovery_is_a_metric_where_something_jumps_within_the_horizon(falls):
    cell = cell_of(SCENARIOS["cart/nominal"].with_fields(duration=0.004, steady_start=0.002))
    p = planning.draft(cell, {})
    p = p._replace(problem=p.problem._replace(jumps=np.array(falls, int)), labels=("mine",))
    p = p._replace(layout=p.layout._replace(observers=(("o", None),)))
    found = run_local.results(p, [(None, outcome(2.0)), (None, outcome(3.0))])["mine"]
    assert ("recovery_time" in found) == (falls == [2])
    np.testing.assert_allclose(found["mae"], [[2.0, 3.0]])
    np.testing.assert_allclose(found["steady_mse"], [[4.0, 9.0]])
    np.testing.assert_allclose(found["settling_time"], [[0.002, 0.002]])
