"""What is streamed equals what a whole trajectory gives: every metric, from the trace of the same run."""

import numpy as np
import pytest

import pcbench
from pcbench import metrics
from pcbench.scenarios import SCENARIOS

SCENARIO, SEED, TAIL = "cart/gaussian-fast", 5, 3000
NAMES = ["pccebo", "kfbo", "dkf", "open-loop"]


@pytest.fixture(scope="module")
def trace():
    return pcbench.trace(SCENARIO, NAMES, seed=SEED)


@pytest.fixture(scope="module")
def runs():
    frame = pcbench.run(SCENARIO, seeds=SEED + 1).runs
    return frame[frame.seed == SEED].set_index(["observer", "signal"])


@pytest.mark.parametrize("signal", ["position", "velocity"])
@pytest.mark.parametrize("observer", NAMES)
def test_every_metric_equals_that_of_the_trace(trace, runs, observer, signal):
    e = (trace[signal] - trace[f"{observer}.{signal}"]).to_numpy()[:-1]  # ticks 0 .. N-1
    band = SCENARIOS[SCENARIO].settle_band[["position", "velocity"].index(signal)]
    outside = np.flatnonzero(np.abs(e) > band)
    want = {"final": e[-1], "settling_time": (outside[-1] + 1) * 1e-3 if len(outside) else 0.0}
    for prefix, part in (("", e), ("tail_", e[TAIL:])):
        want[prefix + "mae"] = np.abs(part).mean()
        want[prefix + "mse"] = np.square(part).mean()
        want[prefix + "rmse"] = np.sqrt(np.square(part).mean())
        want[prefix + "peak"] = np.abs(part).max()
    row = runs.loc[(observer, signal)]
    for metric, value in want.items():
        assert row[metric] == pytest.approx(value, rel=1e-11, abs=1e-13), metric
    assert not row["diverged"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 11.0])
def test_the_first_bad_tick_is_kept_whatever_made_it_bad(bad):
    watch, band = metrics.start_watch(2), np.array([1.0, 1.0])
    for tick, e in enumerate([0.5, 9.0, bad, 0.1, bad]):
        watch = metrics.look(watch, np.asarray(tick), np.array([0.0, e]), band, np.full(2, 10.0), np.zeros(0, int))
    assert watch.first_bad == 2


def test_settling_is_the_last_exit_not_the_first_entry():
    watch, band = metrics.start_watch(1), np.array([1.0])
    for tick, e in enumerate([3.0, 0.2, -2.0, 0.5, 0.1]):
        watch = metrics.look(watch, np.asarray(tick), np.array([e]), band, np.full(1, 10.0), np.zeros(0, int))
    assert watch.unsettled[0] == 3
