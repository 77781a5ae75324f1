"""A recording that states the noise of each measurement: each is used, judged and tuned with a variance of its own.

The reference is the joint normal density of all samples with those variances (dense matrices, no recursion), and the
conditional mean of the state given those that have arrived.
"""

import numpy as np
import pandas as pd
import pytest
from logged import rows
from reference import surprise
from reference.linear import Model
from test_out_of_sequence import DT, P0, PLANT, TICKS, Q, R, walk

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.export.recording import prepare_recording
from pcbench.observers import OBSERVERS
from pcbench.playback import likelihood
from pcbench.playback.setup import open_playback
from pcbench.playback.tuning import tune_log
from pcbench.recordings import readers
from pcbench.recordings.survey import survey

EXACT = ["kf", "ekf", "ukf", "ekf-iterated", "kf-reprocess", "kf-cloning"]


ALONE = PLANT | {"lti": PLANT["lti"] | {"C": [[1.0]], "sampling_period": DT, "delay": 0.0, "noise_std": [0.1]}}


def alone(samples):
    """Those of the fast sensor, which `ALONE` has by itself."""
    return [s for s in samples if s.channel == 0]


def stds(samples, seed=5):
    """Standard deviations from a fifth to five times those of the plant file, one for each sample."""
    return np.sqrt(R)[[s.channel for s in samples]] * np.exp(
        np.random.default_rng(seed).uniform(-1.6, 1.6, len(samples))
    )


def recording(folder, samples, std=None):
    measured = {
        "channel": [f"y{s.channel + 1}" for s in samples],
        "sampled": [s.taken * DT for s in samples],
        "arrived": [s.arrival * DT for s in samples],
        "value": [s.value for s in samples],
    }
    return rows(folder, measured if std is None else measured | {"std": std})


def joint(samples, variances):
    """Mean and covariance of all samples, in the order of arrival."""
    model = Model(np.zeros((1, 1)), np.zeros((1, 1)), np.ones((2, 1)), DT)
    plant = surprise.Plant(model, np.zeros((TICKS + 2, 1)), np.array([[Q / DT]]))
    mean, S = surprise.joint(plant, samples, np.zeros(1), np.array([[P0]]), np.zeros(2))
    return mean, S + np.diag(variances)


def density(samples, variances):
    """Each innovation over its deviation, in the order of arrival, and the log-density of all."""
    mean, S = joint(samples, variances)
    L = np.linalg.cholesky(S)
    z = np.linalg.solve(L, np.array([s.value for s in samples]) - mean)
    return z, -0.5 * (z @ z + len(z) * np.log(2 * np.pi)) - np.log(np.diag(L)).sum()


def estimate(samples, variances, tick):
    """The mean of the state at a tick given the samples that have arrived by then."""
    come = np.array([s.arrival <= tick for s in samples])
    mean, S = (each[np.ix_(*[come] * each.ndim)] for each in joint(samples, variances))
    across = np.array([P0 + Q * min(s.taken, tick) for s in samples])[come]
    return across @ np.linalg.solve(S, np.array([s.value for s in samples])[come] - mean)


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    samples = walk(1)
    std = stds(samples)
    folder = recording(tmp_path_factory.mktemp("log") / "walk", samples, std)
    names = [*EXACT, "kf-robust", "oosm-lag"]
    plant = PLANT | {"options": {"kf-robust": {"gate": 1e9}, "kf-reprocess": {"keep": 16}}}
    return folder, samples, std, pcbench.replay(folder, plant, names)


@pytest.mark.ci
def test_estimates_and_innovations_are_those_of_the_joint_density(replayed):
    _, samples, std, found = replayed
    z, total = density(samples, std**2)
    for name in ("kf", "ekf", "kf-reprocess", "kf-cloning", "kf-robust"):
        row = found.innovations.set_index("observer").loc[name]
        assert row.samples == len(samples), name
        assert row.nis == pytest.approx(np.mean(z**2), rel=1e-10), name
        assert row.log_likelihood == pytest.approx(total / len(z), rel=1e-10), name
    for tick in (0, 3, 17, 58, 94, 119):
        for name in (*EXACT, "kf-robust"):
            got = found.estimates[f"{name}.level"][tick]
            assert got == pytest.approx(estimate(samples, std**2, tick), rel=1e-10), (name, tick)


