"""What is streamed equals what a whole trajectory gives: every metric, from the trace of the same run."""

import numpy as np
import pytest

import pcbench
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import metrics

pytestmark = pytest.mark.usefixtures("in_a_hurry")

SCENARIO, SEED, TAIL = "cart/gaussian-fast", 5, 3000
NAMES = ["pccebo", "kfbo", "kf", "model-only"]


@pytest.fixture(scope="module")
def trace():
    return pcbench.simulate(SCENARIO, NAMES, seed=SEED)


@pytest.fixture(scope="module")
def runs():
    frame = pcbench.run(SCENARIO, seeds=SEED + 1).runs
    return frame[frame.seed == SEED].set_index(["observer", "signal"])


@pytest.mark.ci
@pytest.mark.parametrize("signal", ["position", "velocity"])
@pytest.mark.parametrize("observer", NAMES)
def test_every_metric_equals_that_of_the_trace(trace, runs, observer, signal):
    e = (trace[signal] - trace[f"{observer}.{signal}"]).to_numpy()[:-1]  # ticks 0 .. N-1
    band = SCENARIOS[SCENARIO].scoring.settle_band[["position", "velocity"].index(signal)]
    outside = np.flatnonzero(np.abs(e) > band)
    want = {"final_error": e[-1], "settling_time": (outside[-1] + 1) * 1e-3 if len(outside) else 0.0}
    for prefix, part in (("", e), ("steady_", e[TAIL:])):
        want[prefix + "mae"] = np.abs(part).mean()
        want[prefix + "mse"] = np.square(part).mean()
        want[prefix + "rmse"] = np.sqrt(np.square(part).mean())
        want[prefix + "max_abs_error"] = np.abs(part).max()
    row = runs.loc[(observer, signal)]
    for metric, value in want.items():
        assert row[metric] == pytest.approx(value, rel=1e-11, abs=1e-13), metric
    assert not row["diverged"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 11.0])
def test_the_first_bad_tick_is_kept_whatever_made_it_bad(bad):
    watch, band = metrics.initial_settling(2), np.array([1.0, 1.0])
    for tick, e in enumerate([0.5, 9.0, bad, 0.1, bad]):
        watch = metrics.update_settling(
            watch, np.asarray(tick), np.array([0.0, e]), band, np.full(2, 10.0), np.zeros(0, int)
        )
    assert watch.first_bad == 2


def test_settling_is_the_last_exit_not_the_first_entry():
    watch, band = metrics.initial_settling(1), np.array([1.0])
    for tick, e in enumerate([3.0, 0.2, -2.0, 0.5, 0.1]):
        watch = metrics.update_settling(
            watch, np.asarray(tick), np.array([e]), band, np.full(1, 10.0), np.zeros(0, int)
        )
    assert watch.settling_tick[0] == 3


def read(e, tail, dt=0.5, band=1.0, bound=10.0, jumps=(), tracking=None):
    """The metrics of errors e [N], taken in tick by tick, one run."""
    N, watch, jumps = len(e), metrics.initial_settling(1), np.array(jumps, int)
    for tick, value in enumerate(e):
        watch = metrics.update_settling(
            watch, np.asarray(tick), np.array([value]), np.array([band]), np.array([bound]), jumps
        )

    def streams(values):
        parts = [values[:tail], values[tail : N - 1], values[N - 1 :]]
        sums = [[np.abs(p).sum(), np.square(p).sum(), np.abs(p).max(initial=0)] for p in parts]
        return metrics.ErrorSums(*(np.array(each)[:, None, None] for each in zip(*sums, strict=True)))

    watch = metrics.SettlingState(*(np.asarray(part).reshape(-1, 1) for part in watch[:2]), np.asarray(watch[2])[None])
    final, aims = np.array(e[-1:])[:, None], None if tracking is None else streams(np.array(tracking))
    out = metrics.finalize(streams(np.array(e)), watch, final, N, tail, dt, bool(len(jumps)), aims)
    return {name: values.ravel()[0] for name, values in out.items()}


