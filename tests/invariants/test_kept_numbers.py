"""Numbers stay what they are when the house is rebuilt: a few studies, every metric of every run, as digests.

To eight digits, and below a billionth as 0: the last bits are the processor's and the compiler's. No gains here come from a
numerical solver, whose digits are its own. A change that is meant to change numbers writes its digests anew, and says why.
"""

import hashlib

import pytest

import pcbench

METRICS = (
    "mae",
    "rmse",
    "max_abs_error",
    "final_error",
    "steady_mse",
    "steady_rmse",
    "settling_time",
    "steady_tracking_rmse",
    "recovery_time",
)
STUDIES = {
    "late and noisy": (
        {
            "scenarios": ["cart/white"],
            "observers": ["kfbo", "kf", "model-only"],
            "axes": {"parameter_drift": [0.0, 1.0]},
        },
        "712669da57fd651e",
    ),
    "random schedules": (
        {
            "scenarios": ["cart/variable"],
            "observers": ["pco", "kf"],
            "axes": {"sampling_jitter": [0.04], "loss": [0.2]},
        },
        "535b2637a9bd5612",
    ),
    "unequal delays": (
        {"scenarios": ["csth/10s-noise"], "observers": ["kf", "no-delay", "model-only"]},
        "435751d44f9b36cb",
    ),
    "a closed loop": ({"scenarios": ["helicopter/constant"], "observers": ["high-gain"]}, "4bab4742bb7f6b70"),
}
QUICK = "late and noisy"


def format_number(value):
    return "0" if abs(value) < 1e-9 else f"{value:.7e}"


def digest(study):
    runs = pcbench.run(study).runs
    metrics = [m for m in METRICS if m in runs]
    rows = runs.sort_values(["scenario", "observer", "cell", "seed", "signal"])
    text = "\n".join(" ".join(map(format_number, row)) for row in rows[metrics].to_numpy(float))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@pytest.mark.parametrize("name", [QUICK, *(pytest.param(n, marks=pytest.mark.nightly) for n in STUDIES if n != QUICK)])
def test_numbers_are_what_they_were(name):
    study, kept = STUDIES[name]
    assert digest({"name": "kept", "seeds": 6, **study}) == kept
