"""The delay of a channel is found from a recording: by the profile likelihood of a reference, and within its interval."""

import json
import tomllib
from types import SimpleNamespace

import jax
import numpy as np
import pandas as pd
import pytest
import tomli_w
from delayed_stamps import DT, PRIOR, A, B, plant, recording, unknown
from logged import rows
from reference import logs as reference
from scipy.linalg import expm
from scipy.optimize import minimize
from scipy.stats import binom, chi2

import pcbench
from pcbench import plots
from pcbench.cli import tuning as commands
from pcbench.errors import UserError
from pcbench.playback import delay_profile, delay_search, likelihood, tuning
from pcbench.playback.delay_profile import Best
from pcbench.playback.setup import open_playback
from pcbench.runtime.progress import SILENT

LATE = 0.0873  # s: not a whole number of ticks


def find_delays(log, study, observer="kf", longest=None):
    """The delays of a recording, without the fit of the noise after it."""
    a = open_playback(log, study, [observer])
    return tuning._find_delays(a, None, longest, "test", SILENT)


class Quadratic:
    """A profile likelihood whose variance of innovations is quadratic in the delays [ticks], with one peak."""

    samples = 400

    def __init__(self, peak, H, low, high, dt=DT):
        self.peak, self.H, self.cache = np.array(peak), np.array(H), {}
        self.low, self.high = np.array(low), np.array(high)
        interval = SimpleNamespace(median=4 * dt, many=9)
        delays = SimpleNamespace(least=-float(min(low)) * dt, many=9)
        each = {f"y{i + 1}": SimpleNamespace(intervals=interval, delays=delays) for i in range(len(peak))}
        log = SimpleNamespace(inputs=None)
        clock = SimpleNamespace(dt=dt, start=0.0, ticks=lambda t: np.rint(t / dt))
        recording = SimpleNamespace(survey=SimpleNamespace(channels=each), clock=clock, log=log)
        self.playback, self.batches = recording, []

    def ask(self, wanted):
        for each in wanted:
            assert np.array_equal(np.clip(each, self.low, self.high), each)
            e = np.array(each) - self.peak
            self.cache[each] = Best(-0.5 * self.samples * np.log1p(e @ self.H @ e / self.samples), None)
        return [self.cache[each].value for each in wanted]

    @property
    def best(self):
        return max(self.cache, key=lambda each: self.cache[each].value)

    def half(self, c):
        """Half the width of the interval of a channel, all other delays at their best [s]."""
        N = self.samples
        return DT * np.sqrt(N * np.expm1(2 * delay_search.LEVEL / N) * np.linalg.inv(self.H)[c, c])


@pytest.mark.parametrize("curvature", [30.0, 0.3, 0.01])
def test_estimate_and_interval_are_those_of_a_quadratic_profile(curvature):
    """Intervals of a third of a tick, of four and of twenty."""
    profile = Quadratic([13.3], [[curvature]], [-40], [60])
    ((one,), said) = delay_search.find(profile)
    assert one.estimate == pytest.approx(0.133, abs=1e-9)
    assert [one.low, one.high] == pytest.approx([0.133 - profile.half(0), 0.133 + profile.half(0)], rel=1e-6)
    assert (one.at_end, one.search_range) == ("", (-0.4, 0.6))
    assert chi2(1).ppf(0.95) == pytest.approx(2 * delay_search.LEVEL)
    assert (
        said
        == (["y1: the interval of the delay is narrower than a tick of 0.01 s: it is interpolated between ticks."])[
            : curvature > 1
        ]
    )


def test_interval_of_one_delay_includes_that_others_are_unknown():
    profile = Quadratic([13.3, 6.6], [[5.0, -4.8], [-4.8, 5.2]], [0, 0], [60, 60])
    found, _ = delay_search.find(profile)
    assert [one.estimate for one in found] == pytest.approx([0.133, 0.066], abs=1e-6)
    for c, one in enumerate(found):
        assert one.high - one.low == pytest.approx(2 * profile.half(c), rel=1e-3)  # of a peak between ticks
    narrow = 2 * DT * np.sqrt(2 * delay_search.LEVEL / profile.H[0, 0])
    assert found[0].high - found[0].low > 2.5 * narrow