@pytest.mark.ci
def test_smoother_weighs_each_sample_by_its_own_variance(replayed):
    _, samples, std, found = replayed
    mean, S = joint(samples, std**2)
    left = np.linalg.solve(S, np.array([s.value for s in samples]) - mean)
    last = max(s.arrival for s in samples)
    smooth = np.array([(P0 + Q * np.minimum([s.taken for s in samples], k)) @ left for k in range(last + 1)])
    late = found.estimates.t > found.summary["steady_start"] - 1e-9  # after the transient
    off = (found.estimates["kf.level"].to_numpy() - smooth)[late]
    rms = found.distances.set_index("observer").loc["kf"].rms
    assert rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize(
    "observer", ["kf-ignore-delay", "kf-larsen", "oosm-a1", "oosm-b1", "oosm-lag", "mhe", "particle"]
)
def test_other_observers_use_the_variance_of_each_sample(observer, tmp_path):
    """Without delay they estimate what the joint density says, to what their rules leave."""
    samples = alone(walk(2))[:40]
    known = pcbench.replay(recording(tmp_path / "log", samples, stds(samples)), ALONE, ["kf", observer]).estimates
    error = np.abs(known[f"{observer}.level"] - known["kf.level"]).max()
    assert error < (0.05 if observer == "particle" else 1e-9)


@pytest.mark.ci
def test_stds_of_the_plant_file_change_no_bit(tmp_path):
    samples = walk(3)
    names = ["kf", "oosm-lag", "ekf"]
    constant = np.sqrt([0.1**2, 0.02**2])[[s.channel for s in samples]]
    plain, stated = (
        pcbench.replay(recording(tmp_path / name, samples, std), PLANT, names)
        for name, std in (("plain", None), ("stated", constant))
    )
    for name in names:
        np.testing.assert_allclose(
            stated.estimates[f"{name}.level"], plain.estimates[f"{name}.level"], rtol=0, atol=1e-13
        )
    for column in ("nis", "log_likelihood", "ljung_box_p"):
        np.testing.assert_allclose(stated.innovations[column], plain.innovations[column], rtol=1e-11)
    np.testing.assert_allclose(stated.distances.rms, plain.distances.rms, rtol=1e-10)


def test_stds_of_one_channel_leave_the_others_as_they_are(tmp_path):
    samples = walk(4)
    std = stds(samples)
    std[[s.channel == 1 for s in samples]] = np.nan
    found = pcbench.replay(recording(tmp_path / "log", samples, std), PLANT, ["kf"])
    _, total = density(samples, np.where(np.isnan(std), R[1], std**2))
    assert found.innovations.log_likelihood[0] == pytest.approx(total / len(samples), rel=1e-10)
    assert "y1: each measurement has the variance that measurements.csv states for it." in found.summary["notes"]


@pytest.mark.ci
def test_R_multiplies_what_is_stated_and_its_score_is_a_slope(tmp_path):
    """The likelihood that is tuned: R of 4 and 0.25 times the plant file's makes of all variances as many times."""
    samples = walk(1)
    std = stds(samples)
    a = open_playback(recording(tmp_path / "log", samples, std), PLANT, ["kf"])
    p, part = likelihood.load_recording(a)
    entry, options = a.cell.entry("kf"), a.cell.options["kf"]

    def design(point):
        return planning.run_design(
            "kf", entry, p.context, options.model_copy(update={"R": np.exp(point).tolist()})
        ).gains

    look, channel = likelihood.evaluator(p, part, design), np.array([s.channel for s in samples])
    at = np.log(np.array(R) * [4.0, 0.25])
    assert look(at).log_likelihood.sum() == pytest.approx(
        density(samples, std**2 * np.array([4.0, 0.25])[channel])[1], rel=1e-10
    )
    for j, step in enumerate(1e-4 * np.eye(2)):
        up, down = (density(samples, std**2 * (np.exp(at + sign * step) / R)[channel])[1] for sign in (1, -1))
        assert look(at).score.sum(0)[j] == pytest.approx((up - down) / 2e-4, rel=1e-5)


@pytest.mark.nightly
def test_tune_finds_the_factor_of_the_stated_stds(tmp_path):
    """All are stated three times too small: R is nine times that of the same log without them, and the sentence says it."""
    samples = alone(walk(6))
    stated = recording(tmp_path / "log", samples, np.full(len(samples), 0.1 / 3))
    tuned, plain = (
        tune_log(log, ALONE, "kf", only=["R"], budget=20) for log in (stated, recording(tmp_path / "plain", samples))
    )
    np.testing.assert_allclose(tuned.best["R"], 9 * np.array(plain.best["R"]), rtol=1e-3)
    (sentence,) = [s for s in tuned.notes if "multiplied" in s]
    factor = np.sqrt(np.ravel(tuned.best["R"])[0]) / 0.1
    assert sentence.endswith(f": y1 {factor:.4g}.")
    assert 2.5 < factor < 3.5


TOML = """log = "gps.csv"
[channels.y1]
field = "north"
unit = "m"
sampled = "t"
delay = 0.0
scale = -0.001
{key} = "{column}"
"""


