"""The growth model, on which the particle filter was introduced: 50 steps, x(0) = 0.1, process noise 10, measurement noise 1.

The filters start from N(0, 2). The particle filter has 500 particles and resamples at every measurement, here systematically.
Decided here: a first measurement at step 1, `steady_start` at step 1, and thus 51 ticks: errors are of steps 1 to 50.
With x(0) from N(0, 5) in 400 runs, the mean error of a run (root mean square) is 20.3 +- 0.6 of `ekf` and 4.51 +- 0.05 of
`particle` in an independent program; the study `growth-model` is this experiment.
`arulampalam` is the later variant: the cosine has the phase of the new state, 100 steps, N(0, 10), 50 particles. With x(0) from
N(0, 10) in 1000 runs, the root mean square over runs and steps is 22.9 of `ekf` and 5.58 of `particle` in an independent
program.
Source: Gordon, Salmond, Smith 1993; Arulampalam, Maskell, Gordon, Clapp 2002.
"""

from math import sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

UKF: TomlTable = {"alpha": 1.0, "beta": 0.0, "kappa": 2.0}
GORDON = Scenario(
    name="growth-model/gordon",
    summary="measurement of x^2/20 at each of 50 steps",
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
    options={"particle": {"particles": 500, "resample": 1.0}, "ukf": UKF},
)
GROWTH = (
    GORDON,
    GORDON.with_fields(
        name="growth-model/arulampalam",
        summary="cosine at the time of the new state, 100 steps, 50 particles",
        source="Arulampalam, Maskell, Gordon, Clapp 2002",
        model={"phase": 1.0},
        x0=(0.0,),
        prior_std=(sqrt(10.0),),
        duration=101.0,
        options={"particle": {"particles": 50, "resample": 1.0}, "ukf": UKF},
    ),
)
