"""A run that is shown in time is the trace of the study's first seed in its first cell, thinned over the whole of it."""

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.plots import one_run
from pcbench.runtime import config
from pcbench.study import parse


@pytest.fixture(scope="module")
def shown():
    """Six runs beside one another, of the second value of an axis."""
    raw = {"name": "t", "scenarios": ["cart/white"], "observers": ["pccebo"], "seeds": 3, "first_seed": 6}
    made = parse.parse(raw | {"axes": {"noise_std": [0.3, 0.5], "delay": [0.1]}}, "t")
    at = ["axes.noise_std=0.5", "axes.delay=0.1"]
    with config.float64():
        traces = [pcbench.simulate("cart/white", "pccebo", seed=6 + i, overrides=at) for i in range(one_run.RUNS)]
        return one_run.frame_of(made, "cart/white", None, cell=1), traces


@pytest.mark.ci
def test_it_is_thinned_evenly_from_the_start_to_the_end(shown):
    frame, (trace, *_) = shown
    for _, mine in frame[frame.kind != "arrival"].groupby(["signal", "series", "kind"]):
        assert len(mine) <= 2 * one_run.POINTS
        t = mine.t.to_numpy()
        assert t[0] == 0
        assert t[-1] > 0.99 * trace.t.iloc[-1]
        np.testing.assert_allclose(np.diff(t), t[1], rtol=1e-9)


@pytest.mark.ci
def test_its_values_are_those_of_the_trace_and_its_band_that_of_all_runs(shown):
    frame, traces = shown
    columns = {
        ("position", "plant", "truth"): "position",
        ("velocity", "plant", "truth"): "velocity",
        ("position", "pccebo", "estimate"): "pccebo.position",
        ("velocity", "pccebo", "estimate"): "pccebo.velocity",
        ("position", "measured", "measured"): "y1",
    }
    found = dict(list(frame.groupby(["signal", "series", "kind"])))
    kinds = ("error", "low", "high", "rms", *one_run.SIZES)
    of_errors = {(s, "pccebo", kind) for s in ("position", "velocity") for kind in kinds}
    assert set(found) == set(columns) | of_errors | {("", "measured", "arrival")}
    at = np.round(found["position", "plant", "truth"].t.to_numpy() / 1e-3).astype(int)
    for key, column in columns.items():
        np.testing.assert_allclose(found[key].value, traces[0][column].to_numpy()[at], rtol=1e-12, atol=1e-12)
    errors = np.array([(t["position"] - t["pccebo.position"]).to_numpy()[at] for t in traces])
    for kind, values in (
        ("error", errors[0]),
        ("low", np.quantile(errors, 0.05, axis=0)),
        ("high", np.quantile(errors, 0.95, axis=0)),
        ("rms", np.sqrt((errors**2).mean(axis=0))),
        *(
            (f"abs_p{100 * share:02.0f}", np.quantile(abs(errors), share, axis=0))
            for share in (0.05, 0.25, 0.5, 0.75, 0.95)
        ),
    ):
        np.testing.assert_allclose(found["position", "pccebo", kind].value, values, rtol=1e-9, atol=1e-12)
    held = found["position", "measured", "measured"].set_index("t").value
    new = held.index[held.notna() & (held != held.shift())]
    np.testing.assert_array_equal(found["", "measured", "arrival"].t, new)
    assert len(new) > 20, "an arrival every 0.2 s"


@pytest.mark.ci
def test_runs_that_are_alike_have_no_band_and_a_cell_that_is_none_is_one_sentence():
    study = parse.parse({"name": "t", "scenarios": ["cart/nominal"], "observers": ["pccebo"]}, "t")
    assert set(one_run.frame_of(study, "cart/nominal", None).kind) == {
        "truth",
        "arrival",
        "estimate",
        "error",
        "measured",
    }
    with pytest.raises(UserError, match="--grid-point: got 7, expected one of 0"):
        one_run.frame_of(study, "cart/nominal", None, cell=7)


@pytest.mark.ci
def test_scenarios_shown_together_are_those_shown_alone():
    """They share a program; a run is not another's for that."""
    raw = {"name": "t", "scenarios": ["cart/slow", "cart/nominal"], "observers": ["pccebo"]}
    study = parse.parse(raw, "t")
    together = one_run.of_scenarios(study, dict.fromkeys(study.scenarios, 0), None)
    assert list(together) == ["cart/slow", "cart/nominal"]
    assert not together["cart/slow"].equals(together["cart/nominal"])
    for name, frame in together.items():
        pd.testing.assert_frame_equal(frame, one_run.frame_of(study, name, None), check_exact=True)


@pytest.mark.ci
def test_a_closed_loop_ends_where_it_diverges():
    """It is frozen there, and the figure showed a plant that stood still for the rest of the run."""
    axes = {"sampling_period": [0.8], "delay": [0.01], "noise_std": [0.0005], "parameter_drift": [0.3]}
    raw = {"name": "t", "scenarios": ["helicopter/constant"], "observers": ["high-gain"], "axes": axes}
    study = parse.parse(raw | {"options": {"scenario": {"random_initial_state": True}}}, "t")
    frame = one_run.frame_of(study, "helicopter/constant", None)
    run = frame[frame.kind.isin(["truth", "estimate", "error"])]
    counts = run.groupby(["signal", "series", "kind"]).value.count()
    rows = int(counts.iloc[0])
    assert (counts == rows).all()
    assert 1 < rows < run.groupby(["signal", "series", "kind"]).size().min()
    sizes = run[run.kind == "error"].pivot(index="t", columns="signal", values="value").abs().max(axis=1)
    assert (sizes.iloc[: rows - 1] <= 1e6).all()
    assert sizes.iloc[rows - 1] > 1e6, "the line leaves the picture"
    assert frame[frame.kind == "target"].value.notna().all()
