"""One number holds for all states or channels, and arrays, tuples, ranges and NumPy's numbers are lists and numbers."""

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.planning import all_observers
from pcbench.study import parse, scenarios_of, times
from pcbench.study.grid import cells_of
from pcbench.study.parse_scenario import SIZES

LTI = {
    "A": [[0, 1], [0, -1]],
    "B": [[0], [1]],
    "C": [[1, 0]],
    "tick": 0.01,
    "sampling_period": 0.1,
    "delay": 0.1,
    "noise_std": 0.1,
    "duration": 1.0,
}
STUDY = {"name": "p", "seeds": 8, "observers": ["kf"], "lti": LTI}
AXES = {
    "array": np.array([0.1, 0.2]),
    "linspace": np.linspace(0.1, 0.2, 2),
    "tuple": (0.1, 0.2),
    "series": pd.Series([0.1, 0.2]),
    "numpy numbers": [np.float64(0.1), np.float64(0.2)],
}


def values(study, **changes):
    """Of both readers: what a function of the package is given goes through the one that knows "all" observers."""
    grids = [reader.grid_of(study, changes, []) for reader in (parse, all_observers)]
    assert grids[0] == grids[1]
    return [cell.values["delay"] for cell in grids[0].cells]


@pytest.mark.parametrize("kind", AXES)
def test_an_axis_accepts_what_numpy_and_pandas_make(kind):
    assert values(STUDY, axes={"delay": AXES[kind]}) == [0.1, 0.2]
    assert values(STUDY | {"axes": {"delay": AXES[kind]}}) == [0.1, 0.2]


def test_an_axis_accepts_a_range_and_one_number():
    assert values(STUDY, axes={"delay": range(2)}) == [0.0, 1.0]
    assert values(STUDY, axes={"delay": np.float64(0.2)}) == [0.2]


def test_seeds_observers_and_options_accept_other_types():
    changes = {
        "seeds": np.int64(4),
        "first_seed": np.int32(2),
        "root_seed": np.uint8(3),
        "observers": np.array(["kf", "kfbo"]),
        "options": {"kfbo": {"R": np.float64(0.25)}},
    }
    study = all_observers.grid_of(STUDY, changes, []).study
    assert (study.seeds, study.first_seed, study.root_seed, study.observers) == (4, 2, 3, ["kf", "kfbo"])
    assert study.options == {"kfbo": {"R": 0.25}}
    assert all(type(n) is int for n in (study.seeds, study.first_seed, study.root_seed))
    matrices = {key: np.array(LTI[key]) for key in "ABC"}
    assert parse.grid_of(STUDY | {"lti": LTI | matrices}, {}, []).study.lti == parse.grid_of(STUDY, {}, []).study.lti


@pytest.mark.ci
def test_a_run_accepts_other_types():
    plain = pcbench.run(STUDY, seeds=2, axes={"delay": [0.1, 0.2]}).stats
    for axis in AXES.values():
        other = pcbench.run(STUDY, seeds=np.int64(2), observers=np.array(["kf"]), axes={"delay": axis}).stats
        pd.testing.assert_frame_equal(other, plain)


def test_functions_of_the_package_accept_other_types():
    costs = [pcbench.operation_counts(STUDY, observers=given) for given in (["kf", "kfbo"], ("kf", "kfbo"))]
    pd.testing.assert_frame_equal(*costs)


def test_text_is_no_number_of_seeds():
    with pytest.raises(UserError, match="seeds: got '8', expected"):
        parse.grid_of(STUDY, {"seeds": "8"}, [])


@pytest.mark.parametrize("key", SIZES)
def test_one_number_of_a_scenario_holds_for_all(key):
    base = "helicopter/constant" if "unknown" in key else "csth/10s-noise"
    many = len(scenarios_of(parse.parse({"name": "q", "scenarios": [base]}, "q"))[base].value(key))
    sizes = {"assumed_noise_std": 2, "assumed_process_std": 3, "process_std": 3, "initial_box": 3, "unknown0": 2}
    many = many or sizes[key]
    table = {"base": base}
    one, each = (
        scenarios_of(parse.parse({"name": "q", "scenario": table | {key: given}}, "q"))["q"]
        for given in (0.5, [0.5] * many)
    )
    assert one == each
    assert one.value(key) == (0.5,) * many


@pytest.mark.parametrize("key", ["x0", "xhat0", "prior_std", "settle_band", "process_std", "assumed_process_std"])
def test_one_number_of_a_linear_plant_holds_for_all(key):
    one, each = (parse.parse(STUDY | {"lti": LTI | {key: given}}, "q") for given in (0.5, [0.5, 0.5]))
    assert [c.digest for c in cells_of(one)] == [c.digest for c in cells_of(each)]


def test_a_study_of_too_many_labels_or_scenarios_is_refused_at_once():
    labels = [f"kfbo-{i}" for i in range(times.LABELS + 1)]
    options = {label: {"R": 0.1} for label in labels}
    with pytest.raises(UserError, match="q: got 1,001 observers and options of observers, expected at most 1,000"):
        parse.parse({"name": "q", "scenarios": ["cart/white"], "observers": labels, "options": options}, "q")
    tables = {f"a{i}": {"base": "cart/white"} for i in range(times.SCENARIOS + 1)}
    with pytest.raises(UserError, match="scenarios, expected at most 500; divide the study"):
        parse.parse({"name": "q", "scenarios": tables}, "q")
