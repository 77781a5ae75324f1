"""The run that an exported observer is tested on has the measurements of the simulation, with the errors of its sensors."""

import numpy as np
import pytest

import pcbench
from pcbench.export import structs
from pcbench.planning import alone, drafts, padding
from pcbench.runtime import config
from pcbench.study import parse

SCENARIO = {"base": "cart/white", "duration": 3.0, "steady_start": 1.0, "delay_jitter": 0.3}
ERRORS = {
    "none": {},
    "rounding": {"quantization_step": [0.5], "dither": [1]},
    "outliers": {"outlier_probability": [0.3]},
    "send on delta": {"send_threshold": [2.0]},
}


@pytest.mark.parametrize("name", ERRORS)
def test_what_arrives_is_what_the_simulation_has(name):
    study = {"name": "seen", "scenario": SCENARIO, "observers": ["kf"], "seeds": 1, "axes": ERRORS[name]}
    with config.float64():
        (cell,) = parse.grid_of(study, {}, []).cells
        (p,) = (alone(each, 0, 0) for each in padding.fit(list(drafts([cell]))))
        run = structs.recorded_run(p, 0, 0, 1)
    held = np.full(len(run.inputs), np.nan)
    for event in run.events:
        if event.what == structs.JUMP:
            held[event.tick :] = event.value[0]
            assert event.mask.all()
    expected = pcbench.simulate(study, "kf", seed=0).y1
    np.testing.assert_allclose(held[: len(expected)], expected, rtol=0, atol=1e-12)
