"""The observers, one file each, and the dict that names them."""

from pcbench.observers import chain, ekf, equal_delay, high_gain, kf, kfbo, model_only, no_delay, pccebo, pco, pio, smo
from pcbench.observers.delay_family import DELAYS
from pcbench.observers.entry import ObserverSpec
from pcbench.observers.late_family import LATE
from pcbench.observers.nonlinear_family import NONLINEAR

__all__ = ["DELAYS", "LATE", "LONGEST", "NONLINEAR", "OBSERVERS", "ObserverSpec", "base_of", "entry_of"]

LONGEST = 80  # characters of a label, which names a folder
OBSERVERS = {
    "pccebo": ObserverSpec(
        observer=pccebo.OBSERVER,
        options=pccebo.Options,
        design=pccebo.design,
        knows_schedule=True,
        summary="current estimator, predictor; gain by LMI or Riccati",
        takes="one clock",
        designed={"gain": "riccati"},
    ),
    "kfbo": ObserverSpec(
        observer=kfbo.OBSERVER,
        options=kfbo.Options,
        design=kfbo.design,
        knows_schedule=False,
        summary="Kalman filter of the held, late measurement",
        takes="one constant delay",
        designed={"R": "noise"},
    ),
    "pco": ObserverSpec(
        observer=pco.OBSERVER,
        options=pco.Proportional,
        design=pco.design,
        knows_schedule=True,
        summary="piecewise continuous, reduced order; given or by LMI",
        takes="one clock",
        designed={"Kp": "lmi"},
    ),
    "pi-pco": ObserverSpec(
        observer=pco.OBSERVER,
        options=pco.ProportionalIntegral,
        design=pco.design,
        knows_schedule=True,
        summary="PCO with an integral; gains given or by LMI",
        takes="one clock",
        designed={"Kp": "lmi", "Ki": "lmi"},
    ),
    "chain": ObserverSpec(
        observer=chain.OBSERVER,
        options=chain.Options,
        design=chain.design,
        knows_schedule=True,
        summary="one link per delay; gains by poles or Riccati",
        takes="constant delays",
        designed={"gain": "riccati"},
    ),
    "equal-delay": ObserverSpec(
        observer=equal_delay.OBSERVER,
        options=equal_delay.Options,
        design=equal_delay.design,
        knows_schedule=False,
        summary="pretends one delay for all channels",
        takes="constant delays",
    ),
    "no-delay": ObserverSpec(
        observer=no_delay.OBSERVER,
        options=no_delay.Options,
        design=no_delay.design,
        knows_schedule=False,
        summary="classical observer, designed without the delay",
        takes="constant delays",
    ),
    "smo": ObserverSpec(
        observer=smo.OBSERVER,
        options=smo.Options,
        design=smo.design,
        knows_schedule=True,
        summary="sliding mode with unknown input; printed or by LMI",
        takes="one constant delay",
        smooth=False,
        designed={"gains": "design"},
    ),
    "pio": ObserverSpec(
        observer=pio.OBSERVER,
        options=pio.Options,
        design=pio.design,
        knows_schedule=True,
        summary="PI and sign with unknown input; printed or by LMI",
        takes="one constant delay",
        smooth=False,
        designed={"gains": "design"},
    ),
    "high-gain": ObserverSpec(
        observer=high_gain.OBSERVER,
        options=high_gain.Options,
        design=high_gain.design,
        knows_schedule=True,
        summary="high gain with output predictor; printed or robust",
        takes="any schedule",
        nonlinear=True,
    ),
    "ekf": ObserverSpec(
        observer=ekf.OBSERVER,
        options=ekf.Options,
        design=ekf.design,
        knows_schedule=True,
        summary="extended Kalman filter at each sample's own time",
        takes="any schedule",
        nonlinear=True,
        smooth=False,
    ),
    "kf": ObserverSpec(
        observer=kf.OBSERVER,
        options=kf.Options,
        design=kf.design,
        knows_schedule=True,
        summary="delay-compensated Kalman filter, the fair baseline",
        takes="any schedule",
    ),
    **NONLINEAR,
    **LATE,
    **DELAYS,
    "model-only": ObserverSpec(
        observer=model_only.OBSERVER,
        options=model_only.Options,
        design=model_only.design,
        knows_schedule=True,
        summary="the model alone, never corrected: the floor",
        takes="any schedule",
    ),
}


def base_of(label: str) -> str | None:
    """Return the observer that a label names: its own name, or name-anything (an observer run with other options)."""
    if label in OBSERVERS:
        return label
    found = [name for name in OBSERVERS if label.startswith(name + "-")]
    plain = label.isprintable() and len(label) <= LONGEST
    return max(found, key=len, default=None) if plain else None


def entry_of(label: str) -> ObserverSpec:
    """Return the entry of the observer that a label names; raise KeyError where there is none."""
    return OBSERVERS[base_of(label) or label]
