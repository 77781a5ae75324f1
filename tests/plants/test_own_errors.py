"""Errors of a user's own: what tables say of them is what NumPy makes of a trace, and an own x - xhat is that of the state."""

import jax.numpy as jnp
import numpy as np
import pytest

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.external import export_draws, score
from pcbench.planning import run_local
from pcbench.plants import PLANTS
from pcbench.plots import one_run, time_series
from pcbench.report import captions
from pcbench.runtime import config
from pcbench.study import parse

TABLE = {
    "plant": "spring",
    "x0": [0.8, -0.3],
    "sampling_period": 0.05,
    "delay": 0.1,
    "noise_std": 0.02,
    "dt": 0.01,
    "duration": 2.0,
    "steady_start": 1.0,
    "settle_band": [0.05, 0.1, 0.05, 0.03, 0.02],
}
ERRORS = {
    "same [m]": lambda p, now, x, xhat: x[0] - xhat[0],
    "distance [m]": lambda p, now, x, xhat: jnp.sqrt((x[0] - xhat[0]) ** 2 + 0.25 * (x[1] - xhat[1]) ** 2),
    "work [J]": lambda p, now, x, xhat: (1 + now.t) * (x[0] ** 2 - xhat[0] ** 2) + now.u[0] * (x[1] - xhat[1]),
}
LOOP = {"use": "lqr", "Q1": [1.0, 1.0], "Q2": [1.0]}


def spring(**changes):
    given = {
        "field": lambda p, now, x: jnp.stack([x[1], -4.0 * x[0] - 0.4 * x[1] + now.u[0]]),
        "output": lambda p, now, x: x[:1],
        "states": ["position [m]", "speed [m/s]"],
        "operating_point": ([2.0, 0.0], [8.0]),
        "errors": ERRORS,
    }
    return pcbench.make_plant(**given | changes)


@pytest.fixture
def study(monkeypatch):
    """Put a plant under a name, and return how a study of it is written."""

    def put(plant=None, table=None, **study):
        monkeypatch.setitem(PLANTS, "spring", plant or spring())
        return {"name": "mine", "seeds": 3, "observers": ["kf", "ekf"], "scenario": TABLE | (table or {})} | study

    return put


def runs_of(study):
    """Metrics by observer, [signals, seeds]."""
    grid = parse.grid_of(study, {}, [])
    with config.float64():
        return {
            label: metrics
            for found in run_local.execute(grid.study, planning.plan(grid.study), np.arange(3))
            for label, metrics in found.results.items()
        }


@pytest.mark.ci
@pytest.mark.parametrize("more", [{}, {"loss": 0.3}, {"controller": "lqr", "control": {"Q1": [1.0, 1.0], "Q2": [1.0]}}])
@pytest.mark.parametrize("engine", ["steps", "definition"])
def test_metrics_are_those_of_a_trace(study, engine, more):
    """mae, rmse, largest and last of own errors, with NumPy from x, xhat and u of a trace: 1e-10."""
    observers = ["ekf"] if "controller" in more else ["kf", "ekf"]
    if "controller" not in more:
        more = more | {"input": "sine"}
    found = runs_of(study(table=more, engine=engine, observers=observers))
    n = 200
    for label in observers:
        frame = pcbench.simulate(study(table=more, observers=observers), [label], seed=1)
        t, u = frame["t"].to_numpy()[:n], frame["u1"].to_numpy()
        x = frame[["position", "speed"]].to_numpy()[:n] + np.array([2.0, 0.0])
        xhat = frame[[f"{label}.position", f"{label}.speed"]].to_numpy()[:n] + np.array([2.0, 0.0])
        # u is what was held before t: a command is made of the estimate, after the error is taken
        before = np.append(u[:1] if "controller" in more else [0.0], u[: n - 1]) + 8.0
        own = [
            x[:, 0] - xhat[:, 0],
            np.hypot(x[:, 0] - xhat[:, 0], 0.5 * (x[:, 1] - xhat[:, 1])),
            (1 + t) * (x[:, 0] ** 2 - xhat[:, 0] ** 2) + before * (x[:, 1] - xhat[:, 1]),
        ]
        for i, (name, e) in enumerate(zip(("same", "distance", "work"), own, strict=True)):
            first = (
                1 if "controller" in more else 0
            )  # a loop has had commands before t = 0, which a trace does not show
            np.testing.assert_allclose(frame[f"{label}.{name}"].to_numpy()[first:n], e[first:], rtol=0, atol=1e-10)
            e = frame[f"{label}.{name}"].to_numpy()[:n]
            want = {
                "mae": np.abs(e).mean(),
                "rmse": np.sqrt(np.square(e).mean()),
                "max_abs_error": np.abs(e).max(),
                "final_error": e[-1],
                "steady_rmse": np.sqrt(np.square(e[100:]).mean()),
                "settling_time": 0.01 * (np.flatnonzero(np.abs(e) > TABLE["settle_band"][2 + i]).max(initial=-1) + 1),
            }
            for metric, value in want.items():
                assert found[label][metric][2 + i, 1] == pytest.approx(value, rel=0, abs=1e-10), metric


def test_an_error_that_is_a_states_has_its_numbers(study):
    """x - xhat as an own error has every metric of the state, but for the rounding of the operating point."""
    found = runs_of(study())
    for label in ("kf", "ekf"):
        for metric, value in found[label].items():
            if value.shape[:1] == (5,):
                np.testing.assert_allclose(value[0], value[2], rtol=0, atol=1e-14, err_msg=metric)
        assert (found[label]["rmse"][3] > found[label]["rmse"][2]).all()


