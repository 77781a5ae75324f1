"""A batch reactor with a poor initial estimate, little A and much B: an extended Kalman filter finds negative pressures.

2 A <-> B with the total pressure measured every 0.1 s, x(0) = (3, 1) atm, xhat(0) = (0.1, 4.5) atm with a standard deviation of
6 atm in each; noise of 0.1 atm a sample, process noise of 0.001 atm a sample. Decided here: a horizon of 30 s, the tail from
15 s, no delay (it is an axis), a tick of 0.1 s, settled within 0.1 atm; a run has diverged beyond 1000 atm.

`ekf-inflated-q` does not fail. It assumes 100 times the process noise (in standard deviation), because its linearisation is
wrong so far from the true state. `mhe-bounded` has the constraint that pressures are not negative. Source: Haseltine, Rawlings
2005, also TWMCC report 2002-03. `ekf-inflated-q` follows Schneider and Georgakis 2013, with a different tuning.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

LABELS: dict[str, TomlTable] = {"mhe-bounded": {"lower": 0.0}, "ekf-inflated-q": {"Q": [0.01, 0.01]}}

BATCH = Scenario(
    name="reactor/batch",
    summary="total pressure every 0.1 s, poor initial estimate",
    source="Haseltine, Rawlings 2005",
    plant="reactor",
    observers=("ekf", "ekf-inflated-q", "ekf-iterated", "ukf", "mhe", "mhe-bounded"),
    truth=Truth(x0=(3.0, 1.0), process_std=(1e-3, 1e-3)),
    loop=Loop(input="zero"),
    sampling=Sampling(sampling_period=(0.1,), delay=(0.0,), noise_std=(0.1,)),
    belief=Belief(xhat0=(0.1, 4.5), prior_std=(6.0, 6.0)),
    scoring=Scoring(
        settle_band=(0.1, 0.1), divergence_threshold=1e3, steady_start=15.0, headline=("pressure_a", "pressure_b")
    ),
    dt=0.1,
    duration=30.0,
    options=LABELS,
)
REACTOR = (BATCH,)
