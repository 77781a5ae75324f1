"""One compilation for a whole axis of periods, delays, noises and drifts; lanes minor in the loop, nothing transposed."""

import re

import hurried
import numpy as np
import pytest

from pcbench import planning
from pcbench.engine import runner
from pcbench.planning import run_local
from pcbench.study import parse

AXES = {
    "sampling_period": [0.1, 0.25],
    "delay": [0.0, 0.2, 0.7],
    "noise_std": [0.0, 0.5],
    "parameter_drift": [0.0, 1.0],
}


def plan(few=(), **axes):
    raw = {"name": "axes", "scenarios": ["cart/white"], "axes": axes, "seeds": 3}
    raw |= {"observers": list(few)} if few else {}
    chosen = parse.parse(raw, "axes")
    return chosen, planning.plan(chosen)


@pytest.mark.ci
def test_one_compilation_for_every_period_delay_noise_and_drift():
    with hurried.programs():
        chosen, cells = plan(["kfbo", "kf"], **AXES)
        done = list(run_local.execute(chosen, cells))
        assert runner.compilations() == 1
    assert len(done) == 24
    mae = [d.results["kfbo"]["mae"][0, 0] for d in done]
    assert len(set(mae)) == 24, "every cell has its own numbers"


def test_gains_are_traced():
    """Other weights, the same program."""
    counts = []
    raw = {"name": "gains", "scenarios": ["cart/white"], "observers": ["kfbo"], "seeds": 2}
    with hurried.programs():
        for R in (0.1, 3.0):
            chosen = parse.parse(raw | {"options": {"kfbo": {"R": R}}}, "gains")
            list(run_local.execute(chosen, planning.plan(chosen)))
            counts.append(runner.compilations())
    assert counts[0] == counts[1]


@pytest.fixture(
    scope="module", params=[False, pytest.param(True, marks=pytest.mark.nightly)], ids=["fixed start", "random start"]
)
def loops(request):
    """The text of every computation that the compiled loops run."""
    _, (cell,) = plan()
    layout = cell.layout._replace(random_initial_state=request.param, width=runner.WIDTH)
    made = runner.program(layout, runner.Job(cell.problem, 0, np.arange(2)))
    text = made.call.as_text()
    bodies = set(re.findall(r"body=%?([\w.]+)", text))
    blocks = re.split(r"\n(?=%|ENTRY)", text)
    return [b for b in blocks if b.lstrip("%").split(" ", 1)[0] in bodies and wide(b)]


def wide(body):
    """(dimensions, layout) of every array of floats that holds lanes."""
    shapes = re.findall(r"f64\[([\d,]+)\]\{([\d,]+)\}", body)
    return [(d.split(","), order.split(",")) for d, order in shapes if str(runner.WIDTH) in d.split(",")]


@pytest.mark.ci
def test_the_loop_carries_lanes_minor(loops):
    assert len(loops) >= 3, "windows, segments, ticks"
    for body in loops:
        for dims, order in wide(body):
            assert dims[-1] == str(runner.WIDTH), f"lanes are not the last axis of {dims}"
            assert order[0] == str(len(dims) - 1), f"lanes are not minor in {dims} {order}"


@pytest.mark.ci
def test_the_loop_transposes_nothing(loops):
    for body in loops:
        assert not re.search(rf"f64\[[\d,]*{runner.WIDTH}[\d,]*\]\S* transpose\(", body)


def test_lanes_differ_only_where_they_must():
    """With a fixed start the plant, and what only the input drives, is computed once for all lanes."""
    import jax
    import jax.numpy as jnp

    from pcbench.engine import initial_state, lane_array

    _, (cell,) = plan()
    layout = cell.layout._replace(width=4)
    state = jax.eval_shape(
        lambda p: initial_state.initial_lanes(layout, p, jnp.asarray(0), jnp.arange(4)), cell.problem
    )
    assert not lane_array.is_lanes(state.x)
    assert not lane_array.is_lanes(state.memories["pccebo"].g)
    assert not lane_array.is_lanes(state.memories["model-only"])
    assert lane_array.is_lanes(state.memories["pccebo"].xhat)
    assert lane_array.is_lanes(state.memories["kfbo"].z)
