"""The observers, one file each, and the dict that names them."""

from pcbench.observers import chain, dkf, ekf, equal_delay, high_gain, kfbo, no_delay, open_loop, pccebo, pco, pio, smo
from pcbench.observers.delay_family import DELAYS
from pcbench.observers.entry import Entry
from pcbench.observers.late_family import LATE
from pcbench.observers.nonlinear_family import NONLINEAR

__all__ = ["DELAYS", "LATE", "LONGEST", "NONLINEAR", "OBSERVERS", "Entry", "base_of", "entry_of"]

LONGEST = 80  # characters of a label, which names a folder
OBSERVERS = {
    "pccebo": Entry(
        observer=pccebo.OBSERVER,
        options=pccebo.Options,
        design=pccebo.design,
        knows_schedule=True,
        summary="current estimator, predicted to now; gain by LMI or Riccati",
        takes="one clock",
        designed={"gain": "riccati"},
    ),
    "kfbo": Entry(
        observer=kfbo.OBSERVER,
        options=kfbo.Options,
        design=kfbo.design,
        knows_schedule=False,
        summary="Kalman filter of the held, late measurement",
        takes="one constant delay",
        designed={"R": "noise"},
    ),
    "pco": Entry(
        observer=pco.OBSERVER,
        options=pco.Proportional,
        design=pco.design,
        knows_schedule=True,
        summary="piecewise continuous, reduced order; gain given or by LMI",
        takes="one clock",
        designed={"Kp": "lmi"},
    ),
    "pi-pco": Entry(
        observer=pco.OBSERVER,
        options=pco.ProportionalIntegral,
        design=pco.design,
        knows_schedule=True,
        summary="PCO with an integral; gains given or by LMI",
        takes="one clock",
        designed={"Kp": "lmi", "Ki": "lmi"},
    ),
    "chain": Entry(
        observer=chain.OBSERVER,
        options=chain.Options,
        design=chain.design,
        knows_schedule=True,
        summary="a link for each delay, latest sensor first; poles or Riccati",
        takes="constant delays",
        designed={"gain": "riccati"},
    ),
    "equal-delay": Entry(
        observer=equal_delay.OBSERVER,
        options=equal_delay.Options,
        design=equal_delay.design,
        knows_schedule=False,
        summary="pretends one delay for all channels",
        takes="constant delays",
    ),
    "no-delay": Entry(
        observer=no_delay.OBSERVER,
        options=no_delay.Options,
        design=no_delay.design,
        knows_schedule=False,
        summary="the classical observer, designed as if nothing were late",
        takes="constant delays",
    ),
    "smo": Entry(
        observer=smo.OBSERVER,
        options=smo.Options,
        design=smo.design,
        knows_schedule=True,
        summary="sliding mode; injects the unknown input; printed or by LMI",
        takes="one constant delay",
        smooth=False,
        designed={"gains": "design"},
    ),
    "pio": Entry(
        observer=pio.OBSERVER,
        options=pio.Options,
        design=pio.design,
        knows_schedule=True,
        summary="PI with a sign; injects the unknown input; printed or by LMI",
        takes="one constant delay",
        smooth=False,
        designed={"gains": "design"},
    ),
    "high-gain": Entry(
        observer=high_gain.OBSERVER,
        options=high_gain.Options,
        design=high_gain.design,
        knows_schedule=True,
        summary="positions, rates, parameters; predicts y; printed or robust",
        takes="any schedule",
        nonlinear=True,
    ),
    "ekf": Entry(
        observer=ekf.OBSERVER,
        options=ekf.Options,
        design=ekf.design,
        knows_schedule=True,
        summary="extended Kalman filter at a sample's own time; parameters too",
        takes="any schedule",
        nonlinear=True,
        smooth=False,
    ),
    "dkf": Entry(
        observer=dkf.OBSERVER,
        options=dkf.Options,
        design=dkf.design,
        knows_schedule=True,
        summary="delay-compensated Kalman filter, the fair baseline",
        takes="any schedule",
    ),
    **NONLINEAR,
    **LATE,
    **DELAYS,
    "open-loop": Entry(
        observer=open_loop.OBSERVER,
        options=open_loop.Options,
        design=open_loop.design,
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


def entry_of(label: str) -> Entry:
    """Return the entry of the observer that a label names; raise KeyError where there is none."""
    return OBSERVERS[base_of(label) or label]
