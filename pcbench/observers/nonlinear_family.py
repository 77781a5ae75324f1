"""Estimators for nonlinear plants beside `ekf`: they take samples of any age by the same rule as it."""

from pcbench.observers import iekf, mhe, particle, ukf
from pcbench.observers.entry import Entry

NONLINEAR = {
    "iekf": Entry(
        observer=iekf.OBSERVER,
        options=iekf.Options,
        design=iekf.design,
        knows_schedule=True,
        summary="ekf that takes the sensor's slope anew where a correction leads",
        takes="any schedule",
        nonlinear=True,
        smooth=False,
    ),
    "ukf": Entry(
        observer=ukf.OBSERVER,
        options=ukf.Options,
        design=ukf.design,
        knows_schedule=True,
        summary="unscented Kalman filter: points in place of slopes; or cubature",
        takes="any schedule",
        lanes=particle.LANES,
        nonlinear=True,
        smooth=False,
    ),
    "mhe": Entry(
        observer=mhe.OBSERVER,
        options=mhe.Options,
        design=mhe.design,
        knows_schedule=True,
        summary="moving horizon: looks back over a window, within bounds",
        takes="any schedule",
        expensive=True,
        nonlinear=True,
        smooth=False,
        loops=False,
    ),
    "particle": Entry(
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
