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
    "ways to evaluate, design and tune": (
        "pcbench run quick --exact\npcbench design cart/white kf --method h2\n"
        "pcbench tune cart/white kf --exact --method search",
        "pcbench run quick --evaluation exact\npcbench design cart/white kf --gain h2\n"
        "pcbench tune cart/white kf --exact-objective --optimizer search",
    ),
    "what stays": ("pcbench verify out --exact", "pcbench verify out --exact"),
    "an observer": (
        "OWN = pcbench.Observer(init, note=n, jump=lambda a, arrival: arrival.note * arrival.fresh, flow=f, sampled=s)",
        "OWN = pcbench.Observer(init, snapshot=n, jump=lambda a, arrival: arrival.snapshot * arrival.mask, flow=f, "
        "on_sample=s)",
    ),
    "arguments": (
        'pcbench.run(s, method="exact", block=8, fresh=True)\npcbench.suffices(s, over="jitter", below=0.1, within=0.2)',
        'pcbench.run(s, evaluation="exact", block_size=8, overwrite=True)\n'
        'pcbench.find_limit(s, axis="sampling_jitter", threshold=0.1, tol=0.2)',
    ),
    "tuning on a recording": (
        'pcbench.tune_log("log", P, "kf", budget=9)',
        'pcbench.tune(P, "kf", log="log", budget=9)',
    ),
    "tuning on runs": (
        'pcbench.tune(s, "dkf", training=(0, 4), judges=(4, 8))',
        'pcbench.tune(s, "kf", training_seeds=(0, 4), validation_seeds=(4, 8))',
    ),
    "verdicts": (
        'assert row["p_white"] > 0.05 and row.verdict in ("over-confident", "cautious")',
        'assert row["ljung_box_p"] > 0.05 and row.verdict in ("optimistic", "pessimistic")',
    ),
    "types": ("pcbench.Surprise(1, 2), pcbench.Setting", "pcbench.InnovationStats(1, 2), pcbench.DesignContext"),
    "studies in python": (
        'pcbench.run("late", out="results/map")',
        'pcbench.run("delayed-measurements", out="results/period-delay-map")',
    ),
    "c": (
        "dkf_note(&m); a.fresh[0] = 1; a.since = 3; dkf_jump(&m, &a);",
        "kf_snapshot(&m); a.mask[0] = 1; a.ticks_since_arrival = 3; kf_jump(&m, &a);",
    ),
    "a bank of filters": (
        "[options.bank]\npcbench replay log --observers kf,bank --out bank",
        "[options.mmae-delay]\npcbench replay log --observers kf,mmae-delay --out bank",
    ),
    "a mean of a gamma distribution, twice": ("delay_gamma = 0.2", "delay_gamma_mean = 0.2"),
    "plain English": ("The drift of a clock, the tail of it; a bank.", "The drift of a clock, the tail of it; a bank."),
}


@pytest.mark.parametrize(("old", "new"), TEXTS.values(), ids=TEXTS)
def test_translate_gives_the_new_names_and_leaves_them_alone(old, new):
    assert translate(old) == new
    assert translate(new) == new