def test_delays_of_which_only_the_difference_is_known_are_reported_so():
    """They have one clock: a shift of both changes almost nothing."""
    profile = Quadratic([13.0, 6.0], [[5.0, -5.0], [-5.0, 5.0 + 1e-9]], [0, 0], [60, 60])
    found, said = delay_search.find(profile)
    assert found[0].estimate - found[1].estimate == pytest.approx(0.07, abs=1e-6)
    assert [(one.low, one.high) for one in found] == [(0.0, 0.6)] * 2
    assert said[-1].startswith(
        "y1 and y2: the recording determines the differences of these delays, but hardly each delay"
    )


@pytest.mark.parametrize(
    ("peak", "curvature", "end", "sentence"),
    [
        (
            80.0,
            0.01,
            "high",
            "y1: the most likely delay is the longest that was searched, 0.6 s; give a larger --max-delay.",
        ),
        (-9.0, 0.01, "low", "y1: the most likely delay is the shortest that is possible, 0 s"),
        (13.0, 1e-6, "", "y1: the recording does not determine the delay"),
    ],
)
def test_peak_at_an_end_or_no_peak_is_reported(peak, curvature, end, sentence):
    (one,), (said,) = delay_search.find(Quadratic([peak], [[curvature]], [0], [60]))
    assert one.at_end == end
    assert said.startswith(sentence)
    if end == "high":
        assert (one.estimate, one.high) == (0.6, 0.6)
    if not end:
        assert (one.low, one.high) == (0.0, 0.6)


def test_search_ends_at_the_age_of_the_youngest_sample(tmp_path):
    recording(tmp_path / "log", 1, [LATE], arrives=0.03)
    a = open_playback(tmp_path / "log", plant(), ["kf"])
    low, high = delay_search.search_range(a, None, "test")
    assert (low.tolist(), high.tolist()) == ([-3], [40])
    assert delay_search.search_range(a, 0.2, "test")[1].tolist() == [20]
    with pytest.raises(
        UserError, match=r"--max-delay: got 9 s, expected one tick of 0.01 s to a quarter of the recording"
    ):
        delay_search.search_range(a, 9.0, "test")


def innovations(columns, u, shift, z, first, last):
    """Innovations and variances of samples at ticks first .. last, taken `shift` ticks before their stamps, by the book."""
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    stamps = np.rint(np.array(columns["sampled"]) / DT).astype(int)
    u = np.concatenate([u, np.repeat(u[-1:], 20, 0)])  # held
    y = np.full(len(u), np.nan)
    for k, value in zip(stamps, columns["value"], strict=True):
        if first <= k <= last:
            y[k - shift] = value
    R, Q = np.exp(z[0]), np.diag(np.exp(z[1:]))
    C = np.array([[1.0, 0.0]])
    return reference.kalman(whole[:2, :2], whole[:2, 2:], Q, C, R, np.zeros(2), np.diag(np.square(PRIOR)), u, y)


def book(*given):
    """The log-likelihood of these samples, and how many they are."""
    nu, s = innovations(*given)
    return -0.5 * np.sum(np.log(2 * np.pi * s) + nu**2 / s), len(nu)


@pytest.fixture(scope="module")
def profiled(tmp_path_factory):
    """A recording of 6 s, and its profile."""
    folder = tmp_path_factory.mktemp("late") / "log"
    columns, u = recording(folder, 3, [LATE], lasts=6.0)
    kept = []

    class Kept(delay_profile.Profile):
        def __init__(self, *given):
            super().__init__(*given)
            kept.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(delay_profile, "Profile", Kept)
        results = find_delays(folder, plant(), longest=0.3)
    return columns, u, kept[0], results


