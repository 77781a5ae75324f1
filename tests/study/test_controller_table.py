"""The table [controller]: what it may say, for every scenario; what it may not, in one sentence, with nothing written."""

import tomllib

import numpy as np
import pytest
from documents import blocks
from loops import Q1, Q2, study

import pcbench
from pcbench.errors import UserError
from pcbench.study.parse import grid_of, stability_warnings

LQR = {"use": "lqr", "Q1": Q1, "Q2": Q2}
FEEDBACK = {"use": "state-feedback", "K": [[2.0, 1.2, 0.1], [0.3, -0.4, -0.5]]}


def refusal(raw, out, **given):
    with pytest.raises(UserError) as refused:
        pcbench.run(raw, out=out, **given)
    said = str(refused.value)
    assert "\n" not in said
    assert not out.exists()
    return said


@pytest.mark.parametrize(
    ("controller", "parts"),
    [
        (LQR | {"use": "lqg"}, ["controller.use", "'lqg'", "did you mean 'lqr'"]),
        ({"Q1": 1.0}, ["use is missing"]),
        (LQR | {"use": "pd"}, ["valid: lqr, pid, state-feedback"]),
        (LQR | {"Q1": [1, 2]}, ["controller.Q1", "flat list of 2", "3 x 3", "diagonal"]),
        (LQR | {"Q1": -1.0}, ["Q1", "least eigenvalue is -1", "semidefinite"]),
        (LQR | {"Q2": 0.0}, ["Q2", "positive definite"]),
        (LQR | {"Q1": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]}, ["symmetric"]),
        (LQR | {"K": [[1.0]]}, ["'K' is no option of lqr"]),
        (LQR | {"set_point": {"angel": 1.0}}, ["'angel' is no state", "did you mean 'angle'"]),
        (LQR | {"set_point": {"angle": {"step": 1.0, "sine": 2.0}}}, ["one of step, sine, table, not step and sine"]),
        (LQR | {"set_point": {"angle": {"sine": 1.0, "at": 2.0}}}, ["no at with sine"]),
        (LQR | {"set_point": {"angle": {"table": [[1, 2], [0, 3]]}}}, ["times that grow"]),
        (LQR | {"period": 0.013}, ["controller.period", "whole number of ticks", "write 0.01"]),
        (LQR | {"limit": [1.0, 2.0, 3.0]}, ["limit: got 3 numbers"]),
        (LQR | {"command_loss": 1.5}, ["command_loss: got 1.5"]),
        (LQR | {"command_jitter": 0.003}, ["command_jitter", "whole number of ticks"]),
        (LQR | {"actuator_dely": 1.0}, ["did you mean 'actuator_delay'"]),
        (FEEDBACK | {"K": [[1.0, 2.0, 3.0]]}, ["controller.K: got 1 rows of 3", "2 x 3 (3 states, 2 inputs"]),
        (FEEDBACK | {"Q1": 1.0}, ["got Q1 without Q2"]),
        ({"use": "pid", "Kp": [1.0]}, ["Kp: got a flat list of 1", "2 x 2"]),
    ],
    ids=lambda v: v[0] if isinstance(v, list) else "",
)
def test_what_does_not_fit_is_one_sentence(controller, parts, tmp_path):
    said = refusal(study(controller), tmp_path / "out")
    assert all(part in said for part in parts), said


def test_what_the_scenario_cannot_have_is_one_sentence(tmp_path):
    out = tmp_path / "out"
    said = refusal(study(LQR, D=[[0.0, 1.0], [0.0, 0.0]]), out)
    assert "got a plant with D" in said
    weights = {"name": "t", "scenarios": ["helicopter/constant"], "controller": LQR}
    assert "sampling began before t = 0" in refusal(weights, out)
    assert "command_loss' is no axis of cart/white" in refusal("cart/white", out, axes={"command_loss": [0.1]})
    raw = study(LQR) | {"options": {"scenario": {"feedforward": True}}}
    assert "expected pd, the only controller with this option" in refusal(raw, out)


@pytest.mark.parametrize(
    ("controller", "mode"),
    [
        (FEEDBACK | {"K": [[-2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]}, "1.0"),
        (FEEDBACK | {"actuator_delay": 0.9}, "delayed by 0.9 s"),
    ],
)
def test_a_loop_that_does_not_settle_is_told_so_by_its_eigenvalue(controller, mode):
    (sentence,) = stability_warnings(grid_of(study(controller), {}, []))
    assert "does not stabilise the plant of lti" in sentence
    assert mode in sentence
    assert stability_warnings(grid_of(study(FEEDBACK | {"actuator_delay": 0.02}), {}, [])) == []


def test_lqr_that_knows_its_delay_is_stable_however_late_and_without_knowing_it_is_not():
    for knows, many in ((True, 0), (False, 1)):
        raw = study(LQR | {"actuator_delay": 0.9, "knows_delay": knows})
        assert len(stability_warnings(grid_of(raw, {}, []))) == many


def test_the_guides_table_closes_the_loop_of_the_cart():
    (block,) = blocks("toml", "closed_loops.md")
    found = grid_of({"name": "t", "scenarios": ["cart/white"]} | tomllib.loads(block), {}, [])
    assert found.cells[0].values["command_loss"] == 0.05
    assert stability_warnings(found) == []


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ["cart/white", "csth/10s-noise", "arm/sampled"])
def test_a_published_plant_in_a_loop_of_ones_own_is_regulated(scenario):
    """Its tables have the input and the cost; the axes of commands are columns; the same study open has neither."""
    Q = {"cart/white": (10.0, 1e-3), "csth/10s-noise": ([1e4, 1e-8, 1.0], 1e-3), "arm/sampled": (1.0, 1e-2)}[scenario]
    controller = {"use": "lqr", "Q1": Q[0], "Q2": Q[1]}
    raw = {"name": "t", "scenarios": [scenario], "observers": ["kf"], "seeds": 4, "controller": controller}
    found = pcbench.run(raw)
    stats = found.stats.set_index(["metric", "signal"])
    assert np.isfinite(stats.loc["steady_lq_cost", "mean"]).all()
    assert {"command_loss", "command_jitter", "command_std"} <= set(found.runs)
    assert not found.runs.diverged.any()
    assert stats.loc["input_rms", "unit"].item() == "unit of the input"
    still = controller | {"use": "state-feedback", "K": (0 * np.ones(SHAPES[scenario])).tolist()}
    idle = pcbench.run(raw | {"controller": still}).stats.set_index(["metric", "signal"])
    assert stats.loc["lq_cost", "mean"].item() < idle.loc["lq_cost", "mean"].item()


SHAPES = {"cart/white": (1, 2), "csth/10s-noise": (2, 3), "arm/sampled": (1, 4)}


@pytest.mark.nightly
def test_a_loop_is_extended_verified_and_reported(tmp_path):
    raw = study(LQR | {"command_loss": 0.2, "period": 0.02}, {"loss": 0.1}, seeds=2) | {
        "axes": {"command_jitter": [0.0, 0.04]}
    }
    said = []
    pcbench.run(raw, out=tmp_path / "out", on_warning=said.append)
    assert not said
    done = pcbench.run(raw, out=tmp_path / "out", seeds=4)
    again = pcbench.run(raw, seeds=4)
    np.testing.assert_array_equal(done.runs.lq_cost, again.runs.lq_cost)
    assert done.runs.lq_cost.notna().sum() == 8
