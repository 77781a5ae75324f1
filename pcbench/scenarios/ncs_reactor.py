"""The unstable batch reactor on a network that carries one output at a time, in a loop with its PI controller of order two.

    u1 = -2 y2 - 2 int y2,   u2 = 5 y1 + 8 int y1

In continuous time, without a network, the loop has the eigenvalues -17.659, -15.036, -2.2086 +- 1.7306i, -0.8221 +- 0.3812i.
The two outputs take turns, one every 0.01 s. Different from the networked-control papers: the controller gets the outputs of an
observer's estimate, not the last received value of each output. So their bounds on the interval do not apply to it.
The plant is unstable, so the observer `model-only` always diverges and is left out.
Decided here: the interval of 0.01 s, x(0), both noises, 10 s. The papers have no noise.
The gains are those of public programs for this example; the paper itself was not obtained.
Source: Walsh, Ye, IEEE Control Systems Magazine 21(1), 2001.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth

INTERVAL = 0.01  # s between two transmissions
PI = {"Kp": [[0.0, 2.0], [-5.0, 0.0]], "Ki": [[0.0, 2.0], [-8.0, 0.0]]}  # of the set point 0 minus the output

NCS_REACTOR = (
    Scenario(
        name="ncs-reactor/round-robin",
        summary="PI loop, two outputs in turn every 0.01 s",
        source="Walsh, Ye 2001, with noise and an observer",
        plant="ncs-reactor",
        observers=("kf",),
        truth=Truth(x0=(0.5, -0.5, 1.0, 0.3), process_std=(0.01, 0.01, 0.01, 0.01)),
        loop=Loop(controller="pid", control=PI, actuator_delay=0.0),
        sampling=Sampling(
            sampling_period=(2 * INTERVAL, 2 * INTERVAL),
            sampling_phase=(0.0, INTERVAL),
            delay=(0.0, 0.0),
            noise_std=(0.01, 0.01),
        ),
        belief=Belief(xhat0=(0.0, 0.0, 0.0, 0.0), prior_std=(1.0, 1.0, 1.0, 1.0)),
        scoring=Scoring(
            settle_band=(0.1, 0.1, 0.1, 0.1), divergence_threshold=1e3, steady_start=5.0, headline=("x1", "x2")
        ),
        dt=INTERVAL,
        duration=10.0,
    ),
)