@pytest.mark.ci
def test_states_keep_their_bits(study):
    """Runs of a plant with own errors have the states' numbers of the plant without."""
    bare = runs_of(study(spring(errors=None), {"settle_band": TABLE["settle_band"][:2]}))
    found = runs_of(study())
    for label, metrics in bare.items():
        for name, value in metrics.items():
            many = len(value) if value.ndim > 1 else None
            np.testing.assert_array_equal(
                found[label][name][:many] if many else found[label][name], value, err_msg=name
            )


@pytest.mark.ci
def test_an_affine_error_is_exact_and_another_is_refused(study):
    """The exact moments of an own x - xhat are the state's; those of a distance are refused in one sentence."""
    linear = {"same [m]": ERRORS["same [m]"], "sum [m]": lambda p, now, x, xhat: x[0] - xhat[0] + 2 * (x[1] - xhat[1])}
    band = {"settle_band": TABLE["settle_band"][:4]}
    exact = pcbench.exact_moments(study(spring(errors=linear), band, observers=["kf"])).stats
    of = exact[exact.metric.isin(["mse", "steady_mse", "final_error"])].pivot(
        index="metric", columns="signal", values="mean"
    )
    np.testing.assert_allclose(of["same"], of["position"], rtol=1e-12, atol=1e-15)
    assert (of["sum"] != of["position"]).all()
    result = pcbench.exact_moments(study(observers=["kf"])).stats
    reasons = set(result.reason.dropna())
    assert len(reasons) == 1
    assert "is not affine in the noise" in reasons.pop()


@pytest.mark.ci
def test_estimates_from_elsewhere_and_a_replay_are_scored_by_them(study, tmp_path):
    """A run's own estimates, given back as a table, and its recording, replayed: the numbers that the run has."""
    mine = study(observers=["ekf"], seeds=1)
    run = pcbench.run(mine).runs
    run = run[run.observer == "ekf"].set_index("signal")
    frame = pcbench.simulate(mine, ["ekf"], log=tmp_path / "log")
    export_draws.write(parse.grid_of(mine | {"observers": ["kf"]}, {}, []), tmp_path / "out")
    table = frame[["ekf.position", "ekf.speed"]].rename(columns=lambda name: name.removeprefix("ekf."))
    table.assign(seed=0, tick=np.arange(len(table))).to_csv(tmp_path / "given.csv", index=False)
    given = score.score(tmp_path / "out", tmp_path / "given.csv", "elsewhere").runs
    given = given[given.observer == "elsewhere"].set_index("signal")
    again = pcbench.replay(tmp_path / "log", mine, ["ekf"]).metrics
    for metric in ("mae", "rmse", "max_abs_error", "settling_time"):
        np.testing.assert_allclose(given[metric], run.loc[given.index, metric], rtol=0, atol=1e-12, err_msg=metric)
        of = again[again.metric == metric].set_index("signal").value
        np.testing.assert_allclose(of, run.loc[of.index, metric], rtol=0, atol=1e-9, err_msg=metric)
    assert list(given.index) == ["position", "speed", "same", "distance", "work"]


def test_a_dataset_and_its_copy_hold_them(study, tmp_path):
    """Signals of tables, units, and comparisons of observers."""
    result = pcbench.run(study(), out=tmp_path / "out")
    pairs = result.pairs
    assert {"same", "distance", "work"} <= set(pairs.signal)
    work = result.stats[(result.stats.signal == "work") & (result.stats.metric == "rmse")]
    assert set(work.unit) == {"J"}


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({"one [m]": lambda p, now, x, xhat: x - xhat}, r"errors: number 1 is \[0.0, 0.0\] .* expected 0"),
        ({"a [m]": ERRORS["same [m]"], "b [m]": lambda p, now, x, xhat: x[0]}, r"errors: number 2 is 2.0 where x and"),
        ({"one [m]": lambda p, now, x, xhat: np.sin(x[7] + {}[0])}, r"errors: number 1 cannot be computed"),
        ({"position [m]": ERRORS["same [m]"]}, r"errors: .*position"),
    ],
)
def test_what_is_no_error_is_refused(errors, message):
    with pytest.raises(UserError, match=message):
        spring(errors=errors)


def test_errors_beside_unknown_numbers_are_refused():
    from typing import NamedTuple

    class Numbers(NamedTuple):
        k: float = 4.0

    with pytest.raises(UserError, match="got errors of your own and k, which is unknown"):
        spring(
            numbers=Numbers(),
            field=lambda p, now, x: jnp.stack([x[1], -p.k * x[0] - 0.4 * x[1] + now.u[0]]),
            unknown_parameters={"k": "1/s^2"},
        )


@pytest.mark.ci
def test_its_picture_in_time_has_the_errors_alone(study):
    """Of an own error there is neither truth nor estimate: one pair of axes, with the error of each observer."""
    result = pcbench.run(study(observers=["kf"]))
    of_state, own = (time_series.time(result, signal=signal) for signal in ("position", "distance"))
    assert [len(figure.axes) for figure in (of_state, own)] == [2, 1]
    assert "[m]" in own.axes[0].get_title(loc="left")
    run = one_run.frame_of(result.study, result.scenarios[0], result.out, 0, 0)
    text, _ = captions.time(run[run.signal == "distance"], "m", own)
    assert text.startswith("At the end: kf ")
