"""The helicopter under delayed control, measured five times a second; the estimate drives the controller.

`constant`: commands and samples are 0.025 s late; `varying`: 0.03 + 0.015 sin 2t. A sample that arrives at t_k was taken at
t_k - tau(t_k), rounded to whole ticks, also before t = 0. Decided where the paper is silent: one Runge-Kutta step of 1 ms,
tail from 10 s, the input held over a tick is the command of its middle less the delay. Without noise designers assume 1e-4 rad.
Settled: within 5 % of the viscosities, 0.01 rad and 0.05 rad/s. A run has diverged when an error exceeds 1e6. A random start
draws z(0) uniformly within 0.5 of x(0) in all four states.

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 5.
"""

from math import pi, sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

PAPER = "Hernandez-Gonzalez et al. 2024, section 5"
VISCOSITY = (0.8, 0.318)  # N m s/rad
LABELS: dict[str, TomlTable] = {
    "high-gain-robust": {"robust": True},
    "ekf": {"walk": 1e-5 / 0.64},  # of the viscosities: 1e-5 (N m s/rad)^2 a second
}

CONSTANT = Scenario(
    name="helicopter/constant",
    summary="closed loop, period 0.2 s, both delays 0.025 s, no noise",
    source=PAPER + ".1",
    plant="helicopter",
    observers=("high-gain", "high-gain-robust", "ekf"),
    truth=Truth(x0=(pi / 4, pi / 8, 0.2, 0.1)),
    loop=Loop(
        controller="pd", control={"Kp": (30.0, 150.0), "Kd": (5.0, 1.0), "limit": (20.0, 15.0), "path": "circle"}
    ),
    sampling=Sampling(sampling_period=(0.2, 0.2), delay=(0.025, 0.025), noise_std=(0.0, 0.0), prefilled=True),
    belief=Belief(
        xhat0=(pi / 8, pi / 16, 0.5, 0.1),
        prior_std=(0.5, 0.5, 0.5, 0.5),
        unknown_std=(0.8, 0.8),  # the prior of the viscosities, both alike
        assumed_noise_std=(1e-4, 1e-4),
        assumed_process_std=(0.0, 0.0, sqrt(1e-4 * 1e-3), sqrt(1e-4 * 1e-3)),  # a tick, of a density of 1e-4
        initial_box=(0.5, 0.5, 0.5, 0.5),
    ),
    scoring=Scoring(
        settle_band=(0.01, 0.01, 0.05, 0.05, 0.05 * VISCOSITY[0], 0.05 * VISCOSITY[1]),
        divergence_threshold=1e6,
        steady_start=10.0,
        headline=("pitch", "pitch_viscosity"),
    ),
    duration=20.0,
    options=LABELS,
)

HELICOPTER = (
    CONSTANT,
    CONSTANT.with_fields(
        name="helicopter/varying",
        summary="as helicopter/constant, delays 0.03 + 0.015 sin(2t) s",
        source=PAPER + ".2",
        delay=(0.03, 0.03),
        delay_sine=(0.015, 2.0),
    ),
)
