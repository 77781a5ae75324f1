"""The two-state plant of networked control, in a loop of state feedback that is held between samples.

u = -(3.75 x1 + 11.5 x2) of the last sample. The loop is stable at every constant period below 1.72941 s, a limit computed here
from the exact map over one period; `pcbench` warns above it. The period of the controller is that of the samples.
Decided here: a period of 1.5 s, x(0), a noise of 0.01, 60 s, a tick of 0.01 s. The paper has no noise.
The gain is that of the paper as later papers use it; the paper itself was not obtained.
Source: Zhang, Branicky, Phillips, IEEE Control Systems Magazine 21(1), 2001.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

PERIOD = 1.5  # s

NCS_TWO_STATE = (
    Scenario(
        name="ncs-two-state/held",
        summary="held state feedback, period 1.5 s, noise of 0.01",
        source="Zhang, Branicky, Phillips 2001, with noise",
        plant="ncs-two-state",
        observers=("kf", "model-only"),
        truth=Truth(x0=(1.0, 0.5)),
        loop=Loop(controller="state-feedback", control={"K": [[3.75, 11.5]], "period": PERIOD}, actuator_delay=0.0),
        sampling=Sampling(sampling_period=(PERIOD, PERIOD), delay=(0.0, 0.0), noise_std=(0.01, 0.01)),
        belief=Belief(xhat0=(0.0, 0.0), prior_std=(1.0, 1.0)),
        scoring=Scoring(settle_band=(0.05, 0.05), divergence_threshold=1e3, steady_start=30.0, headline=("position",)),
        dt=0.01,
        duration=60.0,
    ),
)
