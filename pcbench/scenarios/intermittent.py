"""Intermittent observations: an unstable scalar plant whose measurements are lost at random.

The expected covariance P of the predicted error is bounded exactly if a measurement arrives with a probability p above the
critical rate 1 - 1/a^2 = 0.36, that is for `loss` below 0.64. Then S <= P <= V, with

    S = Q / (1 - (1 - p) a^2),   V = a^2 V + Q - p a^2 V^2 / (V + R)

Here p = 0.6, so S = 2.667 and V = 7.327. The mean error of runs shows the limit poorly, because few runs carry it: near the
critical rate it falls below S. Use the bounds.
Decided here: a = 1.25, Q = 1, R = 2.5, 100 steps, x(0) = 0 with a variance of 1. The source gives the theorem; its example was
not obtained.
Source: Sinopoli et al. 2004.
"""

from math import sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

INTERMITTENT = (
    Scenario(
        name="intermittent/scalar",
        summary="40 % of the measurements lost; critical is 64 %",
        source="Sinopoli et al. 2004, with our numbers",
        plant="intermittent",
        observers=("kf",),
        truth=Truth(x0=(0.0,), process_std=(1.0,)),
        loop=Loop(input="zero"),
        sampling=Sampling(sampling_period=(1.0,), delay=(0.0,), noise_std=(sqrt(2.5),), loss=0.4),
        belief=Belief(xhat0=(0.0,), prior_std=(1.0,)),
        scoring=Scoring(settle_band=(5.0,), divergence_threshold=1e9, steady_start=20.0),
        dt=1.0,
        duration=100.0,
    ),
)
