"""Tuning on a log finds what makes it most likely: as the book's recursion and SciPy do, and the truth within its interval."""

import json
import tomllib

import numba
import numpy as np
import pandas as pd
import pytest
import tomli_w
from logged import rows
from reference import logs as reference
from scipy.optimize import minimize
from scipy.stats import binom

import pcbench
from pcbench.cli import tuning
from pcbench.errors import UserError
from pcbench.gains import history
from pcbench.playback import likelihood
from pcbench.playback.tuning import tune_log
from pcbench.runtime.progress import Progress

DT, LATE, MANY = 0.05, 2, 401
R, Q, P0 = 0.01, 0.0025, 0.01  # of the truth
A, B = np.exp(-DT), 1 - np.exp(-DT)
CUT = int(0.7 * (MANY - 1 + LATE))  # the log ends with its last arrival
PLANT = {
    "name": "lag",
    "lti": {
        **{"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "tick": DT, "states": ["level [m]"], "input": "zero"},
        **{
            "sampling_period": DT,
            "delay": LATE * DT,
            "noise_std": 0.2,
            "process_std": [0.02],
        },  # four times and a sixth off
        **{"prior_std": [P0**0.5], "duration": 1.0},
    },
}


def recording(folder, seed, many=MANY):
    """Write a run of the lag as a log; return inputs and values at every tick."""
    u, y = run(seed, many)
    t = np.arange(many) * DT
    measured = {"channel": ["y1"] * many, "sampled": t, "arrived": t + LATE * DT, "value": y}
    rows(folder, measured, {"t": t, "u1": u})
    return u, y


def run(seed, many=MANY):
    """Inputs and values of a run of the lag at every tick."""
    random = np.random.default_rng(seed)
    u, y, x = np.sin(0.3 * np.arange(many)), np.empty(many), random.normal(0, P0**0.5)
    for k in range(many):
        y[k] = x + random.normal(0, R**0.5)
        x = A * x + B * u[k] + random.normal(0, Q**0.5)
    return u, y


def most_likely(u, y):
    """The logarithms of R and Q by the book, of all samples, and their deviations."""
    one = np.eye(1)

    def cost(z, u, y):
        nu, s = reference.kalman(
            A * one, B * one, np.exp(z[1]) * one, one, np.exp(z[0]), np.zeros(1), P0 * one, u[:, None], y
        )
        return 0.5 * np.sum(np.log(s) + nu**2 / s)

    return by_descent(cost, u, y)


def by_descent(cost, u, y):
    """The most likely z of a run, and its deviations."""
    z = minimize(cost, np.log([R, Q]), (u, y), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-11}).x
    h, e, at = 1e-3, 1e-3 * np.eye(2), lambda z: cost(z, u, y)
    H = [[(at(z + a + b) - at(z + a - b) - at(z - a + b) + at(z - a - b)) / (4 * h * h) for a in e] for b in e]
    return z, np.sqrt(np.diag(np.linalg.inv(H)))


def minus_mean(u, y, z):
    """Minus the mean log-likelihood of a number before the cut, and its slope by z: the filter with complex steps."""

    def total(log_r, log_q):
        x, p, out = 0.0, P0, 0.0
        for value, given in zip(y[: CUT - LATE], u, strict=False):
            s = p + np.exp(log_r)
            out += 0.5 * (np.log(2 * np.pi * s) + (value - x) ** 2 / s)
            x, p = A * (x + p / s * (value - x)) + B * given, A * A * (p - p * p / s) + np.exp(log_q)
        return out / (CUT - LATE)

    step = 1e-30j
    return [total(*z), total(z[0] + step, z[1]).imag / 1e-30, total(z[0], z[1] + step).imag / 1e-30]


def covers(found):
    return [i.low <= true <= i.high for i, true in zip(found.intensities, (R, Q), strict=True)]