@pytest.mark.ci
@pytest.mark.parametrize("key", ["std", "variance"])
def test_a_toml_names_the_column_of_std_or_variance(key, tmp_path):
    t, accuracy = np.arange(5) * DT, np.array([20.0, 30.0, 40.0, 10.0, 25.0])
    column = accuracy if key == "std" else accuracy**2
    pd.DataFrame({"t": t, "north": 1000.0 * t, "accuracy": column}).to_csv(tmp_path / "gps.csv", index=False)
    (tmp_path / "log.toml").write_text(TOML.format(key=key, column="accuracy"))
    log = readers.open_log(tmp_path / "log.toml")
    (batch,) = log.measurements()
    np.testing.assert_allclose(batch.std, accuracy / 1000, rtol=1e-15)
    assert survey(log).with_std() == ["y1"]


@pytest.mark.ci
@pytest.mark.parametrize("key", ["std", "variance"])
@pytest.mark.parametrize("bad", ["", "0", "-0.1", "nan", "inf"])
def test_an_std_that_is_no_number_above_0_is_one_sentence(key, bad, tmp_path):
    text = "t,north,accuracy\n0.0,1.0,0.1\n0.01,1.1," + bad + "\n0.02,1.2,0.1\n"
    (tmp_path / "gps.csv").write_text(text)
    (tmp_path / "log.toml").write_text(TOML.format(key=key, column="accuracy"))
    with pytest.raises(UserError) as caught:
        pcbench.info(tmp_path / "log.toml")
    assert str(caught.value) == (
        "log.toml: row 2 of channel y1: got a standard deviation or variance that is empty, 0, below 0 or infinite, expected "
        "a number above 0; correct or leave out that row."
    )


@pytest.mark.ci
@pytest.mark.parametrize(
    ("std", "sentence"),
    [
        (
            [0.1, np.nan, 0.1],
            "row 2 of channel y1: got no standard deviation, expected one as in other rows of that channel; ",
        ),
        ([np.nan, np.nan, 0.1], "row 1 of channel y1: got no standard deviation, "),
        (
            [0.1, 0.0, 0.1],
            "row 2 of channel y1: got a standard deviation or variance that is empty, 0, below 0 or infinite",
        ),
        (
            [0.1, 0.1, -0.1],
            "row 3 of channel y1: got a standard deviation or variance that is empty, 0, below 0 or infinite",
        ),
    ],
)
def test_a_bad_std_in_a_table_is_one_sentence(std, sentence, tmp_path):
    t = np.arange(3) * DT
    rows(tmp_path / "log", {"channel": ["y1"] * 3, "sampled": t, "arrived": t, "value": t, "std": std})
    with pytest.raises(UserError) as caught:
        pcbench.info(tmp_path / "log")
    assert f"measurements.csv: {sentence}" in str(caught.value)


def test_std_of_inputs_or_beside_variance_is_one_sentence(tmp_path):
    (tmp_path / "gps.csv").write_text("t,north,accuracy\n0.0,1.0,0.1\n")
    path = tmp_path / "log.toml"
    path.write_text(TOML.format(key="std", column="accuracy") + 'variance = "accuracy"\n')
    with pytest.raises(UserError, match=r"channels.y1: got std and variance, expected one of them; leave one out."):
        readers.open_log(path)
    inputs = '[inputs.u1]\nfield = "north"\nunit = "m"\nstd = "accuracy"\n'
    path.write_text(TOML.format(key="std", column="accuracy") + inputs)
    with pytest.raises(UserError, match=r"inputs.u1: got std, expected it of channels alone; leave it out."):
        readers.open_log(path)


@pytest.mark.ci
def test_observers_that_have_one_variance_and_correlated_noise_are_refused(replayed):
    folder = replayed[0]
    able = [name for name, entry in OBSERVERS.items() if entry.measurement_noise]
    sentence = (
        "measurements.csv on lti: got the noise of each measurement of y1, y2 and kf-alexander, expected an observer that "
        f"uses it: {', '.join(able)}; use one of these, or leave std and variance out of the recording."
    )
    with pytest.raises(UserError) as caught:
        pcbench.replay(folder, PLANT, ["kf", "kf-alexander"])
    assert str(caught.value) == sentence
    together = {"sampling_period": DT, "delay": 0.0, "noise_correlation": [[1.0, 0.5], [0.5, 1.0]]}
    with pytest.raises(UserError, match="noise that kf assumes to be correlated between outputs, expected one of them"):
        pcbench.replay(folder, PLANT | {"lti": PLANT["lti"] | together}, ["kf"])


@pytest.mark.ci
def test_c_of_a_recording_with_variances_is_refused(replayed):
    a = open_playback(replayed[0], PLANT, ["kf"])
    with pytest.raises(UserError, match="expected a recording without: the C has one variance for each channel"):
        prepare_recording(a, notifies=False)
