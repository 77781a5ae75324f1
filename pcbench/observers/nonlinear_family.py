"""Estimators for nonlinear plants beside `ekf`: they take samples of any age by the same rule as it."""

from pcbench.observers import ekf_iterated, mhe, particle, ukf
from pcbench.observers.entry import ObserverSpec

NONLINEAR = {
    "ekf-iterated": ObserverSpec(
        observer=ekf_iterated.OBSERVER,
        options=ekf_iterated.Options,
        design=ekf_iterated.design,
        knows_schedule=True,
        summary="EKF that iterates the linearisation of the sensor",
        takes="any schedule",
        nonlinear=True,
        smooth=False,
    ),
    "ukf": ObserverSpec(
        observer=ukf.OBSERVER,
        options=ukf.Options,
        design=ukf.design,
        knows_schedule=True,
        summary="unscented (or cubature) Kalman filter",
        takes="any schedule",
        lanes=particle.LANES,
        nonlinear=True,
        smooth=False,
    ),
    "mhe": ObserverSpec(
        observer=mhe.OBSERVER,
        options=mhe.Options,
        design=mhe.design,
        knows_schedule=True,
        summary="moving horizon over a window of samples, within bounds",
        takes="any schedule",
        expensive=True,
        nonlinear=True,
        smooth=False,
        loops=False,
    ),
    "particle": ObserverSpec(
        observer=particle.OBSERVER,
        options=particle.Options,
        design=particle.design,
        knows_schedule=False,
        summary="bootstrap particle filter with systematic resampling",
        takes="any schedule",
        lanes=particle.LANES,
        expensive=True,
        nonlinear=True,
        smooth=False,
    ),
}