@pytest.mark.ci
def test_the_most_likely_intensities_are_the_books_and_the_record_is_a_study(tmp_path):
    u, y = recording(tmp_path / "log", 1)
    found = pcbench.tune(PLANT, "kf", log=tmp_path / "log", out=tmp_path / "tuned")
    z, sd = most_likely(u, y)
    assert [i.name for i in found.intensities] == ["R", "Q"]
    for i, at, wide in zip(found.intensities, z, sd, strict=True):
        assert np.log(i.value) == pytest.approx(at, abs=1e-3)  # the slope is flat to 1e-6 of a number
        assert np.log([i.low, i.high]) == pytest.approx([at - 1.96 * wide, at + 1.96 * wide], abs=3e-3)
    at_start = found.points[0]
    assert [at_start.value, *at_start.slope] == pytest.approx(minus_mean(u, y, np.log([0.04, 0.0004])), rel=1e-10)
    assert all(covers(found))
    assert found.gain > 2 * found.gain_se
    assert not found.kept_start
    record = tomllib.loads((tmp_path / "tuned" / "tuned.toml").read_text())
    assert record["options"]["kf"] == found.best
    assert record["resolved"]["tuning"]["intensities"][1] == found.intensities[1]._asdict()
    first = pd.read_parquet(tmp_path / "tuned" / "history.parquet").sort_values("objective").iloc[0]
    options = {"R": float(np.exp(first["free.R"])), "Q": [float(np.exp(first["free.Q"]))]}
    (row,) = pcbench.replay(tmp_path / "log", PLANT | {"options": {"kf": options}}, "kf").innovations.to_dict("records")
    assert row["log_likelihood_held_out"] == pytest.approx(found.held_out["tuned"]["log_likelihood"], rel=1e-9)


@pytest.mark.parametrize(
    ("observer", "more", "many", "sentence"),
    [
        ("pccebo", {}, 60, "got an observer without an innovation covariance"),
        ("kf", {"only": ["walk"]}, 60, "got 'walk' to tune, expected R or q or Q"),
        ("kf", {"budget": 0}, 60, "--budget: got 0"),
    ],
)
def test_what_cannot_be_tuned_is_one_sentence(tmp_path, observer, more, many, sentence):
    recording(tmp_path / "log", 1, many)
    with pytest.raises(UserError) as caught:
        tune_log(tmp_path / "log", PLANT, observer, **more)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("many", "inputs_until", "got"),
    [
        (20, 19, "got 12 measured numbers in the part that is tuned on"),
        (60, 600, "got 0 measured numbers in the part that is held out"),
    ],
)
def test_a_part_with_too_few_samples_or_none_is_refused_before_anything_is_compiled(
    tmp_path, many, inputs_until, got, monkeypatch
):
    monkeypatch.setattr(likelihood, "evaluator", lambda *_: pytest.fail("it is compiled first"))
    recording(tmp_path / "log", 1, many)
    rows(tmp_path / "log", None, {"t": [0.0, inputs_until * DT], "u1": [0.0, 0.0]})
    with pytest.raises(UserError, match=f"{got}, expected 20 or more"):
        tune_log(tmp_path / "log", PLANT, "kf", out=tmp_path / "tuned")
    assert not (tmp_path / "tuned").exists()


