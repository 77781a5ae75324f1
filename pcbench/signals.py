"""Inputs as functions of time, in NumPy; each is read at the start of a tick and held over it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Signal = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # t[N] s -> u[N, m]


def sawtooth(t: NDArray[np.float64], amplitude: float = 10.0, period: float = np.pi) -> NDArray[np.float64]:
    """Falling sawtooth, `amplitude` at t = 0 down to -amplitude: 10 (1 - 2 frac(t / pi)) by default, [N, 1].

    Simulink's convention; the figure of the paper is lost. Source: Mohammed et al. 2017, section 6.
    """
    return (amplitude * (1 - 2 * np.mod(t / period, 1.0)))[:, None]


def rising(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rising sawtooth, the other reading of the same sentence: 10 (2 frac(t / pi) - 1), [N, 1]."""
    return -sawtooth(t)


SIGNALS: dict[str, Signal] = {"sawtooth": sawtooth, "rising": rising}
