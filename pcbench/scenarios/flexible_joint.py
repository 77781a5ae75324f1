"""The flexible joint of nonlinear observers, sampled: the motor angle every 0.1 s.

Linearised at rest its eigenvalues are -0.4322 +- 8.2798i and -0.1928 +- 1.5222i. Without gravity they are -0.4452 +- 8.2208i,
0 and -0.3596.
Decided here: the period, no delay (it is an axis), the noise, the process noise, the input sin 4t, x(0), 10 s, a tick of 5 ms.
The intervals that papers on sampled observers print for this plant were not obtained.
Source: Raghavan, Hedrick 1994.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

FLEXIBLE_JOINT = (
    Scenario(
        name="flexible-joint/sampled",
        summary="motor angle every 0.1 s, noise of 0.01 rad",
        source="Raghavan, Hedrick 1994, sampled and with noise",
        plant="flexible-joint",
        observers=("ekf", "ukf", "lmi-sampled", "kf", "model-only"),
        truth=Truth(x0=(1.0, 0.0, 1.0, 0.0), process_std=(0.0, 0.005, 0.0, 0.005)),
        loop=Loop(input="sine"),
        sampling=Sampling(sampling_period=(0.1,), delay=(0.0,), noise_std=(0.01,)),
        belief=Belief(xhat0=(0.0, 0.0, 0.0, 0.0), prior_std=(1.0, 1.0, 1.0, 1.0)),
        scoring=Scoring(
            settle_band=(0.05, 0.1, 0.05, 0.1), divergence_threshold=1e3, steady_start=5.0, headline=("link_angle",)
        ),
        dt=0.005,
        duration=10.0,
    ),
)
