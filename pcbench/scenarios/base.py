"""What a scenario is: plant, input, schedule, noise, drift and horizon, in seconds and SI units."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple


class Scenario(NamedTuple):
    """One published experiment. n states, q outputs; the plant's own states, in its order."""

    name: str
    summary: str
    source: str  # paper and section
    plant: str
    observers: tuple[str, ...]
    sampling_period: tuple[float, ...]  # [q] s
    delay: tuple[float, ...]  # [q] s
    noise_std: tuple[float, ...]  # [q] of one sample
    drift: float  # scale of the plant's parameter drift
    input: str  # name in `signals`
    x0: tuple[float, ...]  # [n]
    xhat0: tuple[float, ...]  # [n]
    prior_std: tuple[float, ...]  # [n] of x(0) about xhat(0): P0 is diagonal
    settle_band: tuple[float, ...]  # [n] a run has settled when |e| stays within
    bound: float  # a run has diverged when an |e| leaves it
    dt: float = 1e-3  # s, the tick
    horizon: float = 10.0  # s
    tail: float = 3.0  # s, where the tail starts
    drift_intensity: float = 0.0  # process noise through the input a designer assumes where the plant drifts, 1/s
    options: Mapping[str, dict[str, Any]] = MappingProxyType({})  # by observer
