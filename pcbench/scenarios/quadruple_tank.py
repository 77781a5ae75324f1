"""The quadruple tank at its two operating points, with a delayed second level: `delayed` at P-, `right-zero` at P+.

Both levels are measured every 5 s, and that of tank 2 arrives 60 s after it was taken. The pumps follow square waves of 0.3 V
about 3 V (P-) or 3.15 V (P+), so the levels move about the exact equilibrium of the constants. Signals are deviations from it.
Time constants at the printed levels: 62.7, 90.3, 23.9 and 30.0 s at P-, 63.2, 91.4, 39.0 and 56.1 s at P+. The plant has a
transmission zero of +0.0128 1/s at P+: its upper tanks get most of the water.
Decided here: the delay, the periods, the inputs, both noises, x(0), 1200 s, a tick of 1 s. The source has no delay.
Source: Johansson, IEEE Trans. Control Systems Technology 8(3), 2000, as public programs that name it have its constants.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.sources import Wave

MINIMUM_PHASE = Scenario(
    name="quadruple-tank/delayed",
    summary="two levels every 5 s, the second delayed by 60 s",
    source="Johansson 2000, with a delay and noise",
    plant="quadruple-tank",
    observers=("kf", "kf-ignore-delay", "model-only"),
    truth=Truth(x0=(1.0, -1.0, 0.3, -0.3), process_std=(0.02, 0.02, 0.02, 0.02)),
    loop=Loop(input=(Wave("square", 0.3, 1 / 400, unit="V"), Wave("square", 0.3, 1 / 600, unit="V"))),
    sampling=Sampling(sampling_period=(5.0, 5.0), delay=(0.0, 60.0), noise_std=(0.02, 0.02)),
    belief=Belief(xhat0=(0.0, 0.0, 0.0, 0.0), prior_std=(1.0, 1.0, 0.3, 0.3)),
    scoring=Scoring(
        settle_band=(0.2, 0.2, 0.2, 0.2), divergence_threshold=1e3, steady_start=400.0, headline=("level_2", "level_4")
    ),
    dt=1.0,
    duration=1200.0,
)
QUADRUPLE_TANK = (
    MINIMUM_PHASE,
    MINIMUM_PHASE.with_fields(
        name="quadruple-tank/right-zero",
        summary="as delayed, most water to the upper tanks",
        model={"k1": 3.14, "k2": 3.29, "gamma1": 0.43, "gamma2": 0.34, "point": "P+"},
    ),
)
