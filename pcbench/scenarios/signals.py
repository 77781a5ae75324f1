"""Input signals as functions of time, in NumPy, sampled at the start of a tick and held over it."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pcbench.scenarios import sources
from pcbench.scenarios.sources import Source, Sources

Signal = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # t[N] s -> u[N, m]


def sawtooth(t: NDArray[np.float64], amplitude: float = 10.0, period: float = np.pi) -> NDArray[np.float64]:
    """Return a falling sawtooth from `amplitude` at t = 0 to -amplitude: 10 (1 - 2 frac(t / pi)) by default, [N, 1].

    Simulink's convention; the figure of the paper was not obtained. Source: Mohammed et al. 2017, section 6.
    """
    return (amplitude * (1 - 2 * np.mod(t / period, 1.0)))[:, None]


def rising(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rising sawtooth, the other reading of the same sentence: 10 (2 frac(t / pi) - 1), [N, 1]."""
    return -sawtooth(t)


def sine(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sin 4t, [N, 1]. Source: Li, Wang, Tian, PI-PCO, section 4."""
    return np.sin(4 * t)[:, None]


def square(t: NDArray[np.float64], period: float = 2.0) -> NDArray[np.float64]:
    """Return 1 in the first half of every period of 2 s and -1 in the second, [N, 1]."""
    return np.where(np.mod(t / period + 1e-9, 1.0) < 0.5, 1.0, -1.0)[:, None]


def step(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1, [N, 1]."""
    return np.ones((len(t), 1))


def zero(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0, [N, 1]."""
    return np.zeros((len(t), 1))


def heater(t: NDArray[np.float64], tick: float, power: float) -> NDArray[np.float64]:
    """Return net inflow [L/s] and heater power [W] of the stirred tank, [N, 2], by samples k = t / tick.

    0.02 L/s for 20 samples, then -0.02; `power` for 30 samples, then -0.6 of it. Decided here: the paper has only a figure.
    """
    k = np.round(t / tick)
    return np.stack([np.where(k % 40 < 20, 0.02, -0.02), np.where(k % 60 < 30, power, -0.6 * power)], 1)


def d1(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0.25 sin(2 pi t), [N, 1], the unknown input of the arm. Source: Peng 2017, section 5."""
    return 0.25 * np.sin(2 * np.pi * t)[:, None]


def d2(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0.025 (2 |10 t - 20 floor(t/2) - 6.5| - 13), [N, 1]: the arm's sawtooth, which falls from 0.35 to 0 every 2 s.

    Right-continuous. t must be a number of ticks times their length, not an accumulated time. Source: Peng 2017.
    """
    return 0.025 * (2 * np.abs(10 * t - 20 * np.floor(0.5 * t) - 6.5) - 13)[:, None]


def circle(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (1 + 0.5 sin t, 1 - 0.5 cos t) [rad] and its first two derivatives, [N, 3, 2]. Source: Hernandez-Gonzalez 2024."""
    s, c = 0.5 * np.sin(t), 0.5 * np.cos(t)
    return np.stack([np.stack([1 + s, 1 - c], -1), np.stack([c, s], -1), np.stack([-s, c], -1)], 1)


def still(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the point (1, 1) rad, at rest, [N, 3, 2]."""
    out = np.zeros((len(t), 3, 2))
    out[:, 0] = 1.0
    return out


PATHS: dict[str, Signal] = {"circle": circle, "still": still}  # paths for a controller: set point and derivatives

SIGNALS: dict[str, Signal] = {
    "sawtooth": sawtooth,
    "rising": rising,
    "sine": sine,
    "square": square,
    "step": step,
    "zero": zero,
    "arm-sine": d1,
    "arm-sawtooth": d2,
    "heater-literal": partial(heater, tick=1.0, power=1e-3),
    "heater-1s": partial(heater, tick=1.0, power=500.0),
    "heater-10s": partial(heater, tick=10.0, power=500.0),
}


SINGLE = [name for name in SIGNALS if not name.startswith("heater")]  # with one column: possible unknown inputs

JUMPS = {"sawtooth": np.pi, "rising": np.pi, "square": 1.0, "arm-sawtooth": 2.0}  # [s] from one to the next


def jumps(signal: Sources, dt: float, ticks: int) -> NDArray[np.int64]:
    """Return the first tick after every jump of a signal (or of one of several) after t = 0, up to `ticks`."""
    out = set()
    for part in parts(signal):
        if not isinstance(part, str):
            out |= set(sources.jumps(part, dt, ticks))
        elif part in JUMPS:
            interval = JUMPS[part]
            out |= {math.ceil(i * interval / dt - 1e-6) for i in range(1, int(ticks * dt / interval) + 2)}
    return np.array(sorted(tick for tick in out if tick <= ticks), int)


def inputs(signal: Sources, t: NDArray[np.float64], m: int) -> NDArray[np.float64]:
    """Return u [N, m] for m inputs: one signal for all of them, or one for each, with commas between the names."""
    columns = [SIGNALS[part](t) if isinstance(part, str) else sources.values(part, t) for part in parts(signal)]
    u = np.hstack(columns)
    return u if u.shape[1] == m else np.hstack(columns * m)


def parts(signal: Sources) -> list[Source]:
    """Return the signals, one by one."""
    return [name.strip() for name in signal.split(",")] if isinstance(signal, str) else list(signal)
