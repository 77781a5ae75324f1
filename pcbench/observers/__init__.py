"""The observers, one file each, and dicts of them by name."""

from collections.abc import Callable, Iterable, Mapping
from types import ModuleType
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from pcbench.observers import (
    cascade_predictor,
    chain,
    communication_disturbance,
    ekf,
    ekf_delay,
    ekf_iterated,
    equal_delay,
    eso,
    finite_time,
    high_gain,
    high_gain_predictor,
    interval,
    kf,
    kf_alexander,
    kf_cloning,
    kf_delayed_horizon,
    kf_drop_delayed,
    kf_event,
    kf_ignore_delay,
    kf_larsen,
    kf_reprocess,
    kf_shifted_innovation,
    kfbo,
    lmi_sampled,
    mhe,
    mmae_delay,
    model_only,
    no_delay,
    oosm_a1,
    oosm_b1,
    oosm_lag,
    particle,
    pccebo,
    pco,
    pio,
    smo,
    super_twisting,
    ukf,
)
from pcbench.observers.methods import ACRONYMS, METHODS, Method
from pcbench.protocols import Observer
from pcbench.synthesis.certificate import Design, DesignContext

MAX_LABEL_LENGTH = 80  # characters of a label, which names a folder
Takes = Literal["any schedule", "one clock", "one constant delay", "constant delays"]


class ObserverSpec(NamedTuple):
    """An observer, its options, the design of its gains, and the schedules that it accepts.

    `takes` names the accepted schedules. "any schedule" includes lost and out-of-sequence samples of each channel. "one
    clock" is the same with all channels sampled together. "one constant delay" is a constant delay of all channels.
    "constant delays" is periodic sampling of all channels together, with a constant delay of each channel.
    """

    observer: Observer  # the functions
    options: type[BaseModel]  # a pydantic model
    design: Callable[[DesignContext, Any], Design]  # (context, options) -> gains and certificate
    knows_schedule: bool  # whether the error stays 0 with the true model, a true initial state and no noise
    summary: str  # one line for `pcbench list`
    takes: Takes = "one constant delay"  # accepted schedules
    lanes: int | None = None  # fixed runs per call, if the last bits depend on that number; None: they do not
    # whether its runs may take much longer than those of other observers: it then runs last, in its own program
    expensive: bool = False
    nonlinear: bool = False  # whether it is designed for plants without a linear model
    smooth: bool = True  # whether the estimate is differentiable by the options, and loops have a fixed length
    loops: bool = True  # whether its estimate can close a loop
    elsewhere: bool = False  # whether another program computes the estimates, which are only scored
    measurement_noise: bool = False  # whether it uses the variance of each measurement of a recording
    # options for gains designed for the true noise and delays; None: no such options
    designed: Mapping[str, Any] | None = None
    method: Method | None = None  # description of the method; None: not an observer of pcbench


def _spec(module: ModuleType, summary: str, takes: Takes = "any schedule", knows_schedule: bool = True) -> ObserverSpec:
    return ObserverSpec(module.OBSERVER, module.Options, module.design, knows_schedule, summary, takes)


def _filter(module: ModuleType, summary: str, knows_schedule: bool = True) -> ObserverSpec:
    return _spec(module, summary, knows_schedule=knows_schedule)._replace(smooth=False)