@pytest.mark.ci
def test_a_tuning_that_was_stopped_goes_on_and_its_json_is_that_of_one_in_a_piece(tmp_path, monkeypatch, capsys):
    recording(tmp_path / "log", 1)
    (tmp_path / "lag.toml").write_text(tomli_w.dumps(PLANT))
    monkeypatch.setattr(history, "PAUSE", 0.0)
    looked, evaluator = [], likelihood.evaluator

    def counted(*given):
        look = evaluator(*given)
        return lambda at: (looked.append(1), look(at))[1]

    def stop_at_the_fourth(_):
        if len(looked) > 4:  # the first is asked for twice: do the samples suffice?
            raise KeyboardInterrupt

    monkeypatch.setattr(likelihood, "evaluator", counted)
    whole = tune_log(tmp_path / "log", tmp_path / "lag.toml", "kf")
    in_a_piece = len(looked)
    looked.clear()
    with pytest.raises(KeyboardInterrupt):
        tune_log(
            *(tmp_path / "log", tmp_path / "lag.toml", "kf"),
            out=tmp_path / "tuned",
            progress=Progress(lambda *_: None, stop_at_the_fourth, lambda _: None),
        )
    assert [p.name for p in (tmp_path / "tuned").iterdir()] == ["history.parquet"]
    looked.clear()
    tuning.tune(
        *(str(tmp_path / "lag.toml"), "kf"), log=str(tmp_path / "log"), folder=str(tmp_path / "tuned"), as_json=True
    )
    assert len(looked) == in_a_piece - 4
    said = json.loads(capsys.readouterr().out)
    assert said["best"] == whole.best
    assert said["intensities"] == [i._asdict() for i in whole.intensities]
    assert (said["points"], said["gain"], said["kept_start"]) == (len(whole.points), whole.gain, "")
    assert said["held_out"]["tuned"]["nis"] == whole.held_out["tuned"]["nis"]
    recording(tmp_path / "log", 2)
    with pytest.raises(UserError, match="contains another tuning"):
        tune_log(tmp_path / "log", tmp_path / "lag.toml", "kf", out=tmp_path / "tuned")


@pytest.mark.nightly
def test_of_3000_logs_the_method_by_itself_holds_the_truth_in_95_percent():
    """The book's filter alone, compiled by numba: to which the intervals of pcbench are equal."""

    @numba.njit
    def cost(log_r, log_q, u, y):
        r, q, x, p, out = np.exp(log_r), np.exp(log_q), 0.0, P0, 0.0
        for k in range(CUT - LATE):
            s = p + r
            nu, g = y[k] - x, p / s
            out += 0.5 * (np.log(s) + nu * nu / s)
            x, p = A * (x + g * nu) + B * u[k], A * A * (p - g * p) + q
        return out

    held = []
    for seed in range(5000, 8000):
        z, sd = by_descent(lambda z, u, y: cost(z[0], z[1], u, y), *run(seed))
        held.append(np.abs(z - np.log([R, Q])) <= 1.96 * sd)
    low, high = binom.ppf([0.025, 0.975], 3000, 0.95) / 3000
    share = np.mean(held, 0)
    assert np.all((low <= share) & (share <= high)), share


@pytest.mark.nightly
def test_intervals_hold_the_truth_of_95_of_100_logs(tmp_path):
    held = []
    for seed in range(100):
        recording(tmp_path / str(seed), 1000 + seed)
        held.append(covers(tune_log(tmp_path / str(seed), PLANT, "kf")))
        print(seed, np.sum(held, 0), flush=True)
    low, high = binom.ppf([0.025, 0.975], 100, 0.95)  # 90 and 99: where 95 % lies with a chance of 95 %
    counts = np.sum(held, 0)
    assert np.all((low <= counts) & (counts <= high)), counts


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"log": "log", "objective": "rmse", "validation_seeds": (0, 2)},
            "objective has no effect with log; leave objective and validation_seeds out",
        ),
        ({"delay": 0.1}, "delay has no effect without log"),
        ({"start": 0.1}, "start has no effect without log"),
    ],
)
def test_tune_refuses_arguments_of_the_other_kind(given, sentence):
    with pytest.raises(UserError, match=sentence):
        pcbench.tune("cart/white", "kf", **given)


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["ekf", "ukf"])
def test_filters_for_nonlinear_plants_are_tuned_as_kf_on_a_linear_one(tmp_path, observer):
    recording(tmp_path / "log", 1, 120)
    want, found = (tune_log(tmp_path / "log", PLANT, name) for name in ("kf", observer))
    for a, b in zip(want.intensities, found.intensities, strict=True):
        assert [b.value, b.low, b.high] == pytest.approx([a.value, a.low, a.high], rel=1e-4)


@pytest.mark.ci
def test_observer_that_draws_random_numbers_is_refused(tmp_path):
    recording(tmp_path / "log", 1, 120)
    with pytest.raises(UserError, match="draws random numbers"):
        tune_log(tmp_path / "log", PLANT, "particle")
