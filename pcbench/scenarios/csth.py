"""The stirred tank heater with sensors that answer after 2, 5 and 7 samples.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5. Decided where the text has no numbers (the inputs are in a figure
only): square waves about 0 of 40 and 60 samples, x(0) = (0.5 L, 2e4 J, 5 degC) with xhat(0) = 0, 200 samples, tail from the
100th. `literal` is the paper's recursion of continuous-time numbers; `1s` and `10s` are the physical plant, sampled exactly.
A run has diverged when an error exceeds a million times the initial one. The settling band is 5 % of the initial error. Where
there is no noise, designers assume that of `10s-noise`.
"""

from math import sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.toml_text import TomlTable

PAPER = "Alipouri, Zhong 2021, section 5"
DELAYS = (2, 5, 7)  # samples
NOISE = (1.0, 0.1, 0.1)  # mm, degC, degC
ROUGHNESS = (1e-3, 50.0, 5e-3)  # process noise: standard deviation over one second

LABELS: dict[str, TomlTable] = {
    "chain-slow": {"pole_per_tick": 0.8},
    "chain-riccati": {"gain": "riccati", "output": "deadbeat"},
}


def make_csth(name: str, summary: str, source: str, tick: float) -> Scenario:
    """Return the experiment at one sample a tick."""
    return Scenario(
        name=name,
        summary=summary,
        source=source,
        plant="csth",
        observers=("chain", "chain-riccati", "equal-delay", "no-delay", "kf", "model-only"),
        truth=Truth(x0=(0.5, 2e4, 5.0)),
        loop=Loop(input=f"heater-{tick:g}s"),
        sampling=Sampling(
            sampling_period=(tick,) * 3, delay=tuple(d * tick for d in DELAYS), noise_std=(0.0, 0.0, 0.0)
        ),
        belief=Belief(
            xhat0=(0.0, 0.0, 0.0),
            prior_std=(0.5, 2e4, 5.0),
            assumed_noise_std=NOISE,
            assumed_process_std=tuple(sqrt(tick) * s for s in ROUGHNESS),
        ),
        scoring=Scoring(
            settle_band=(0.025, 1e3, 0.25),
            divergence_threshold=(5e5, 2e10, 5e6),
            steady_start=100 * tick,
            headline=("enthalpy",),
        ),
        dt=tick,
        duration=200 * tick,
        options=LABELS,
    )


PHYSICAL = make_csth("csth/10s", "physical plant, period 10 s, no noise", PAPER + ", made consistent", 10.0)
CSTH = (
    make_csth("csth/literal", "the published recursion with a tick of 1, no noise", PAPER, 1.0).with_fields(
        input="heater-literal", model={"literal": True}
    ),
    make_csth("csth/1s", "physical plant, period 1 s, no noise", PAPER + ", made consistent", 1.0),
    PHYSICAL,
    PHYSICAL.with_fields(
        name="csth/10s-noise",
        summary="physical plant, period 10 s, with noise",
        source=PAPER + ", with noise",
        noise_std=NOISE,
        process_std=tuple(sqrt(10.0) * s for s in ROUGHNESS),
        duration=3000.0,
    ),
)
