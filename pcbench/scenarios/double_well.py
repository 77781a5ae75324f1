"""The double well of data assimilation: every 0.25 s a noisy measurement of the position, which changes wells now and then.

The source says that whether an extended Kalman filter follows the transitions depends on how often and how accurately the
position is measured, relative to the noise that pushes it. Here it is measured so seldom that the filter follows late.
Decided here: the period, the noise of the measurements 0.6, that of the motion 0.8 (a Wiener process: 0.8 sqrt(dt) a tick), the
start on the wall, where an observer does not know which well it will be, 12 s, a tick of 25 ms. Numbers of the paper were not
obtained.
Source: Miller, Ghil, Gauthiez 1994.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

DT = 0.025
DOUBLE_WELL = (
    Scenario(
        name="double-well/sampled",
        summary="position every 0.25 s, noise of 0.6",
        source="Miller, Ghil, Gauthiez 1994",
        plant="double-well",
        observers=("ekf", "ukf", "particle"),
        truth=Truth(x0=(0.0,), process_std=(0.8 * DT**0.5,)),
        loop=Loop(input="zero"),
        sampling=Sampling(sampling_period=(0.25,), delay=(0.0,), noise_std=(0.6,)),
        belief=Belief(xhat0=(0.0,), prior_std=(1.0,)),
        scoring=Scoring(settle_band=(0.5,), divergence_threshold=1e3, steady_start=2.0),
        dt=DT,
        duration=12.0,
        options={"particle": {"particles": 100}},
    ),
)