_PCO = ObserverSpec(
    pco.OBSERVER, pco.Proportional, pco.design, True, "piecewise-continuous observer of reduced order", "one clock"
)
# Kalman filters that differ from `kf` in their treatment of delayed samples.
LATE = {
    "kf-ignore-delay": _filter(
        kf_ignore_delay, "Kalman filter that ignores the delay of a sample", knows_schedule=False
    ),
    "kf-drop-delayed": _filter(kf_drop_delayed, "Kalman filter that drops samples older than a limit"),
    "kf-reprocess": _filter(kf_reprocess, "Kalman filter that filters again from a past sample"),
    "kf-cloning": _filter(kf_cloning, "Kalman filter with copies of past states"),
    "kf-larsen": _filter(kf_larsen, "Kalman filter that extrapolates a delayed sample"),
    "kf-alexander": _filter(kf_alexander, "Kalman filter that updates P at the sampling time"),
    "kf-delayed-horizon": _filter(kf_delayed_horizon, "Kalman filter at a fixed lag, with a prediction"),
    "kf-shifted-innovation": _filter(
        kf_shifted_innovation, "Kalman filter with a shifted delayed innovation", knows_schedule=False
    ),
    "oosm-a1": _filter(oosm_a1, "exact out-of-sequence update over one step"),
    "oosm-b1": _filter(oosm_b1, "out-of-sequence update that neglects process noise"),
    "oosm-lag": _filter(oosm_lag, "out-of-sequence update over several steps"),
}
# Estimators for nonlinear plants in addition to `ekf`; like it, they use a sample of any age at its sampling time.
NONLINEAR = {
    "ekf-iterated": _filter(ekf_iterated, "EKF with iterated linearisation of the sensor")._replace(nonlinear=True),
    "ukf": _filter(ukf, "unscented (or cubature) Kalman filter")._replace(nonlinear=True, lanes=particle.LANES),
    "mhe": _filter(mhe, "moving-horizon estimation, optionally with bounds")._replace(
        nonlinear=True, expensive=True, loops=False
    ),
    "particle": _filter(
        particle, "bootstrap particle filter with systematic resampling", knows_schedule=False
    )._replace(nonlinear=True, expensive=True, lanes=particle.LANES),
}
# Observers that estimate an unknown delay.
DELAYS = {
    "ekf-delay": _filter(ekf_delay, "EKF with the delay as an additional state", knows_schedule=False)._replace(
        loops=False
    ),
    "mmae-delay": _filter(mmae_delay, "weighted Kalman filters, one per assumed delay", knows_schedule=False)._replace(
        loops=False
    ),
}
OBSERVERS = {
    "pccebo": _spec(pccebo, "current estimator with predictor", "one clock")._replace(designed={"gain": "riccati"}),
    "kfbo": _spec(kfbo, "Kalman filter of the held, delayed measurement", "one constant delay", False)._replace(
        designed={"R": "noise"}
    ),
    "pco": _PCO._replace(designed={"Kp": "lmi"}),
    "pi-pco": _PCO._replace(
        options=pco.ProportionalIntegral, summary="pco with an integral term", designed={"Kp": "lmi", "Ki": "lmi"}
    ),
    "chain": _spec(chain, "chain of observers, one per delay", "constant delays")._replace(
        designed={"gain": "riccati"}
    ),
    "equal-delay": _spec(equal_delay, "observer designed with one delay for all channels", "constant delays", False),
    "no-delay": _spec(no_delay, "classical observer, designed without delay", "constant delays", False),
    "smo": _spec(smo, "sliding-mode observer for unknown inputs", "one constant delay")._replace(
        smooth=False, designed={"gains": "design"}
    ),
    "pio": _spec(pio, "PI observer with a sign term for unknown inputs", "one constant delay")._replace(
        smooth=False, designed={"gains": "design"}
    ),
    "high-gain": _spec(high_gain, "high-gain observer with output predictor")._replace(nonlinear=True),
    "eso": _spec(eso, "extended state observer with predictor", "one clock"),
    "cascade-predictor": _spec(cascade_predictor, "chain of predictors for long delays", "one constant delay")._replace(
        nonlinear=True
    ),
    "cdob": _spec(communication_disturbance, "communication disturbance observer, for any delay", "one clock", False),
    "super-twisting": _spec(super_twisting, "super-twisting observer, implicit discretisation", "one clock")._replace(
        smooth=False, nonlinear=True
    ),
    "finite-time": _spec(finite_time, "finite-time observer with a delay inside", "one clock"),
    "high-gain-predictor": _spec(high_gain_predictor, "high-gain observer for any plant with one output")._replace(
        nonlinear=True
    ),
    "interval": _spec(interval, "interval observer: bounds of the state", "one clock"),
    "lmi-sampled": _spec(lmi_sampled, "held innovations, gain by LMI for aperiodic samples")._replace(nonlinear=True),
    "ekf": _filter(ekf, "EKF that uses samples at their sampling time")._replace(nonlinear=True),
    "kf": _spec(kf, "Kalman filter that uses samples at their sampling time"),
    "kf-event": _spec(kf_event, "Kalman filter for send on delta, which uses silence"),
    **NONLINEAR,
    **LATE,
    **DELAYS,
    "model-only": _spec(model_only, "model that ignores all measurements"),
}
for _name in (
    *("kf", "kf-ignore-delay", "kf-drop-delayed", "kf-reprocess", "kf-shifted-innovation", "kf-cloning", "kf-larsen"),
    *("oosm-a1", "oosm-b1", "oosm-lag", "ekf", "ekf-iterated", "ukf", "mhe", "particle"),
):
    OBSERVERS[_name] = OBSERVERS[_name]._replace(measurement_noise=True)
OBSERVERS = {name: entry._replace(method=METHODS[name]) for name, entry in OBSERVERS.items()}


def base_of(label: str) -> str | None:
    """Return the observer of a label (its name, or its name with a suffix), or None for an unknown label."""
    if label in OBSERVERS:
        return label
    names = [name for name in OBSERVERS if label.startswith(name + "-")]
    is_valid = label.isprintable() and len(label) <= MAX_LABEL_LENGTH
    return max(names, key=len, default=None) if is_valid else None


def acronyms(labels: Iterable[str]) -> dict[str, str]:
    """Return the papers' acronyms among the observers of these labels, in their order, spelled out."""
    return {base: ACRONYMS[base] for label in labels if (base := base_of(label) or "") in ACRONYMS}


def entry_of(label: str) -> ObserverSpec:
    """Return the entry of the observer of a label; raise KeyError for an unknown one."""
    return OBSERVERS[base_of(label) or label]
