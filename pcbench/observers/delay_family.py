"""Observers that do not know how late their samples are, and find it out."""

from pcbench.observers import bank, ekf_delay
from pcbench.observers.entry import Entry

DELAYS = {
    "ekf-delay": Entry(
        observer=ekf_delay.OBSERVER,
        options=ekf_delay.Options,
        design=ekf_delay.design,
        knows_schedule=False,
        summary="extended Kalman filter with the delay as one more state",
        takes="any schedule",
        smooth=False,
        loops=False,
    ),
    "bank": Entry(
        observer=bank.OBSERVER,
        options=bank.Options,
        design=bank.design,
        knows_schedule=False,
        summary="a Kalman filter for each of several delays, weighted",
        takes="any schedule",
        smooth=False,
        loops=False,
    ),
}
