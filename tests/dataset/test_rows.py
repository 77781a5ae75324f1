"""Rows of the tables from arrays: every number beside its own seed, signal and unit."""

import numpy as np
import pytest

import pcbench
from pcbench.dataset import columns, run_study, table_builder
from pcbench.errors import UserError
from pcbench.statistics import RUN_METRICS
from pcbench.study.axes import AXES, COMMANDS

SIGNALS = (("position", "m"), ("velocity", "m/s"), ("push", "N"))
SEEDS = np.array([7, 8, 9])
COMMON = table_builder.common_columns({"study": "t", "scenario": "s", "cell": 4}, SEEDS, SIGNALS[:2])


def results():
    """Two signals of three, three runs, the last one lost; tracking of the first signal only."""
    numbers = {m: 100.0 * i + np.arange(6.0).reshape(2, 3) for i, m in enumerate(RUN_METRICS) if m != "recovery_time"}
    numbers |= {m: numbers[m][:1] for m in ("tracking_rmse", "steady_tracking_rmse")}
    diverged = np.array([False, False, True])
    unsettled = np.array([[False, True, False], [True, False, False]])
    return numbers | {"diverged": diverged, "unsettled": unsettled, "divergence_time": np.array([np.nan, np.nan, 0.5])}


def test_a_row_is_of_one_seed_and_one_signal():
    found, given = table_builder.runs_table(COMMON, results(), True), results()
    rows = found.to_pylist()
    assert len(rows) == 6
    for k, row in enumerate(rows):
        run, signal = divmod(k, 2)
        assert (row["seed"], row["signal"], row["unit"]) == (SEEDS[run], *SIGNALS[signal])
        assert (row["study"], row["cell"], row["predicts_unknown_input"], row["diverged"]) == ("t", 4, True, run == 2)
        for metric in RUN_METRICS:
            if metric == "recovery_time" or ("tracking" in metric and signal == 1):
                assert row[metric] is None
            else:
                assert row[metric] == given[metric][signal, run], metric
    assert [row["status"] for row in rows] == ["settled", "unsettled", "unsettled", "settled", "diverged", "diverged"]
    assert [row["divergence_time"] for row in rows] == [None] * 4 + [0.5] * 2


@pytest.mark.parametrize(
    ("metric", "unit"),
    [("mae", "N m"), ("rmse", "N m"), ("steady_mse", "(N m)^2"), ("mse", "(N m)^2"), ("pooled_rmse", "N m"),
     ("settling_time", "s"), ("divergence_time", "s"), ("recovery_time", "s"), ("rms_efficiency", "1"),
     ("divergence_rate", "1"),
     ("unsettled_rate", "1"), ("final_error", "N m")],
)  # fmt: skip
def test_a_metric_has_its_unit(metric, unit):
    assert columns.unit_of(metric, "N m") == unit


def test_runs_stand_by_seed_with_their_signals_in_the_order_of_the_plant():
    runs = pcbench.run("cart/nominal", observers=["model-only"], seeds=3).runs
    assert runs.seed.tolist() == [0, 0, 1, 1, 2, 2]
    assert runs.signal.tolist() == ["position", "velocity"] * 3


@pytest.mark.parametrize(
    ("how", "sentence"),
    [({"until_se": "mae"}, "expected METRIC=VALUE"),
     ({"block_size": 0}, "--block-size: got 0"), ({"devices": 0}, "devices: got 0"),
     ({"max_seeds": 5}, "without --until-se"), ({"workers": 2}, "without --dask local")],
)  # fmt: skip
def test_how_a_study_is_run_is_checked_before_any_work(how, sentence):
    with pytest.raises(UserError, match=sentence):
        run_study.RunOptions(**how).checked()


def test_every_metric_of_runs_has_a_meaning():
    """Without one, its column would be described as a parameter of the plant."""
    assert {*RUN_METRICS} <= set(columns.MEANING)


def test_every_axis_has_a_unit_and_a_meaning():
    """An axis without one would have no column in stats and pairs."""
    assert set(columns.AXIS_UNITS) == {*AXES, *COMMANDS}
    assert {*AXES, *COMMANDS} <= set(columns.MEANING)
