"""What a run leaves: the contract's columns, whole files, readable in one line by pandas, DuckDB and Polars."""

import json
import tomllib

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest

import pcbench
from pcbench import study
from pcbench.dataset import columns
from pcbench.study import grid, parse, serialize

pytestmark = pytest.mark.usefixtures("in_a_hurry")

AXES = [
    "sampling_period",
    "delay",
    "noise_std",
    "parameter_drift",
    "sampling_pattern",
    "sampling_jitter",
    "delay_jitter",
    "loss",
    "assumed_delay_error",
    "actuator_delay",
]
RUNS = (
    "seed signal unit predicts_unknown_input mae rmse mse max_abs_error final_error settling_time recovery_time steady_mae "
    "steady_rmse steady_mse steady_max_abs_error "
    "tracking_rmse steady_tracking_rmse status diverged divergence_time"
)
STATS = (
    "signal unit predicts_unknown_input certified metric method n diverged mean se ci_low ci_high "
    + " ".join(f"{q} {q}_low {q}_high" for q in ("p05", "p25", "p50", "p75", "p95"))
    + " reason"
)
PAIRS = (
    "observer_a observer_b predicts_unknown_input_a predicts_unknown_input_b certified_a certified_b signal unit "
    "metric method n mean_diff se "
    "ci_low ci_high prob_a_better p_value p_holm"
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "deep" / "folder"
    raw = {"name": "small", "scenarios": ["cart/white", "cart/slow"], "seeds": 12, "axes": {"noise_std": [0.0, 0.5]}}
    return pcbench.run(raw, out=out)


@pytest.mark.ci
def test_runs_read_in_one_line_by_three_libraries(done):
    rows = 2 * 2 * 4 * 12 * 2  # scenarios, cells, observers, seeds, signals
    a = pd.read_parquet(done.out / "runs")
    b = duckdb.sql(f"select * from read_parquet('{done.out}/runs/**/*.parquet')").df()
    c = pl.read_parquet(done.out / "runs")
    assert len(a) == len(b) == len(c) == rows
    for frame in (a, b, c.to_pandas()):
        mean = frame.groupby(["scenario", "observer"], observed=True).mae.mean()
        assert mean[("cart/white", "kfbo")] == pytest.approx(
            a[(a.scenario == "cart/white") & (a.observer == "kfbo")].mae.mean()
        )


@pytest.mark.ci
def test_columns_are_the_contracts(done):
    assert list(done.runs.columns) == ["study", "scenario", "observer", "cell", *AXES, *RUNS.split()]
    assert list(done.stats.columns) == ["study", "scenario", "plant", "observer", "cell", *AXES, *STATS.split()]
    assert list(done.pairs.columns) == ["study", "scenario", "plant", "cell", *AXES, *PAIRS.split()]


@pytest.mark.ci
def test_every_column_says_what_it_means_and_the_schema_its_version(done):
    for path in [done.out / "stats.parquet", done.out / "pairs.parquet", next((done.out / "runs").rglob("*.parquet"))]:
        schema = pq.read_schema(path)
        assert schema.metadata[b"pcbench.schema"] == columns.SCHEMA.encode()
        assert all(field.metadata[b"meaning"] for field in schema)
        if "delay" in schema.names:
            assert schema.field("delay").metadata[b"unit"] == b"s"


def test_rows_are_sorted_and_complete(done):
    keys = done.runs[["cell", "seed", "signal"]]
    for (_, _), part in done.runs.groupby(["scenario", "observer"]):
        assert part.cell.is_monotonic_increasing
        assert len(part[["cell", "seed", "signal"]].drop_duplicates()) == 2 * 12 * 2
    assert keys.notna().all().all()


def test_stats_follow_from_runs(done):
    for (scenario, observer, cell), part in done.runs[done.runs.signal == "position"].groupby(
        ["scenario", "observer", "cell"]
    ):
        rows = done.stats.query(
            "scenario == @scenario and observer == @observer and cell == @cell and signal == 'position'"
        )
        row = rows[rows.metric == "steady_rmse"].iloc[0]
        assert row["mean"] == pytest.approx(part.steady_rmse.mean(), rel=1e-12)
        assert row["p50"] == pytest.approx(part.steady_rmse.median(), rel=1e-12)
        pooled = rows[rows.metric == "pooled_rmse"].iloc[0]
        assert pooled["mean"] == pytest.approx(np.sqrt(part.mse.mean()), rel=1e-12)


def test_in_memory_equals_on_disk(done):
    again = pcbench.run(done.study)
    pd.testing.assert_frame_equal(again.runs, done.runs)
    pd.testing.assert_frame_equal(again.stats, pd.read_parquet(done.out / "stats.parquet"))


@pytest.mark.ci
def test_a_start_that_is_not_of_the_prior_has_no_efficiency():
    study = {"name": "s", "scenarios": ["cart/white"], "observers": ["model-only"], "seeds": 4}
    found = [
        pcbench.run(study | {"options": {"scenario": o}}).stats
        for o in ({"initial_spread": 0.5}, {"random_initial_state": True})
    ]
    assert [(stats.metric == "rms_efficiency").any() for stats in found] == [False, True]


def test_efficiency_stands_only_where_there_is_a_bound(done):
    rows = done.stats[done.stats.metric == "rms_efficiency"]
    assert set(rows.noise_std) == {0.5}
    assert set(rows.signal) == {"position"}, "velocity's bound is zero for every purpose"


@pytest.mark.nightly
def test_there_is_no_bound_where_the_model_is_wrong():
    result = pcbench.run(
        "cart/white", seeds=4, observers=["kf"], axes={"plant.lam": [110.0, 122.0], "parameter_drift": [0.0, 1.0]}
    )
    assert set(result.stats.metric) >= {"mae"}
    rows = result.stats[result.stats.metric == "rms_efficiency"]
    assert rows[["plant.lam", "parameter_drift"]].to_numpy().tolist() == [[122.0, 0.0]], (
        "elsewhere the model is not the plant's"
    )


def test_velocity_compares_nothing():
    pairs = pcbench.run("cart/white", seeds=16).pairs
    rows = pairs[(pairs.signal == "velocity") & (pairs.metric == "mae")]
    assert (rows.prob_a_better == 0.5).all()
    assert rows.p_value.isna().all()


def test_every_metric_has_its_own_unit(done):
    units = done.stats[done.stats.signal == "position"].groupby("metric").unit.first()
    assert units[["mae", "settling_time", "mse", "steady_mse", "pooled_rmse", "rms_efficiency"]].tolist() == [
        "m", "s", "(m)^2", "(m)^2", "m", "1",
    ]  # fmt: skip


def hash_study(chosen):
    return serialize.digest(chosen, grid.cells_of(chosen))


def test_the_study_on_disk_can_be_run_again(done):
    again = parse.load(str(done.out / "study.toml"))
    assert hash_study(again) == hash_study(done.study)
    assert tomllib.loads((done.out / "study.toml").read_text())["resolved"]["options"]["cart/slow"]["kfbo"]["R"] == 0.3


def test_provenance_says_what_made_the_numbers(done):
    found = json.loads((done.out / "provenance.json").read_text())
    assert found["study_sha256"] == hash_study(done.study)
    assert {"versions", "device", "precision", "root_seed", "git", "wall_seconds", "compile_seconds"} <= set(found)
    assert found["precision"] == "float64"


@pytest.mark.ci
def test_a_diverged_run_is_counted_with_its_time_and_never_averaged():
    """sampled-innovation at te = d = 3 s and R = 0.004 grows past a bound of 20 m: every lane, at the same tick as a trace."""
    from pcbench import planning
    from pcbench.planning import padding, run_local
    from pcbench.scenarios import SCENARIOS
    from pcbench.study.grid import cell_of

    s = SCENARIOS["cart/slow"].with_fields(divergence_threshold=20.0)
    options = {
        "kfbo": study.options_of(
            parse.parse(
                {
                    "name": "x",
                    "scenarios": ["cart/slow"],
                    "options": {"kfbo": {"sampled-innovation": True, "R": 0.0001}},
                },
                "x",
            ),
            s,
            "kfbo",
        )
    }
    (p,) = padding.fit([planning.draft(cell_of(s), options)])
    (done,) = run_local.execute(parse.parse({"name": "x", "scenarios": ["cart/slow"], "seeds": 3}, "x"), [p])
    found = done.results["kfbo"]
    trace = pcbench.simulate(
        "cart/slow", "kfbo", overrides=["options.kfbo.sampled-innovation=true", "options.kfbo.R=0.0001"]
    )
    e = (trace["position"] - trace["kfbo.position"]).abs().to_numpy()
    first = np.flatnonzero(~(e <= 20.0))[0]
    assert found["diverged"].all()
    np.testing.assert_allclose(found["divergence_time"], trace["t"][first])
    assert np.isnan(found["mae"]).all()


def test_runs_have_the_columns_of_every_observer(tmp_path):
    """The file that is read first is of `eso`, which has no covariance."""
    wanted = {"consistency": True, "random_initial_state": True}
    study = {
        "name": "t",
        "scenarios": ["cart/white"],
        "observers": ["eso", "kf"],
        "seeds": 2,
        "options": {"scenario": wanted},
    }
    result = pcbench.run(study, out=tmp_path / "out")
    means = result.runs.groupby("observer").nees.mean()
    assert np.isnan(means["eso"])
    assert means["kf"] > 0
    assert set(result.runs_of("cart/white", ["nees"], 0).observer) == {"eso", "kf"}
