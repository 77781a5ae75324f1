"""What cannot be done with an unknown input is said in one sentence, before anything runs or is written."""

import re

import jax
import numpy as np
import pytest
from commands import call

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.planning import run_local
from pcbench.runtime import config
from pcbench.study import parse

ARM = {
    "A": [[0.0, 1, 0, 0], [-3.75, -0.0015, 3.75, 0], [0, 0, 0, 1], [3.75, 0, -3.75, -0.00125]],
    "B": [[0.0], [0], [0], [0.25]],
    "C": [[0.0, 1, 0, 0], [0, 0, 1, 0]],
    "E": [[0.0], [1], [0], [0]],
    "sampling_period": 0.02,
    "delay": 0.02,
    "noise_std": 0.0,
    "duration": 0.2,
}
STIFFER = [ARM["A"][0], [-3.76, -0.0015, 3.76, 0], *ARM["A"][2:]]
SEEN_NOWHERE = [*ARM["A"][:2], [0.0, 0, 0, 0], ARM["A"][3]]  # the motor's velocity moves nothing

THREE = {
    "A": [[-1.0, 0.5, 0], [0, -2, 1], [1, 0, -3]],
    "B": [[1.0], [0], [0]],
    "C": [[1.0, 0, 0], [0, 1, 0]],
    "E": [[0.0], [1], [0]],
}


def own(observer="smo", options=None, **changes):
    """The arm as a linear plant of one's own, with some keys changed, None: left out."""
    lti = {key: value for key, value in (ARM | changes).items() if value is not None}
    return {"name": "own", "lti": lti, "observers": [observer], "options": {observer: options or {}}}


def study_table(scenario, observer, options=None, axes=None, choices=None):
    given = {name: table for name, table in ((observer, options), ("scenario", choices)) if table}
    return {"name": "study", "scenarios": [scenario], "observers": [observer], "options": given, "axes": axes or {}}


def option(observer, **options):
    return study_table("arm/sampled", observer, options)


