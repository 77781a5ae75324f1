"""Recordings of a second-order plant whose stamps are late by a constant, made with NumPy and SciPy alone."""

import numpy as np
from logged import rows
from scipy.linalg import expm

DT, EVERY, LASTS = 0.01, 0.02, 20.0  # tick, input and length [s]
A, B, C = np.array([[0.0, 1.0], [-4.0, -0.6]]), np.array([[0.0], [4.0]]), np.eye(2)
NOISE, PROCESS, PRIOR = (0.02, 0.1), (0.0005, 0.005), (0.1, 0.1)


def plant(outputs=1, tick=DT, **changes):
    """Return the study, which assumes another noise; outputs are position, and position and velocity."""
    lti = {
        **{"A": A.tolist(), "B": B.tolist(), "C": C[:outputs].tolist(), "states": ["position [m]", "velocity [m/s]"]},
        **{"tick": tick, "sampling_period": 0.04, "delay": 0.0, "noise_std": 0.05, "process_std": [0.001, 0.02]},
        **{"prior_std": list(PRIOR), "duration": LASTS, "input": "zero"},
    }
    return {"name": "oscillator", "lti": lti | changes}


def motion(seed, ticks, dt=DT):
    """Return inputs [N, 1] and states [N, 2] at every tick, and the random numbers that are left."""
    random = np.random.default_rng(seed)
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * dt)
    Phi, Gamma = whole[:2, :2], whole[:2, 2:]
    hold = round(EVERY / dt)
    steps = 0.3 * np.cumsum(random.normal(size=ticks // (25 * hold) + 1)).repeat(25)
    u = (steps[: -(-ticks // hold)] + np.sin(1.3 * EVERY * np.arange(-(-ticks // hold)))).repeat(hold)[:ticks, None]
    x = np.empty((ticks, 2))
    x[0] = random.normal(0, PRIOR)
    for k in range(ticks - 1):
        x[k + 1] = Phi @ x[k] + Gamma @ u[k] + random.normal(0, PROCESS) * np.sqrt(dt / DT)
    return u, x, random


def recording(folder, seed, late, every=(4,), lasts=LASTS, inputs=True, arrives=0.0):
    """Write samples of some channels every so many ticks, stamped `late` [s] after they were taken; return them and u."""
    u, x, random = motion(seed, round(lasts / DT) + 1)
    columns = {name: [] for name in ("channel", "sampled", "arrived", "value")}
    for c, (step, shift) in enumerate(zip(every, late, strict=True)):
        k = np.arange(0, len(x), step)
        stamps = k * DT + shift
        columns["channel"] += [f"y{c + 1}"] * len(k)
        columns["sampled"] += stamps.tolist()
        columns["arrived"] += (stamps + arrives).tolist()
        columns["value"] += (x[k, c] + NOISE[c] * random.normal(size=len(k))).tolist()
    hold = round(EVERY / DT)
    table = {"t": np.arange(0, len(x), hold) * DT, "u1": u[::hold, 0]} if inputs else None
    rows(folder, columns, table)
    return columns, u


def unknown(seed):
    """Return the delay [s] and the ticks between samples of a recording of the series that tests take."""
    return float(np.random.default_rng(900 + seed).uniform(0.0, 0.15)), (4, 5)[seed % 2]
