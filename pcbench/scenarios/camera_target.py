"""A platform that follows a target seen by a slow, late camera on it, with a fast encoder: an estimate from two rates.

The camera takes a picture every 0.2 s, which arrives 0.2 s later. The encoder measures every 0.05 s, without a delay.
`following` closes the loop: the command is the target's estimated velocity plus 8 1/s times the estimated offset. Its headline
is the offset, whose distance from 0 is the tracking error. `servoing` is visual servoing: the command is 4 1/s times the
estimated offset. `camera` moves the platform along a sine, for the estimate alone.
The filter of two rates with delayed measurements is `kf` here. `kf-ignore-delay` in `servoing` is visual servoing that ignores
the delay.
Decided here: all numbers. The target's standard deviations are 0.29 m and 0.45 m/s. The paper's camera and the motion of its
target were not obtained.
Source: Xiao, Chen, Int. J. Intelligent Robotics and Applications, 2020, as its abstract describes the task.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.sources import Wave

GAIN, SERVO_GAIN = 8.0, 4.0  # 1/s, commanded velocity per offset

FOLLOWING = Scenario(
    name="camera-target/following",
    summary="closed loop follows a target; camera at 5 Hz, delayed by 0.2 s",
    source="Xiao, Chen 2020, the task; numbers are ours",
    plant="camera-target",
    observers=("kf", "kf-ignore-delay"),
    truth=Truth(x0=(0.3, 0.3, 0.3), process_std=(0.001, 0.0, 0.08)),
    loop=Loop(controller="state-feedback", control={"K": [[-GAIN, 0.0, -1.0]]}, actuator_delay=0.0),
    sampling=Sampling(sampling_period=(0.2, 0.05), delay=(0.2, 0.0), noise_std=(0.005, 0.0005)),
    belief=Belief(xhat0=(0.0, 0.0, 0.0), prior_std=(0.3, 0.3, 0.5)),
    scoring=Scoring(settle_band=(0.1, 0.1, 0.3), divergence_threshold=100.0, steady_start=4.0, headline=("offset",)),
    dt=0.05,
    duration=12.0,
)
CAMERA_TARGET = (
    FOLLOWING,
    FOLLOWING.with_fields(
        name="camera-target/servoing",
        summary="as following, with a command proportional to the offset",
        controller="state-feedback",
        control={"K": [[-SERVO_GAIN, 0.0, 0.0]]},
    ),
    FOLLOWING.with_fields(
        name="camera-target/camera",
        summary="as following, but in open loop: the platform moves along a sine",
        observers=("kf", "kf-shifted-innovation", "kf-ignore-delay", "model-only"),
        controller="",
        control={},
        actuator_delay=None,
        input=(Wave("sine", 0.5, 0.4, unit="m/s"),),
    ),
)
