"""The flexible-joint arm, pushed by an unknown input.

`sine` and `sawtooth` are measured continuously: plant and observer are one field. Not printed and found by fitting the paper's
Table 2: x(0), xhat(0) = 0, u = 0, a step of 1e-4 s and the window 6 <= t <= 10 s with both ends, so the horizon ends one tick
after 10 s. `sampled` is ours: the same arm under a sampler. A drift of size a multiplies k/J, M g l/J and F/J by
1 + a sin(w t + phi), with w and phi drawn for each run. The settling band is 5 % of the initial error, and 0.1 rad/s^2 for the
input; a run has diverged beyond 1000.

Source: Peng, Appl. Sci. 2017, 7(1), 67, section 5 and Table 2.
"""

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

PAPER = "Peng 2017, section 5, Table 2"
PRINTED: dict[str, TomlTable] = {"smo": {"gains": "paper"}, "pio": {"gains": "paper"}}
VARIANTS: dict[str, TomlTable] = {
    "design": {"gains": "design"},
    "hold": {"measurement": "hold"},
    "reconstruct": {"reconstruct": True},
}
LINEAR = {  # the arm without gravity, for which the printed gains were computed
    "A": ((0, 1, 0, 0), (-3.75, -0.0015, 3.75, 0), (0, 0, 0, 1), (3.75, 0, -3.75, -0.00125)),
    "C": ((0, 1, 0, 0), (0, 0, 1, 0)),
    "E": ((0,), (1,), (0,), (0,)),
}
LABELS = {f"{name}-{variant}": option for name in PRINTED for variant, option in VARIANTS.items()}

SINE = Scenario(
    name="arm/sine",
    summary="unknown input 0.25 sin(2 pi t), continuous measurement",
    source=PAPER,
    plant="arm",
    observers=("smo", "pio", "model-only"),
    truth=Truth(x0=(-0.5, 1.0, -1.5, -0.5), unknown_input="arm-sine"),
    loop=Loop(input="zero"),
    sampling=Sampling(sampling_period=(1e-4, 1e-4), delay=(0.0, 0.0), noise_std=(0.0, 0.0), continuous=True),
    belief=Belief(xhat0=(0.0, 0.0, 0.0, 0.0), prior_std=(1.0, 1.0, 1.0, 1.0), unknown_std=(1.0,)),
    scoring=Scoring(
        settle_band=(0.025, 0.05, 0.075, 0.025, 0.1),
        divergence_threshold=1e3,
        steady_start=6.0,
        headline=("link_velocity", "input"),
    ),
    dt=1e-4,
    duration=10.0001,
    options=PRINTED | LABELS,
)

ARM = (
    SINE,
    SINE.with_fields(
        name="arm/sawtooth", summary="unknown sawtooth input, continuous measurement", unknown_input="arm-sawtooth"
    ),
    SINE.with_fields(
        name="arm/sampled",
        summary="as arm/sine, period and delay 0.02 s, noise of 0.001",
        source="our choice, after Peng 2017",
        observers=("smo", "smo-reconstruct", "pio", "pio-reconstruct", "kf", "model-only"),
        sampling_period=(0.02, 0.02),
        delay=(0.02, 0.02),
        noise_std=(1e-3, 1e-3),
        dt=5e-4,
        duration=10.0005,
        continuous=False,
    ),
)