@pytest.mark.ci
def test_likelihood_of_a_delay_is_that_of_the_book(profiled):
    columns, u, profile, _ = profiled
    for shift in (0, 5, 9, 30):
        best = profile.cache[shift,] if (shift,) in profile.cache else Best(profile.ask([(shift,)])[0], None)
        z = profile.cache[shift,].z
        value, many = book(columns, u, shift, z, 30, len(u) + 8)
        assert many == profile.samples
        assert best.value == pytest.approx(value, rel=1e-10)


@pytest.mark.ci
def test_score_and_information_are_those_of_the_books_differences(profiled):
    columns, u, profile, _ = profiled
    shift, step = 9, 1e-5
    z = profile.cache[shift,].z
    each = jax.tree.map(lambda a: np.stack([a] * profile.lanes), profile._window((shift,)))
    g, p = profile.gains, profile.setup
    found = delay_profile.jit_lanes()(
        p.layout, g.tree, g.real, g.start, g.slope, profile.problem, np.tile(z, (profile.lanes, 1)), each
    )
    there = [
        innovations(columns, u, shift, z + h, 30, len(u) + 8) for h in step * np.concatenate([np.eye(3), -np.eye(3)])
    ]
    dnu, dlog_s = (np.array([np.ravel(a - b) / (2 * step) for a, b in zip(e[:3], e[3:], strict=True)])
                   for e in ([nu for nu, _ in there], [np.log(s) for _, s in there]))  # fmt: skip
    nu, s = map(np.ravel, innovations(columns, u, shift, z, 30, len(u) + 8))
    score = -0.5 * (dlog_s * (1 - nu**2 / s) + 2 * dnu * nu / s).sum(1)
    np.testing.assert_allclose(found[1][0], score, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found[2][0], 0.5 * dlog_s @ dlog_s.T + (dnu / s) @ dnu.T, rtol=1e-5, atol=1e-6)
    assert found[3][0] == pytest.approx(np.mean(nu**2 / s), rel=1e-10)


@pytest.mark.ci
def test_profile_is_the_maximum_over_the_noise_and_its_peak_the_estimate(profiled):
    columns, u, profile, ((one,), _) = profiled
    ticks = np.arange(7, 13)
    values = []
    for shift in ticks:
        at = profile.cache[shift,]
        cost = lambda z, shift=shift: -book(columns, u, shift, np.maximum(z, -27.6), 30, len(u) + 8)[0]  # noqa: E731
        best = minimize(cost, at.z, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6, "maxiter": 4000})
        values.append(-best.fun)
        drop = profile.cache[profile.best].value - at.value
        assert at.value == pytest.approx(values[-1], abs=0.02 + 2 * delay_profile.CONVERGED_REL * drop)
    i = int(np.argmax(values))
    a, b, c = np.exp(-2 * (np.array(values[i - 1 : i + 2]) - values[i]) / profile.samples)  # a parabola through three
    peak = ticks[i] + 0.5 * (a - c) / (a - 2 * b + c)
    rounding = np.mean(np.array(columns["sampled"]) - DT * np.rint(np.array(columns["sampled"]) / DT))
    assert one.estimate == pytest.approx(peak * DT + rounding, abs=3e-4)
    assert one.low < one.estimate < one.high


@pytest.mark.ci
def test_delays_of_three_recordings_are_found_within_their_intervals(tmp_path):
    for seed in range(3):
        late, every = unknown(seed)
        recording(tmp_path / str(seed), seed, [late], [every])
        ((one,), _) = find_delays(tmp_path / str(seed), plant())
        assert one.estimate == pytest.approx(late, abs=0.01)
        assert one.low <= late <= one.high


def coverage(folder, seeds):
    """How often intervals of some recordings hold the delay, and the largest error [s]."""
    held, errors = [], []
    for seed in seeds:
        late, every = unknown(seed)
        recording(folder / str(seed), seed, [late], [every])
        ((one,), _) = find_delays(folder / str(seed), plant())
        held.append(one.low <= late <= one.high)
        errors.append(abs(one.estimate - late))
    return sum(held), max(errors)


