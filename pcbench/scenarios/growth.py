"""The growth model, on which the particle filter was introduced: 50 steps, x(0) = 0.1, process noise 10, measurement noise 1.

The filters start from N(0, 2). The particle filter has 500 particles and resamples at every measurement, here systematically.
Decided here: a first measurement at step 1, `steady_start` at step 1, and thus 51 ticks: errors are of steps 1 to 50.
With x(0) from N(0, 5) in 400 runs, the mean error of a run (root mean square) is 20.3 +- 0.6 of `ekf` and 4.51 +- 0.05 of
`particle` in an independent program; the study `growth-model` is this experiment.
Source: Gordon, Salmond, Smith 1993.
"""

from math import sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

OPTIONS: dict[str, TomlTable] = {
    "particle": {"particles": 500, "resample": 1.0},
    "ukf": {"alpha": 1.0, "beta": 0.0, "kappa": 2.0},
}

GROWTH = (
    Scenario(
        name="growth-model/gordon",
        summary="x^2/20 measured at each of 50 steps",
        source="Gordon, Salmond, Smith 1993",
        plant="growth-model",
        observers=("ekf", "ukf", "particle"),
        truth=Truth(x0=(0.1,), process_std=(sqrt(10.0),)),
        loop=Loop(input="zero"),
        sampling=Sampling(sampling_period=(1.0,), sampling_phase=1.0, delay=(0.0,), noise_std=(1.0,)),
        belief=Belief(xhat0=(0.0,), prior_std=(sqrt(2.0),)),
        scoring=Scoring(settle_band=(5.0,), divergence_threshold=1e4, steady_start=1.0),
        dt=1.0,
        duration=51.0,
        options=OPTIONS,
    ),
)
