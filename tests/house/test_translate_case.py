"""Cases in the old names are run through `support/translate_case.py`."""

import pytest
from support.translate_case import translate

TEXTS = {
    "a command": (
        "pcbench run beliefs --set axes.drift=[0.0,1.0] --observers dkf --metric peak --fresh",
        "pcbench run model-mismatch --set axes.parameter_drift=[0.0,1.0] --observers kf --metric max_abs_error --overwrite",
    ),
    "a search": (
        "pcbench suffices cart/white --below 0.1 --over jitter",
        "pcbench find-limit cart/white --threshold 0.1 --axis sampling_jitter",
    ),
    "toml": (
        "[lti]\nhorizon = 4.0\ntail = 1.0\n[options.kf-discard]\nlimit = 0.2\n",
        "[lti]\nduration = 4.0\nsteady_start = 1.0\n[options.kf-drop-delayed]\nmax_age = 0.2\n",
    ),
    "toml in python": (
        r'text + "[options.scenario]\nrandom_start = true\n"',
        r'text + "[options.scenario]\nrandom_initial_state = true\n"',
    ),
    "python": (
        'pcbench.trace(x, options={"kf-horizon": {"horizon": 0.3}}, axes={"jitter": [0.1]}, horizon=3.0)',
        'pcbench.simulate(x, options={"kf-delayed-horizon": {"lag": 0.3}}, axes={"sampling_jitter": [0.1]}, duration=3.0)',
    ),
    "keys of a study": (
        'vary = "each"\ntuning = ["paper", "tuned"]\nbound = 1e6\n',
        'vary = "one-at-a-time"\ntuning = ["published", "tuned"]\ndivergence_threshold = 1e6\n',
    ),
    "studies in python": (
        'pcbench.run("late", out="results/map")',
        'pcbench.run("delayed-measurements", out="results/period-delay-map")',
    ),
    "c": (
        "dkf_note(&m); a.fresh[0] = 1; a.since = 3; dkf_jump(&m, &a);",
        "kf_snapshot(&m); a.mask[0] = 1; a.ticks_since_arrival = 3; kf_jump(&m, &a);",
    ),
    "a mean of a gamma distribution, twice": ("delay_gamma = 0.2", "delay_gamma_mean = 0.2"),
    "plain English": ("The drift of a clock, the tail of it; a bank.", "The drift of a clock, the tail of it; a bank."),
}


@pytest.mark.parametrize(("old", "new"), TEXTS.values(), ids=TEXTS)
def test_translate_gives_the_new_names_and_leaves_them_alone(old, new):
    assert translate(old) == new
    assert translate(new) == new