@pytest.mark.nightly
def test_delay_is_found_to_10_ms_in_20_recordings_and_18_intervals_hold_it(tmp_path):
    held, error = coverage(tmp_path, range(10, 30))
    assert error < 0.01
    assert held >= 18


@pytest.mark.nightly
def test_intervals_hold_the_delay_in_at_least_90_of_100_recordings(tmp_path):
    """A 95 % interval falls below that with a probability of 0.011."""
    held, _ = coverage(tmp_path, range(100, 200))
    assert binom.cdf(89, 100, 0.95) == pytest.approx(0.011, abs=1e-3)
    assert held >= 90


@pytest.mark.ci
def test_two_channels_have_a_delay_each(tmp_path):
    late = [0.09, 0.02]
    recording(tmp_path / "log", 5, late, [4, 2])
    every, _ = find_delays(tmp_path / "log", plant(2, sampling_period=[0.04, 0.02], noise_std=[0.05, 0.3]))
    for one, true in zip(every, late, strict=True):
        assert one.estimate == pytest.approx(true, abs=0.01)
        assert one.low <= true <= one.high


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["ekf", pytest.param("ukf", marks=pytest.mark.slow)])
def test_filters_for_nonlinear_plants_find_the_same_delay_on_a_linear_one(tmp_path, observer):
    recording(tmp_path / "log", 6, [LATE], lasts=4.0)
    ((want,), _), ((one,), _) = (find_delays(tmp_path / "log", plant(), name, 0.15) for name in ("kf", observer))
    assert [one.estimate, one.low, one.high] == pytest.approx([want.estimate, want.low, want.high], abs=1e-4)


@pytest.mark.ci
def test_noise_of_each_measurement_is_used(tmp_path):
    columns, _ = recording(tmp_path / "log", 6, [LATE], lasts=6.0)
    std = np.full(len(columns["value"]), 0.05)  # what the plant file says
    ((want,), _) = find_delays(tmp_path / "log", plant(), longest=0.2)
    pd.DataFrame(columns | {"std": std}).to_csv(tmp_path / "log" / "measurements.csv", index=False)
    ((one,), _) = find_delays(tmp_path / "log", plant(), longest=0.2)
    assert [one.estimate, one.low, one.high] == pytest.approx([want.estimate, want.low, want.high], rel=1e-9)


@pytest.mark.ci
def test_without_inputs_a_delay_is_not_known(tmp_path):
    recording(tmp_path / "log", 7, [LATE], inputs=False)
    study = plant(B=[[0.0], [0.0]], prior_std=[3.0, 3.0])
    ((one,), said) = find_delays(tmp_path / "log", study)
    assert one.high - one.low > 0.3
    assert "the recording does not determine the delay" in said[0]


