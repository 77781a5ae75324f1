"""Observers that do not know how late their samples are, and find it out."""

from pcbench.observers import ekf_delay, mmae_delay
from pcbench.observers.entry import ObserverSpec

DELAYS = {
    "ekf-delay": ObserverSpec(
        observer=ekf_delay.OBSERVER,
        options=ekf_delay.Options,
        design=ekf_delay.design,
        knows_schedule=False,
        summary="EKF with the delay as an additional state",
        takes="any schedule",
        smooth=False,
        loops=False,
    ),
    "mmae-delay": ObserverSpec(
        observer=mmae_delay.OBSERVER,
        options=mmae_delay.Options,
        design=mmae_delay.design,
        knows_schedule=False,
        summary="a Kalman filter for each of several delays, weighted",
        takes="any schedule",
        smooth=False,
        loops=False,
    ),
}
