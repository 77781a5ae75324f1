"""What a closed loop leaves: divergence as data, frozen lanes, tracking, random starts; and what it refuses."""

import numpy as np
import pytest
import runs_as_rows
from commands import call
from helicopters import estimate, plan_run, record
from scipy.stats import binomtest

import pcbench
from pcbench.cli.render import results
from pcbench.cli.render.tables import Screen
from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.planning import loop_setup, run_local
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import rng
from pcbench.study import Study

SECOND = 1.0
BOX = {"random_initial_state": True}


def swept(p, seeds=1):
    """Metrics of the only observer, by the program that sums up."""
    study = Study(name="t", scenarios=[p.cell.scenario.name], observers=list(p.labels), seeds=seeds)
    (done,) = run_local.execute(study, [p], devices=1)
    return done.results[p.labels[0]]


@pytest.fixture(scope="module")
def blown():
    """The printed observer with a set point at rest: it blows up from the nominal start."""
    return plan_run("high-gain", SECOND, choices={"path": "still"})


@pytest.mark.nightly
def test_a_diverged_run_is_frozen_and_its_time_kept(blown):
    got = record(blown)
    bad = np.flatnonzero(~(np.abs(got.x - estimate(got)) <= 1e6).all(1))
    first = bad[0]
    assert 400 < first < 460, "about 0.43 s"
    for run in (got.x[:, :4], estimate(got)):
        np.testing.assert_array_equal(run[first:], np.broadcast_to(run[first], run[first:].shape))
        assert (np.diff(run[:first], axis=0) != 0).any(1).all()
    found = swept(blown)
    assert found["diverged"].all()
    assert found["divergence_time"] == pytest.approx([first * 1e-3], rel=1e-12)
    assert np.isnan(found["mae"]).all()
    assert np.isnan(found["steady_tracking_rmse"]).all()
    assert not found["unsettled"].any(), "counted apart"


@pytest.mark.nightly
def test_sums_are_those_of_the_recorded_run():
    p = plan_run("high-gain", SECOND)
    got, found, tail = record(p), swept(p), p.cell.times.tail
    e, off = got.x - estimate(got), got.target - got.x[:, :2]
    for metric, want in (
        ("mae", np.abs(e[:-1]).mean(0)),
        ("steady_rmse", np.sqrt((e[tail:-1] ** 2).mean(0))),
        ("max_abs_error", np.abs(e[:-1]).max(0)),
        ("final_error", e[-2]),
    ):
        np.testing.assert_allclose(found[metric][:, 0], want, rtol=1e-10, atol=1e-12, err_msg=metric)
    for metric, start in (("tracking_rmse", 0), ("steady_tracking_rmse", tail)):
        want = np.sqrt((off[start:-1] ** 2).mean(0))
        np.testing.assert_allclose(found[metric][:2, 0], want, rtol=1e-10, err_msg=metric)
        assert found[metric].shape == (2, 1), "only angles have a set point"
    last = [np.flatnonzero(np.abs(e[:-1, i]) > band)[-1] + 1 for i, band in enumerate(p.problem.band)]
    np.testing.assert_allclose(found["settling_time"][:, 0], np.array(last) * 1e-3, rtol=1e-12)
    np.testing.assert_array_equal(found["unsettled"][:, 0], np.array(last) > tail)