@pytest.mark.ci
def test_command_writes_the_recording_and_the_noise_that_are_most_likely(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "log", 8, [0.07], lasts=6.0)
    (tmp_path / "plant.toml").write_text(tomli_w.dumps(plant()))
    how = {"log": "log", "find_delay": True, "max_delay": 0.2, "folder": "tuned"}
    commands.tune("plant.toml", "kf", as_json=True, **how)
    said = json.loads(capsys.readouterr().out)
    one = said["delay"]["y1"]
    assert one["low"] <= 0.07 <= one["high"]
    assert one["estimate"] == pytest.approx(0.07, abs=0.01)
    written = tomllib.loads((tmp_path / "tuned" / "recording.toml").read_text())
    assert written == {"log": "../log", "channels": {"y1": {"clock_offset": -one["estimate"]}}}
    assert (tmp_path / "tuned" / "delay.png").read_bytes().startswith(b"\x89PNG")
    found = pcbench.replay("tuned/recording.toml", "tuned/tuned.toml", "kf")
    assert found.innovations.log_likelihood[0] == pytest.approx(said["log_likelihood"], rel=1e-10)
    ticks = [round(one["estimate"], 2) + shift for shift in (-0.01, 0.0, 0.01)]
    each = pcbench.replay(
        "log", "tuned/tuned.toml", "kf", out="compared", overrides=[f"axes.assumed_delay_error={ticks}"]
    )
    assert each.estimates is None
    assert each.innovations.assumed_delay_error.tolist() == pytest.approx(ticks)
    assert each.innovations.log_likelihood.idxmax() == 1
    assert each.innovations.log_likelihood[1] == pytest.approx(said["log_likelihood"], rel=1e-10)
    assert [p.name for p in (tmp_path / "compared").iterdir()] == ["replay.json"]
    (alone,) = pcbench.replay("log", "tuned/tuned.toml", "kf", overrides=[f"axes.assumed_delay_error=[{ticks[2]}]"])[
        0
    ].log_likelihood
    assert alone == each.innovations.log_likelihood[2]
    commands.tune("plant.toml", "kf", **how)
    printed = capsys.readouterr().out
    assert "time from the physical instant of a measurement to its" in printed
    assert "pcbench replay tuned/recording.toml --plant tuned/tuned.toml" in printed


@pytest.mark.parametrize(
    ("observer", "more", "sentence"),
    [
        ("kf-ignore-delay", {"find_delay": True}, "does not use the time at which a sample was taken"),
        ("kf", {"find_delay": True, "only": ["walk"]}, "got 'walk' to tune"),
        ("kf", {"max_delay": 0.2}, "--max-delay has no effect without --find-delay"),
    ],
)
def test_what_has_no_delay_to_find_is_one_sentence(tmp_path, observer, more, sentence):
    recording(tmp_path / "log", 1, [LATE], lasts=6.0)
    with pytest.raises(UserError, match=sentence):
        tuning.tune_log(tmp_path / "log", plant(), observer, **more)


def test_gains_that_are_not_affine_are_found_out():
    assert likelihood.affine_gains(lambda z: {"R": np.exp(z), "one": np.ones(3, int)}, np.zeros(2)) is not None
    assert likelihood.affine_gains(lambda z: {"R": np.sqrt(np.exp(z))}, np.zeros(2)) is None


def test_picture_needs_a_delay():
    with pytest.raises(UserError, match="expected one with find_delay"):
        plots.delay_profiles([])


@pytest.mark.ci
def test_channels_without_inputs_have_the_least_delays_of_the_right_difference(tmp_path):
    """A fast and a slow sensor of a random walk: nothing tells how late both are."""
    random, many = np.random.default_rng(2), 1501
    x = np.cumsum(0.05 * random.normal(size=many))
    k = [np.arange(many), np.arange(0, many, 4)]
    stamps = np.concatenate([k[0] * DT, k[1] * DT + 0.06])
    value = np.concatenate([x[k[0]] + 0.05 * random.normal(size=many), x[k[1]] + 0.02 * random.normal(size=len(k[1]))])
    columns = {"channel": ["y1"] * many + ["y2"] * len(k[1]), "sampled": stamps, "arrived": stamps, "value": value}
    rows(tmp_path / "log", columns)
    lti = {"A": [[0.0]], "B": [[0.0]], "C": [[1.0], [1.0]], "states": ["level [m]"], "tick": DT, "input": "zero"}
    lti |= {"sampling_period": [0.01, 0.04], "delay": 0.0, "noise_std": 0.1, "process_std": 0.1, "duration": 15.0}
    (one, two), said = find_delays(tmp_path / "log", {"name": "walk", "lti": lti}, longest=0.2)
    assert [one.estimate, two.estimate] == pytest.approx([0.0, 0.06], abs=0.01)
    assert [two.low, two.high] == pytest.approx([0.0, 0.2])
    assert said[-1].startswith("y1 and y2: the recording determines the differences of these delays")
