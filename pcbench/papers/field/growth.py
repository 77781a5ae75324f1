"""The growth model: errors of three filters over runs, and how often the interval of the extended filter contains the state.

The numbers of an independent program are means over runs, so a row compares means: `reproduced` is within three standard errors
of their difference. The particle filter resamples systematically here and in that program, at every step.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from pcbench import api
from pcbench.papers.claim import FALSE, OPEN, REPRODUCED, Claim
from pcbench.toml_text import TomlTable

GORDON = "Gordon, Salmond, Smith 1993"
ARULAMPALAM = "Arulampalam et al. 2002"
RUNS = 1000
COVERED_RUNS = 400
COVERAGE, TOLERANCE = 0.48, 0.02  # of the 95 % interval, [V]
PRINTED_COVERAGE = 0.3  # "about 30 %", of one run, [S]


class Reference(NamedTuple):
    """The error of one filter, as an independent program has it."""

    observer: str
    metric: str
    mean: float
    error: float  # standard error


RUN, POOLED = "steady_rmse", "steady_pooled_rmse"
OF_GORDON = (
    Reference("ekf", RUN, 20.3, 0.6),
    Reference("ukf", RUN, 10.9, 0.15),
    Reference("particle", RUN, 4.51, 0.05),
)
OF_ARULAMPALAM = (  # pooled errors had no standard error: that of pcbench, from as many runs, is used
    Reference("ekf", RUN, 21.1, 0.3),
    Reference("ukf", RUN, 11.6, 0.07),
    Reference("particle", RUN, 5.42, 0.04),
    Reference("ekf", POOLED, 22.9, 0.0),
    Reference("ukf", POOLED, 11.8, 0.0),
    Reference("particle", POOLED, 5.58, 0.0),
)
NAMES = {RUN: "mean error of a run", POOLED: "root mean square over runs and steps"}


def rows() -> list[Claim]:
    """Return every claim on the growth model; takes a minute."""
    study: TomlTable = {
        "name": "arulampalam",
        "scenario": {"base": "growth-model/arulampalam"},
        "seeds": RUNS,
        "options": {"scenario": {"random_initial_state": True}},
    }
    first, later = api.run("growth-model").stats, api.run(study).stats
    return [
        *(_mean(first, reference, "400 runs, 500 particles", GORDON) for reference in OF_GORDON),
        *(_mean(later, reference, "1000 runs, 50 particles", ARULAMPALAM) for reference in OF_ARULAMPALAM),
        *_coverage(),
    ]


def _mean(stats: pd.DataFrame, reference: Reference, runs: str, source: str) -> Claim:
    (row,) = stats[(stats.observer == reference.observer) & (stats.metric == reference.metric)].to_dict("records")
    error = np.hypot(row["se"], reference.error or row["se"])
    z_score = abs(row["mean"] - reference.mean) / error
    printed = f"{reference.mean:g}" + (f" +- {reference.error:g}" if reference.error else "")
    text = f"{row['mean']:.3g} +- {row['se']:.2g}, {z_score:.1f} standard errors off"
    claim = f"{reference.observer}: {NAMES[reference.metric]}, {runs}"
    steady = f"within {3 if z_score < 3 else z_score:.0f} standard errors"
    return Claim(claim, printed, text, REPRODUCED if z_score < 3 else FALSE, steady, f"{source} [V]")


def _coverage() -> Iterator[Claim]:
    """Yield the share of steps with |e| < 1.96 sigma in a run from x(0) = 0.1; the initial estimate is within 0.1 of it."""
    study: TomlTable = {
        "name": "coverage",
        "scenario": {"base": "growth-model/gordon", "initial_box": [0.1]},
        "options": {"scenario": {"random_initial_state": True, "consistency": True}},
    }
    shares = []
    for seed in range(COVERED_RUNS):
        frame = api.simulate(study, "ekf", seed=seed).iloc[1:51]
        shares.append(float(((frame["x"] - frame["ekf.x"]).abs() < 1.96 * frame["ekf.x.sigma"]).mean()))
    mean, spread = float(np.mean(shares)), float(np.std(shares, ddof=1))
    agrees = abs(mean - COVERAGE) < TOLERANCE
    claim = "ekf: share of steps whose 95 % interval contains the state"
    steady = f"within {TOLERANCE:g}" if agrees else f"{mean:.2f}"
    text = f"{mean:.3f} over {COVERED_RUNS} runs, {spread:.2f} between runs"
    yield Claim(claim, f"{COVERAGE:g}", text, REPRODUCED if agrees else FALSE, steady, f"{GORDON} [V]")
    below = (mean - PRINTED_COVERAGE) / spread
    text = f"{text}: 0.3 is {below:.1f} standard deviations below, and the noise of the run is not printed"
    steady = "one run of a mean of about 0.48 and a standard deviation of about 0.13, whose noise is not printed"
    yield Claim(f"{claim}, in the one run", "about 30 %", text, OPEN, steady, f"{GORDON} [S]")