@pytest.mark.parametrize(("last", "unsettled"), [(3, False), (4, True), (9, True), (None, False)])
def test_unsettled_is_who_leaves_its_band_after_the_tail_has_started(last, unsettled):
    """The tail starts at tick 4 of 10: an exit at tick 3 is before it, one at 4 in it."""
    e = [0.1 if last is None or k > last else 2.0 for k in range(10)]
    found = read(e, tail=4)
    assert found["unsettled"] == unsettled
    assert found["settling_time"] == (0.0 if last is None else (last + 1) * 0.5)


def test_a_run_is_lost_at_the_tick_at_which_it_leaves_its_bound_and_has_no_other_number():
    found = read([0.1, 0.2, 0.3, 11.0, 0.1, 0.1], tail=3)
    assert found["diverged"]
    assert found["divergence_time"] == 1.5
    assert not found["unsettled"]
    assert np.isnan([v for k, v in found.items() if k not in ("diverged", "divergence_time", "unsettled")]).all()
    kept = read([0.1, 10.0, -10.0, 0.3], tail=2)
    assert not kept["diverged"], "on its bound it is within"
    assert np.isnan(kept["divergence_time"])


def test_means_are_over_the_ticks_of_their_own_window():
    e, off = np.array([4.0, -3.0, 2.0, -1.0, 0.5, -0.25, 0.125]), np.array([1.0, 2.0, -3.0, 4.0, -5.0, 6.0, 7.0])
    found = read(e, tail=3, tracking=off)
    for prefix, part, way in (("", e, off), ("steady_", e[3:], off[3:])):
        assert found[prefix + "mae"] == pytest.approx(np.abs(part).mean())
        assert found[prefix + "mse"] == pytest.approx(np.square(part).mean())
        assert found[prefix + "rmse"] == pytest.approx(np.sqrt(np.square(part).mean()))
        assert found[prefix + "max_abs_error"] == np.abs(part).max()
        assert found[prefix + "tracking_rmse"] == pytest.approx(np.sqrt(np.square(way).mean()))
    assert found["final_error"] == 0.125


def test_recovery_is_the_longest_way_from_a_jump_to_the_last_exit_before_the_next():
    """Jumps at ticks 2 and 7: after the first the error is back after 3 ticks, after the second after 2; none before counts."""
    outside = {0, 1, 2, 4, 7, 8}
    e = [2.0 if k in outside else 0.1 for k in range(12)]
    assert read(e, tail=2, jumps=(2, 7))["recovery_time"] == 3 * 0.5
    assert read(e, tail=2, jumps=(7,))["recovery_time"] == 2 * 0.5
    assert "recovery_time" not in read(e, tail=2)


def test_the_cost_of_a_tick_counts_state_and_input_from_the_set_point():
    rng = np.random.default_rng(0)
    x, u, x_ref, u_ref = rng.normal(size=3), rng.normal(size=2), rng.normal(size=(5, 3)), rng.normal(size=(5, 2))
    Q1, Q2 = np.diag([1.0, 2.0, 3.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    zero = metrics.ControlCost(np.zeros(()), np.zeros(()))
    found = metrics.add_cost(zero, metrics.Weights(Q1, Q2, x_ref, u_ref), 4, x, u)
    e, v = x - x_ref[4], u - u_ref[4]
    assert float(found.cost) == pytest.approx(e @ Q1 @ e + v @ Q2 @ v, rel=1e-12)
    assert float(found.square) == pytest.approx(u @ u, rel=1e-12)
    none = metrics.add_cost(zero, metrics.Weights(Q1, Q2, np.zeros((0, 3)), np.zeros((0, 2))), 4, x, u)
    assert float(none.cost) == pytest.approx(x @ Q1 @ x + u @ Q2 @ u, rel=1e-12)
