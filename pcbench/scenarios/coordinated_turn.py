"""An aircraft that turns at an unknown rate, seen by a radar once a second: the example of the cubature Kalman filter.

Process noise has the covariance diag(q1 M, q1 M, q2) a step with M = [1/3, 1/2; 1/2, 1], q1 = 0.1 m^2/s^3, q2 = 1.75e-4 1/s^3.
`ukf` is the cubature filter here. In 250 runs of an independent program its root mean square errors are 19.3 and 20.4 m of
position (two seeds), 11.2 m/s of velocity and 1.33 degrees/s of the turn rate.
Decided here: x(0) is drawn about the printed start, where the estimate starts. The first measurement is at 1 s, and the last of
100 steps at 100 s. The variances of the prior are remembered, as the paper was not obtained: that of the turn rate is
100 mrad^2/s^2 = 1e-4 rad^2/s^2. Noise and start are those of a public program that names the source.
Source: Arasaratnam, Haykin, IEEE Trans. Automatic Control 54(6), 2009.
"""

from math import radians, sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

Q1, Q2 = 0.1, 1.75e-4  # m^2/s^3, 1/s^3
START = (1000.0, 300.0, 1000.0, 0.0, radians(-3.0))
ALONG, ACROSS = sqrt(Q1 / 3), sqrt(3 * Q1) / 2  # a root of q1 M is [ALONG, 0; ACROSS, RATE]
RATE = sqrt(Q1) / 2

COORDINATED_TURN = (
    Scenario(
        name="coordinated-turn/radar",
        summary="range and bearing once a second, unknown turn rate, 100 s",
        source="Arasaratnam, Haykin 2009",
        plant="coordinated-turn",
        observers=("ekf", "ukf"),
        truth=Truth(
            x0=START,
            process_std=(
                (ALONG, 0.0, 0.0, 0.0, 0.0),
                (ACROSS, RATE, 0.0, 0.0, 0.0),
                (0.0, 0.0, ALONG, 0.0, 0.0),
                (0.0, 0.0, ACROSS, RATE, 0.0),
                (0.0, 0.0, 0.0, 0.0, sqrt(Q2)),
            ),
        ),
        loop=Loop(input="zero"),
        sampling=Sampling(
            sampling_period=(1.0, 1.0), sampling_phase=1.0, delay=(0.0, 0.0), noise_std=(10.0, sqrt(10.0) * 1e-3)
        ),
        belief=Belief(xhat0=START, prior_std=(10.0, sqrt(10.0), 10.0, sqrt(10.0), 0.01)),
        scoring=Scoring(
            settle_band=(50.0, 20.0, 50.0, 20.0, 0.05, 50.0, 20.0),
            divergence_threshold=1e5,
            steady_start=1.0,
            headline=("position", "turn_rate"),
        ),
        dt=1.0,
        duration=101.0,
        options={"ukf": {"form": "cubature"}},
    ),
)
