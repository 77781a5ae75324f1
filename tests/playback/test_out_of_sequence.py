"""Delayed measurements that arrive after newer ones are judged on a log: by channel, and with what is left out counted.

A fast sensor at once and a precise one that is 6 ticks late, of a random walk; the reference is the joint normal density of all
measurements (dense matrices, no recursion).
"""

import numpy as np
import pytest
from logged import rows
from reference import surprise
from reference.linear import Model, Sample

import pcbench
from pcbench import planning
from pcbench.playback import innovation_tests, likelihood
from pcbench.playback.setup import open_playback

DT, TICKS, LATE = 0.01, 120, 6
R, Q, P0 = (0.01, 0.0004), 4e-4, 1.0
PLANT = {
    "name": "walk",
    "lti": {
        **{"A": [[0.0]], "B": [[0.0]], "C": [[1.0], [1.0]], "tick": DT, "states": ["level [m]"]},
        **{"sampling_period": [DT, 0.1], "delay": [0.0, LATE * DT], "noise_std": [0.1, 0.02], "process_std": [0.02]},
        **{"prior_std": [1.0], "duration": 1.0, "input": "zero"},
    },
}


def walk(seed, lost=7):
    """Samples (arrival, taken, channel, value) of a run; every `lost`-th of the fast sensor never arrives."""
    random, x, out = np.random.default_rng(seed), 0.0, []
    for k in range(TICKS + 1):
        y = x + np.sqrt(R) * random.normal(size=2)
        out += [Sample(k, k, 0, k, y[0])] if k % lost else []
        out += [Sample(k + LATE, k, 1, k // 10, y[1])] if k % 10 == 0 and k + LATE <= TICKS else []
        x += np.sqrt(Q) * random.normal()
    return sorted(out)


def recording(folder, samples):
    measured = {
        "channel": [f"y{s.channel + 1}" for s in samples],
        "sampled": [s.taken * DT for s in samples],
        "arrived": [s.arrival * DT for s in samples],
        "value": [s.value for s in samples],
    }
    return rows(folder, measured)


def whiten(samples, variances=R):
    """Each innovation over its deviation, in the order of arrival, and the log-density of all: a Cholesky factor of the joint
    covariance in that order."""
    model = Model(np.zeros((1, 1)), np.zeros((1, 1)), np.ones((2, 1)), DT)
    plant = surprise.Plant(model, np.zeros((TICKS + 2, 1)), np.array([[Q / DT]]))
    mean, S = surprise.joint(plant, samples, np.zeros(1), np.array([[P0]]), np.array(variances))
    L = np.linalg.cholesky(S)
    z = np.linalg.solve(L, np.array([s.value for s in samples]) - mean)
    return z, -0.5 * (z @ z + len(z) * np.log(2 * np.pi)) - np.log(np.diag(L)).sum()


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    folder, samples = tmp_path_factory.mktemp("log") / "walk", walk(1)
    recording(folder, samples)
    return folder, samples, pcbench.replay(folder, PLANT, ["kf", "kf-drop-delayed", "ekf-iterated"])


@pytest.mark.ci
def test_every_sample_counts_by_channel_in_the_order_of_arrival(replayed):
    _, samples, found = replayed
    z, total = whiten(samples)
    channel = np.array([s.channel for s in samples])
    whole = found.innovations.set_index("observer").loc["kf"]
    assert whole.samples == len(samples)
    assert whole.nis == pytest.approx(np.mean(z**2), rel=1e-10)
    assert whole.log_likelihood == pytest.approx(total / len(z), rel=1e-10)
    by = found.channels.set_index(["observer", "channel"])
    for i in range(2):
        row = by.loc["kf", f"y{i + 1}"]
        assert (row.samples, row.skipped) == ((channel == i).sum(), 0)
        assert row.nis == pytest.approx(np.mean(z[channel == i] ** 2), rel=1e-10)


@pytest.mark.ci
def test_what_is_not_judged_is_counted_and_named(replayed):
    _, samples, found = replayed
    late = sum(s.channel for s in samples)
    by = found.channels.set_index(["observer", "channel"])
    assert by.loc["kf-drop-delayed", "y2"][["samples", "skipped"]].tolist() == [0, late]
    assert by.loc["ekf-iterated", "y2"].skipped > 0
    said = [s for s in found.summary["notes"] if "not tested" in s]
    assert said[0] == (
        f"kf-drop-delayed reports no innovation for {late} of {len(samples)} samples, which are not tested: all of y2."
    )
    assert [s.split()[0] for s in said] == ["kf-drop-delayed", "ekf-iterated"]


@pytest.mark.nightly
def test_the_likelihood_that_is_tuned_is_the_joint_density(replayed):
    folder, samples, _ = replayed
    p, part = likelihood.load_recording(open_playback(folder, PLANT, ["kf"]))
    cell = open_playback(folder, PLANT, ["kf"]).cell
    entry, options = cell.entry("kf"), cell.options["kf"]

    def design(point):
        free = options.model_copy(update={"R": np.exp(point).tolist()})
        return planning.run_design("kf", entry, p.context, free).gains

    found = likelihood.evaluator(p, part, design)(np.log(R))
    assert len(found.tick) == len({(s.arrival, s.taken) for s in samples})
    assert found.log_likelihood.sum() == pytest.approx(whiten(samples)[1], rel=1e-10)


@pytest.mark.ci
def test_innovations_in_order_of_arrival_are_white_and_have_variance_one():
    """Of the reference, on 15 runs: what is compared with above has the distribution that NIS and whiteness assume."""
    z = np.concatenate([whiten(walk(seed))[0] for seed in range(15)])
    assert np.mean(z**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / len(z)))
    for lag in (1, 2, 6, 7):
        assert abs(np.mean(z[lag:] * z[:-lag])) < 4 / np.sqrt(len(z))
    assert innovation_tests.LAGS >= LATE