REFUSED = {
    # the assumptions of the design, with what was found
    "rank(C E) < r": (
        own(C=[[1.0, 0, 0, 0], [0, 0, 1, 0]]),
        r"smo in lti: Assumption 1, rank\(C E\) = r, .* got rank 0, expected 1",
    ),
    "p < r + 1": (
        own(E=[[0.0, 0], [1, 0], [0, 1], [0, 0]]),
        r"Assumption 2, p > r, .* got 2 outputs and 2 unknown inputs",
    ),
    "one output": (
        own("pio", C=[[0.0, 1, 0, 0]]),
        r"pio in lti: Assumption 2, p > r, .* got 1 outputs and 1 unknown inputs",
    ),
    "unobservable": (
        own(A=SEEN_NOWHERE),
        r"\(C, A\) observable, .* got rank 3 .* at the mode lam = -0\.00125, expected 4",
    ),
    "link sensors": (
        own(C=np.eye(2, 4).tolist()),
        r"no gain L1 moves, -0\.000625[+-]1\.936j, -0\.000625[+-]1\.936j, expected each left of -1 1/s",
    ),
    "link sensors, pio": (own("pio", C=np.eye(2, 4).tolist()), r"pio in lti: got modes .* -0\.000625[+-]1\.936j"),
    "too fast": (own("pio", {"beta": 1.3}), r"got a rate beta of 1\.3 1/s, expected less than the 1\.24\d* 1/s"),
    "discrete": (own(dt=1e-3, duration=0.04), "got a discrete model, expected x' = A x"),
    # what the observers do not take
    "two delays": (
        own(delay=[0.02, 0.04]),
        r"got channels with delays \(20, 40\) \(ticks\), expected one for all.*use kf",
    ),
    "late by chance": (own(delay_jitter=0.01), r"got a delay_jitter of 0\.01 s, expected one constant delay"),
    "on the cart": (
        study_table("cart/nominal", "smo"),
        r"smo in cart/nominal: the plant has no unknown input, expected .* use another",
    ),
    "on the tank": (study_table("csth/10s", "pio"), r"pio in csth/10s: the plant has no unknown input"),
    "paper gains elsewhere": (
        own(options={"gains": "paper"}, A=STIFFER),
        "printed for the arm, on another plant; expected 'design'",
    ),
    "paper gains, other sensors": (
        own("pio", {"gains": "paper"}, C=np.eye(2, 4).tolist()),
        "printed for the arm, on another plant",
    ),
    "paper gains, three states": (own("pio", {"gains": "paper"}, **THREE), "printed for the arm, on another plant"),
    # options
    **{
        f"{name} = {value}": (
            option(observer, **{name: value}),
            rf"options\.{observer}: {name}: got {value}, expected greater than 0",
        )
        for observer, name, value in [
            ("pio", "xi", 0.0),
            ("pio", "beta", 0.0),
            ("pio", "alpha", -1.0),
            ("smo", "rho", -1.0),
            ("smo", "eps", 0.0),
            ("smo", "alpha", 0.0),
        ]
    },
    "rho = nan": (option("smo", rho=float("nan")), "options.smo: rho: got nan, expected a finite number"),
    "innovation": (
        option("smo", measurement="innovation"),
        "measurement: got 'innovation', expected 'predict' or 'hold'",
    ),
    "xi of smo": (option("smo", xi=1.0), r"options\.smo: 'xi' is no key here; valid: alpha, eps, gains"),
    "printed": (option("pio", gains="printed"), "gains: got 'printed', expected 'design' or 'paper'"),
    "input_walk": (
        option("kf", input_walk=-1.0),
        "options.kf: input_walk: got -1.0, expected greater than or equal to 0",
    ),
    # continuous measurement has no sampler
    "kf": (
        study_table("arm/sine", "kf"),
        "kf in arm/sine got continuous measurements, expected samples.*one of smo, pio, model-only",
    ),
    **{
        f"axis {name}": (
            study_table(scenario, "smo", axes={name: [value]}),
            rf"got {name} = {value} in {scenario}, .*arm/sampled",
        )
        for scenario, name, value in [
            ("arm/sine", "noise_std", 0.001),
            ("arm/sine", "delay", 0.02),
            ("arm/sawtooth", "sampling_period", 0.02),
            ("arm/sine", "sampling_jitter", 0.001),
            ("arm/sine", "loss", 0.1),
            ("arm/sine", "assumed_delay_error", 0.1),
        ]
    },
    # choices
    "float32": (
        study_table("arm/sine", "smo", choices={"precision": "float32"}),
        "precision: got 'float32', expected float64",
    ),
    "unknown input of the cart": (
        study_table("cart/nominal", "kf", choices={"unknown-input": "sine"}),
        r"unknown_input: got 'sine' for cart/nominal, whose plant has no unknown input; expected a scenario such as arm/sine",
    ),
    "unknown input of an lti": (
        own("kf", E=None) | {"options": {"scenario": {"unknown_input": "sine"}}},
        "got 'sine' for lti, whose plant has no unknown input",
    ),
    "no such signal": (
        study_table("arm/sine", "smo", choices={"unknown_input": "cosine"}),
        "'cosine' is no input; did you mean 'sine'",
    ),
    # a plant of one's own
    "E": (own(E=[[0.0], [1.0]]), r"lti\.E: got 2 x 1, expected 4 x 1"),
    "E, ragged": (own(E=[[0.0], [1], [0, 1], [0]]), r"lti\.E: got rows of lengths \[1, 1, 2, 1\], expected 4 x 1"),
    "no E": (own(E=None), r"smo in lti: the plant has no unknown input, expected a model with E"),
    "unknown_std": (
        own(unknown_std=[1.0, 2.0]),
        r"lti\.unknown_std: got 2 numbers, expected 1, one for each unknown",
    ),
    "unknown_std without E": (own("kf", E=None, unknown_std=[1.0]), r"lti\.unknown_std: got 1 numbers, expected 0"),
    "two signals": (
        own(unknown_input="sine, square"),
        r"lti\.unknown_input: got 2 signals, expected one.* of 1 unknown inputs",
    ),
    "no signal": (own(unknown_input="cosine"), r"lti\.unknown_input: 'cosine' is no input; did you mean 'sine'"),
    "E of no columns": (own(E=[[], [], [], []]), r"lti\.E: "),
    "a size below 0": (own(unknown_std=[-1.0]), r"lti\.unknown_std\[0\]: got -1\.0"),
    "a size of 0": (own(unknown_std=[0.0]), r"lti\.unknown_std\[0\]: got 0\.0"),
    "two columns for one": (own(unknown_input="heater-1s"), r"unknown_input: .*heater-1s"),
    "two columns for the arm's": (study_table("arm/sine", "smo", choices={"unknown_input": "heater-1s"}), "heater-1s"),
    "settle_band": (own(settle_band=[1.0] * 4), r"lti\.settle_band: got 4 numbers, expected 5, one for each signal"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_in_one_sentence(what, tmp_path):
    study, said = REFUSED[what]
    with pytest.raises(UserError, match=said) as error:
        pcbench.run(study, seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert str(error.value).count(". ") == 0
    assert str(error.value).endswith(".")
    assert not re.search(r"got (.+?), expected \1\b", str(error.value)), "what is expected is not what was given"
    assert not (tmp_path / "out").exists()


def test_the_same_studies_without_the_mistake_are_planned():
    """So that what is refused above is refused for its mistake, not for what stands around it."""
    good = [
        own(),
        own("pio"),
        own("kf", E=None),
        own(unknown_std=[2.0], settle_band=[1.0] * 5),
        study_table("arm/sine", "smo"),
    ]
    good += [
        option("pio", xi=0.1, beta=0.5, gains="design"),
        option("smo", eps=1e-3, measurement="hold", gains="paper"),
    ]
    with config.float64():
        for study in good:
            (p,) = planning.plan(parse.parse(study, study["name"]))
            assert all(c.margin > 0 for c in p.certificates.values())


def test_a_planned_cell_is_not_run_in_float32():
    """Whoever leaves the library's front doors has to switch float64 on: nothing is computed quietly in less."""
    study = parse.parse(study_table("arm/sampled", "smo"), "study")
    with config.float64():
        planned = planning.plan(study)
    with jax.enable_x64(False), pytest.raises(UserError, match="float64") as error:
        next(run_local.execute(study, planned, np.array([0])))
    assert "float32" in str(error.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "cart/nominal", "--observers", "smo"), "smo in cart/nominal: the plant has no unknown input"),
        (("run", "arm/sine", "--set", "axes.noise_std=0.1"), "whose measurements are continuous and without noise"),
        (("simulate", "arm/sawtooth", "--observer", "kf"), "kf in arm/sawtooth got continuous measurements"),
        (("design", "arm/sampled", "pio", "--set", "options.pio.xi=0"), "xi: got 0, expected greater than 0"),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else "",
)
def test_the_command_line_says_it_and_exits_with_2(words, said, tmp_path):
    out = {"run": ["--out", "out"], "simulate": ["--out", "out.parquet"], "design": []}[words[0]]
    done = call(*words, *out, cwd=tmp_path)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
