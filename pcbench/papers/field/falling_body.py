"""The falling body: its path, and the median errors of altitude and drag of the extended and the cubature filter.

pcbench draws the points of the cubature filter at every tick of 1/64 s, the program of the reference once a second. Its
points then keep more of the distribution, and its errors are smaller from 20 s on.
Medians are compared, because in few runs both filters lose the body, and these runs carry a mean. `reproduced` is within three
standard errors of the difference of two medians of as many runs each; that of one is 0.93 interquartile ranges / sqrt(runs).
"""

import numpy as np

from pcbench import api
from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import OPEN, REPRODUCED, Claim, all_digits

COMPUTED = "Julier, Uhlmann, Durrant-Whyte 2000 [V]"
RUNS = 400
TIMES = (10, 20, 30, 60)  # s
ALTITUDES = "102455, 39453, 32592, 26732"  # ft
PLOT_NOTE = (
    "larger from 20 s on: points are drawn at every tick here, once a second there, and the source leaves it open"
)
MEDIANS = {"ekf": (734.0, 127.0, 91.0, 60.0), "ukf": (728.0, 77.0, 45.0, 23.0)}  # ft, at the times
DRAG_MEDIANS = {"ekf": 8.1e-6, "ukf": 2.3e-6}  # 1/ft, at the last time


def rows() -> list[Claim]:
    """Return every claim on the falling body; takes a minute."""
    frames = [
        api.simulate("falling-body/radar", list(MEDIANS), seed=seed).set_index("t").loc[list(TIMES)]
        for seed in range(RUNS)
    ]
    out = [all_digits("altitude at 10, 20, 30, 60 s [ft]", ALTITUDES, frames[0]["altitude"], COMPUTED)]
    for observer, medians in MEDIANS.items():
        altitude, drag = (
            np.abs([frame[signal] - frame[f"{observer}.{signal}"] for frame in frames])  # [runs, times]
            for signal in ("altitude", "drag")
        )
        out += [
            _median(f"{observer}: median error of altitude at 10, 20, 30, 60 s, {RUNS} runs [ft]", medians, altitude),
            _median(
                f"{observer}: median error of the drag coefficient at 60 s, {RUNS} runs [1/ft]",
                (DRAG_MEDIANS[observer],),
                drag[:, -1:],
            ),
        ]
    return out


def _median(claim: str, medians: tuple[float, ...], errors: Matrix) -> Claim:
    """Compare the medians over runs of absolute errors [runs, times] with those of the reference."""
    low, middle, high = np.quantile(errors, [0.25, 0.5, 0.75], axis=0)
    z_scores = np.abs(middle - medians) / (0.93 * (high - low) * np.sqrt(2 / RUNS))
    text = ", ".join(f"{ours:.3g}" for ours in middle)
    agrees = bool(z_scores.max() < 3)
    steady = "within 3 standard errors" if agrees else PLOT_NOTE
    verdict = REPRODUCED if agrees else OPEN
    summary = f"{text}{'' if agrees else f', {PLOT_NOTE}'}, at most {z_scores.max():.1f} standard errors off"
    return Claim(claim, ", ".join(f"{value:g}" for value in medians), summary, verdict, steady, COMPUTED)
