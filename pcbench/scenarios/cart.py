"""The published experiments on the mobile cart.

`variable*`: the same cart on a camera whose intervals vary, each sample arriving when the next is taken; tail from 3 s.
Kp = -61 and Ki = 12.2 (F = 0.5) are not printed: chosen here. Source: Li, Wang, Tian, PI-PCO, section 4.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017), section 6. Decided where the paper is silent:
horizon 10 s, tick 1 ms, tail from 3 s; in 6.2 the delay is 0.6 s and te is not printed, so `gaussian` takes the paper's rule
d = te and `gaussian-fast` te = 0.2 s; white noise of power 0.07 at 0.2 s is a variance of 0.35 per sample, once and for all.
The settling band is 5 % of the initial error.
"""

from math import sqrt

from pcbench.scenarios.scenario import INTERVAL, Belief, Loop, Sampling, Scenario, Scoring, Truth

PAPER = "Mohammed, Wang, Tian 2017, section "
VARIABLE = "Li, Wang, Tian, PI-PCO, section 4"
PCO = {"pco": {"Kp": -61.0}, "pi-pco": {"Kp": -61.0, "Ki": 12.2}}

NOMINAL = Scenario(
    name="cart/nominal",
    summary="no noise, period and delay 0.2 s",
    source=PAPER + "6.1",
    plant="cart",
    observers=("pccebo", "kfbo", "kf", "model-only"),
    truth=Truth(x0=(5.0, 10.0)),
    loop=Loop(input="sawtooth"),
    sampling=Sampling(sampling_period=(0.2,), delay=(0.2,), noise_std=(0.0,)),
    belief=Belief(xhat0=(0.0, 0.0), prior_std=(5.0, 10.0), drift_intensity=0.002),
    scoring=Scoring(settle_band=(0.25, 0.5), divergence_threshold=1e6),
    options=PCO | {"kfbo": {"R": 0.004}},
)

UNKNOWN = NOMINAL.with_fields(
    name="cart/unknown-delay",
    summary="unknown delay of 0.2 s, assumed to be 0.3 s; period 0.1 s, noise of 0.05 m",
    source="our choice: the cart of " + PAPER + "6 with a sine input, whose slope shows the delay",
    plant="late-cart",
    observers=("ekf-delay", "mmae-delay", "kf", "model-only"),
    x0=(0.0, 0.0),
    input="sine",
    sampling_period=(0.1,),
    delay=(0.2,),
    noise_std=(0.05,),
    xhat0=(0.0, 0.0),
    prior_std=(0.5, 0.5),
    assumed_delay_error=0.1,
    unknown0=(0.3,),
    unknown_std=(0.1,),
    settle_band=(0.05, 0.05, 0.01),
    options={"mmae-delay": {"delays": [round(0.02 * i, 2) for i in range(1, 31)]}},
)._replace(dt=0.01)

CAMERA = NOMINAL.with_fields(
    name="cart/variable",
    summary="varying intervals of 0.2 s on average, delay of one interval, noise of variance 0.001",
    source=VARIABLE,
    observers=("pco", "pi-pco", "pccebo", "kf", "kf-bias", "model-only"),
    delay=(INTERVAL,),
    sampling_pattern="sine",
    noise_std=(sqrt(0.001),),
    input="sine",
    options=PCO | {"kf-bias": {"bias_variance": 1.0}},
)

CART = (
    NOMINAL,
    NOMINAL.with_fields(
        name="cart/gaussian",
        summary="noise of variance 1, period and delay 0.6 s",
        source=PAPER + "6.2",
        sampling_period=(0.6,),
        delay=(0.6,),
        noise_std=(1.0,),
        options=PCO | {"kfbo": {"R": 1.0}},
    ),
    NOMINAL.with_fields(
        name="cart/gaussian-fast",
        summary="noise of variance 1, period 0.2 s, delay 0.6 s",
        source=PAPER + "6.2, other reading",
        delay=(0.6,),
        noise_std=(1.0,),
        options=PCO | {"kfbo": {"R": 1.0}},
    ),
    NOMINAL.with_fields(
        name="cart/white",
        summary="noise of variance 0.35, period and delay 0.2 s",
        source=PAPER + "6.2",
        noise_std=(sqrt(0.07 / 0.2),),
    ),
    NOMINAL.with_fields(
        name="cart/drift",
        summary="drifting parameters, no noise, period and delay 0.2 s",
        source=PAPER + "6.3",
        parameter_drift=1.0,
    ),
    NOMINAL.with_fields(
        name="cart/slow",
        summary="no noise, period and delay 1 s",
        source=PAPER + "6.4",
        sampling_period=(1.0,),
        delay=(1.0,),
        options=PCO | {"kfbo": {"R": 0.3}},
    ),
    CAMERA,
    CAMERA.with_fields(
        name="cart/variable-bias",
        summary="as cart/variable, with an input bias of 0.2",
        source=VARIABLE + ", other plant",
        parameters={"input_bias": 0.2},
    ),
    CAMERA.with_fields(
        name="cart/variable-gain",
        summary="as cart/variable, with a true input gain 10 % larger",
        source=VARIABLE + ", other plant",
        parameters={"b": 390.5},
    ),
    UNKNOWN,
)