@pytest.mark.nightly
def test_random_starts_are_those_of_the_box():
    """z(0) = x(0) + U(-0.5, 0.5), viscosities 0, x(0) as it is: one draw a run, whoever observes."""
    p = plan_run("high-gain-robust", SECOND, choices=BOX)
    runs = [record(p, seed) for seed in range(3)]
    x0 = np.array(SCENARIOS["helicopter/constant"].truth.x0)
    for seed, got in enumerate(runs):
        uniform = rng.uniforms(np.asarray(0), np.array([seed]), "initial", np.asarray(0), 1, 4)[0, :, 0]
        np.testing.assert_allclose(estimate(got)[0, :4], x0 + np.asarray(uniform) - 0.5, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(estimate(got)[0, 4:], 0)
        np.testing.assert_array_equal(got.x[0, :4], x0)
    assert len({estimate(got)[0, 0] for got in runs}) == 3
    found = swept(p, 3)
    for seed, got in enumerate(runs):
        want = np.abs((got.x - estimate(got))[:-1]).mean(0)
        np.testing.assert_allclose(found["mae"][:, seed], want, rtol=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize("observer", ["high-gain-robust", "ekf"])
def test_lanes_of_a_closed_loop_have_the_same_numbers_alone_and_in_a_block(observer):
    p = plan_run(observer, SECOND, choices=BOX, noise_std=5e-3)
    p = p._replace(layout=p.layout._replace(random_initial_state=False))

    def results(seeds, devices):
        study = Study(name="t", scenarios=[p.cell.scenario.name], observers=[observer], seeds=1)
        with config.float64():
            (done,) = run_local.execute(study, [p], np.asarray(seeds), devices)
        return done.results[observer]

    alone, full = results([7], 1), runner.HEAVY_WIDTH
    for seeds, place in ((range(20), 7), ([*range(100, 100 + full), 7], full), ([*range(100, 99 + full), 7], -1)):
        block = results(list(seeds), 1)
        for metric, values in alone.items():
            np.testing.assert_array_equal(values[..., 0], block[metric][..., place], err_msg=metric)
    two = results([3, 7], 2)  # another program, which the compiler may fuse in another way: rounding, amplified
    for metric, values in alone.items():
        np.testing.assert_allclose(values[..., 0], two[metric][..., 1], rtol=1e-11, atol=1e-13, err_msg=metric)


@pytest.mark.parametrize(("k", "n"), [(0, 256), (1, 7), (39, 256), (128, 256), (300, 300)])
def test_fractions_have_wilsons_interval(k, n):
    row = runs_as_rows.fraction(np.arange(n) < k)
    want = binomtest(k, n).proportion_ci(0.95, "wilson")
    assert (row["n"], row["mean"]) == (n, k / n)
    assert (row["ci_low"], row["ci_high"]) == pytest.approx((want.low, want.high), abs=1e-12)
    assert np.isnan(runs_as_rows.fraction(np.zeros(0, bool))["mean"])


@pytest.fixture
def short(monkeypatch):
    """The helicopter's scenarios cut to a second."""
    for name in ("helicopter/constant", "helicopter/varying"):
        monkeypatch.setitem(SCENARIOS, name, SCENARIOS[name].with_fields(duration=1.0, steady_start=0.5))


@pytest.mark.nightly
def test_tables_of_a_study_hold_status_fractions_and_tracking(short, tmp_path):
    raw = {
        "name": "loops", "scenarios": ["helicopter/constant"], "observers": ["high-gain", "high-gain-robust"], "seeds": 6,
        "options": {"scenario": {"random_initial_state": True, "path": "still"}},
    }  # fmt: skip
    before = runner.compilations()
    done = pcbench.run(raw, out=tmp_path / "out")
    assert runner.compilations() == before + 1, "labels of one observer share a program"
    runs, stats = done.runs, done.stats
    assert len(runs) == 2 * 6 * 6
    assert set(runs.status) <= {"settled", "unsettled", "diverged"}
    assert ((runs.status == "diverged") == runs.diverged).all()
    bad = runs[runs.signal == "pitch"].groupby("observer").diverged.mean()
    assert bad["high-gain"] > 0
    assert bad["high-gain-robust"] == 0
    rows = stats[stats.metric == "divergence_rate"].set_index(["observer", "signal"])
    assert rows.loc[("high-gain", "yaw"), "mean"] == bad["high-gain"]
    assert (rows.unit == "1").all()
    assert (rows.n == 6).all()
    late = stats[stats.metric == "unsettled_rate"].set_index(["observer", "signal"])
    mine = runs[(runs.observer == "high-gain-robust") & (runs.signal == "yaw_viscosity")]
    assert late.loc[("high-gain-robust", "yaw_viscosity"), "mean"] == (mine.status == "unsettled").mean()
    assert set(stats[stats.metric == "tracking_rmse"].signal) == {"pitch", "yaw"}
    assert set(done.pairs[done.pairs.metric == "tracking_rmse"].signal) == {"pitch", "yaw"}
    order = list(stats.observer.unique())
    assert order == ["high-gain", "high-gain-robust"]


@pytest.mark.nightly
def test_an_observer_that_always_diverges_is_shown_and_loses(short, capsys):
    """All runs alike: the printed observer diverges in each of them, the robust one in none."""
    raw = {
        "name": "lost",
        "scenarios": ["helicopter/constant"],
        "observers": ["high-gain", "high-gain-robust"],
        "seeds": 3,
    }
    done = pcbench.run(raw | {"options": {"scenario": {"path": "still"}}})
    assert done.stats[done.stats.observer == "high-gain"].diverged.eq(3).all()
    assert set(done.stats[done.stats.metric == "tracking_rmse"].signal) == {"pitch", "yaw"}
    pair = done.pairs[(done.pairs.signal == "pitch") & (done.pairs.metric == "mae")]
    assert (pair.n.item(), pair.prob_a_better.item()) == (0, 0.0)
    results.closing(done, Screen(width=160), "mae")
    said = capsys.readouterr().out
    assert "3 seeds" in said
    assert "100 % (43.9 .. 100)" in said


def test_a_ring_has_room_for_what_is_believed_to_be_older():
    """The filter goes back to where it believes the sample before to have been taken."""
    for error in (0.0, 0.05):
        cell = plan_run("ekf", SECOND, assumed_delay_error=error).cell
        reach = loop_setup.reach(cell, 0, 1000)
        assert reach.back >= 200 + 25 + round(error * 1e3) + 26


@pytest.mark.nightly
def test_a_filter_that_believes_samples_to_be_older_has_its_inputs():
    got = record(plan_run("ekf", SECOND, assumed_delay_error=0.05))
    assert np.isfinite(estimate(got)).all()


SAMPLES = "expected one schedule for all runs"


@pytest.mark.parametrize(
    ("study", "changes", "parts"),
    [
        ("helicopter/constant", ["axes.sampling_period=0"], ["at least one tick"]),
        ("helicopter/constant", ["axes.delay=0.0004"], ["whole number of ticks", "write 0 or 0.001"]),
        ("helicopter/constant", ["axes.actuator_delay=0.0003"], ["whole number of ticks"]),
        ("helicopter/constant", ["axes.delay=-0.01"], ["at least 0"]),
        ("helicopter/constant", ["axes.delay=30"], ["duration"]),
        ("helicopter/varying", ["axes.delay=0.01"], ["half a tick on the way", "write at least 0.016"]),
        ("helicopter/varying", ["axes.actuator_delay=0.015"], ["actuator_delay = 0.015", "write at least 0.016"]),
        ("helicopter/constant", ["axes.delay=[[0.02,0.03]]"], ["0.02, 0.03 s", "one for all channels"]),
        ("helicopter/constant", ["axes.delay=interval"], ["one interval", "expected seconds"]),
        ("helicopter/constant", ["axes.plant.Jth=-0.08"], ["-0.08", "greater than 0"]),
        ("helicopter/constant", ["axes.loss=0.1"], [SAMPLES]),
        ("helicopter/constant", ["axes.sampling_jitter=0.01"], [SAMPLES]),
        ("helicopter/constant", ["options.high-gain.theta=-4"], ["theta", "greater than 0"]),
        ("helicopter/constant", ["options.ekf.R=-1"], ["R", "greater than 0"]),
        ("helicopter/constant", ["options.scenario.path=spiral"], ["spiral", "circle"]),
        ("helicopter/constant", ["options.scenario.input=sine"], ["options.scenario.path"]),
        ("helicopter/constant", ["observers=['kf']"], ["nonlinear", "high-gain, ", " ekf, "]),
        ("cart/white", ["options.scenario.feedforward=true"], ["no controller"]),
        ("cart/white", ["observers=['high-gain']"], ["high-gain in cart/white", "use ekf"]),
    ],
    ids=lambda v: v[0] if isinstance(v, list) else v,
)  # fmt: skip
def test_what_a_loop_cannot_be_is_one_sentence(study, changes, parts, tmp_path):
    with pytest.raises(UserError) as refused:
        pcbench.run(study, overrides=changes, out=tmp_path / "out", seeds=1)
    said = str(refused.value)
    assert all(part in said for part in parts), said
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


def test_a_trace_of_a_loop_is_of_one_observer(tmp_path):
    with pytest.raises(UserError, match="one at a time"):
        pcbench.simulate("helicopter/constant", ["high-gain", "ekf"])
    done = call("simulate", "helicopter/constant", "--observer", "high-gain,ekf", "--out", str(tmp_path / "t.parquet"))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
