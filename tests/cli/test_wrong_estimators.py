"""Estimators and faults that cannot be, from the command line: exit 2, one sentence, nothing written."""

import pytest
from commands import call

UNKNOWN, BATCH = "cart/unknown-delay", "reactor/batch"
WRONG = [
    (UNKNOWN, "mmae-delay", "options.mmae-delay.delay=-0.1", "delay: got -0.1, expected greater than or equal to 0"),
    (UNKNOWN, "mmae-delay", "options.mmae-delay.delay_std=nan", "delay_std: got nan, expected a finite number"),
    (UNKNOWN, "mmae-delay", "options.mmae-delay.delays=[0.1,-0.2]", "got -0.2 to 0.1 s, expected 0 to the longest"),
    (UNKNOWN, "mmae-delay", "options.mmae-delay.delays=[0.1,inf]", "delays: got inf"),
    (UNKNOWN, "ekf-delay", "options.ekf-delay.longest=20", "longest delay of 20 s, expected a tick, 0.01 s, to 10 s"),
    (UNKNOWN, "ekf-delay", "options.ekf-delay.delay_walk=-1", "delay_walk: got -1"),
    (UNKNOWN, "ekf-delay", "options.ekf-delay.stamps=1", "stamps: got 1, expected a valid boolean"),
    (
        "csth/10s-noise",
        "mmae-delay",
        "options.mmae-delay.stamps=false",
        "got stamps = false with delays of 20, 50, 70 s",
    ),
    (
        BATCH,
        "mhe",
        "options.mhe.window=302",
        "a window of 302 samples, longer than the duration, in which 301 are taken",
    ),
    (BATCH, "mhe", "options.mhe.window=0", "window: got 0"),
    (BATCH, "mhe", "options.mhe.iterations=-2", "iterations: got -2"),
    (BATCH, "mhe", "options.mhe.lower=[0.0,5.0]", "got bounds that leave out xhat0 = [0.1, 4.5]"),
    (BATCH, "mhe", "options.mhe.upper=nan", "upper: got nan"),
    (BATCH, "particle", "options.particle.particles=100000000000", "particles, which take"),
    (BATCH, "particle", "options.particle.particles=0", "particles: got 0"),
    (BATCH, "particle", "options.particle.resample=2", "resample: got 2"),
    (BATCH, "ukf", "options.ukf.alpha=-1", "alpha: got -1"),
    (BATCH, "ekf-iterated", "options.ekf-iterated.iterations=0", "iterations: got 0"),
    (BATCH, "ekf", "options.ekf.Q=[-1,1]", "Q[0]: got -1"),
    (BATCH, "ekf", "options.ekf.R=nan", "R: got nan"),
    ("cart/white", "kf", "options.kf.gate=-1", "gate: got -1"),
    ("cart/white", "kf", "options.kf.huber=nan", "huber: got nan"),
    ("cart/white", "kf", "options.kf.gate_opens=0", "gate_opens: got 0"),
    ("cart/white", "kf-drop-delayed", "options.kf-drop-delayed.max_age=-1", "max_age: got -1"),
    (
        "cart/white",
        "kf-delayed-horizon",
        "options.kf-delayed-horizon.lag=99",
        "a lag of 99 s, expected at most the run's 10 s",
    ),
    ("cart/white", "kf-reprocess", "options.kf-reprocess.keep=inf", "keep: got inf"),
    ("cart/white", "kf-alexander", "axes.assumed_delay_error=[0.01]", "assumed_delay_error of 0.01 s, expected 0"),
    (
        "cart/white",
        "kf-cloning",
        "axes.timestamp_offset=[-0.01]",
        "got timestamp_offset, expected correct timestamps",
    ),
    ("cart/white", "kfbo", "axes.clock_skew=[5000.0]", "got clock_skew, expected one constant delay"),
    ("cart/white", "kfbo", "axes.delay_gamma_mean=[0.1]", "got delay_gamma_mean, expected one constant delay"),
    ("csth/10s-noise", "chain", "axes.clock_skew=[5000.0]", "got clock_skew, expected regular samples"),
    ("helicopter/constant", "ekf", "axes.timestamp_jitter=[0.01]", "got a random schedule in helicopter/constant"),
    ("helicopter/constant", "mhe", "seeds=1", "mhe in helicopter/constant got a closed loop"),
    ("arm/sine", "smo", "axes.outlier_probability=[0.1]", "whose measurements are continuous and without noise"),
    ("arm/sine", "smo", "axes.quantization_step=[0.1]", "whose measurements are continuous and without noise"),
    ("cart/nominal", "kf", "axes.student_t_dof=[3.0]", "whose samples have no noise"),
    ("cart/white", "kf", "axes.student_t_dof=[1.0]", "expected more than 2 degrees of freedom"),
    ("cart/white", "kf", "axes.mean_burst_length=[5.0]", "with a loss of 0, expected a loss between 0 and 1"),
    ("cart/white", "kf", "axes.quantization_step=[-1.0]", "expected a number of at least 0"),
    ("cart/white", "kf", "axes.timestamp_jitter=[nan]", "got nan, expected a finite number"),
    ("cart/white", "kf", "axes.timestamp_jitter=[0.1]", "expected less than half the shortest interval"),
    ("cart/white", "kf", "axes.assumed_noise_scale=[0.0]", "expected a number greater than 0"),
    ("cart/white", "kf", "axes.outlier_probability=[2.0]", "expected a probability from 0 to 1"),
    ("equal-tuning-reactor", "ekf", 'tune.only=["Qq"]', "'Qq' is no option that an observer of the study tunes"),
]


@pytest.mark.parametrize(("study", "observer", "given", "sentence"), WRONG)
def test_what_cannot_be_is_one_sentence_and_writes_nothing(study, observer, given, sentence, tmp_path):
    words = ("run", study, "--observers", observer, "--seeds", 1, "--set", given, "--out", tmp_path / "out")
    done = call(*words)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert done.stderr.startswith("pcbench: ")
    assert done.stderr.count("\n") == 1, "one line, no traceback"
    assert not done.stdout
    assert not (tmp_path / "out").exists()
